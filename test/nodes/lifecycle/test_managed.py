# Copyright 2026 debris_scanner maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A managed node whose callbacks raise goes on."""

import time

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Empty

from debris_scanner.core.optional import MissingLibrary
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.managed import ManagedNode

pytestmark = pytest.mark.ros


def raising(error):
    def callback(*_):
        raise error

    return callback


@pytest.fixture
def node(domain):
    rclpy.init(args=[], domain_id=domain)
    made = ManagedNode('probe')
    yield made
    made.destroy_node()
    rclpy.shutdown()


def spin(node, condition):
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    end = time.monotonic() + 20
    try:
        while not condition():
            assert time.monotonic() < end
            executor.spin_once(0.1)
    finally:
        executor.remove_node(node)


def test_timers_and_latched_messages_that_raise_are_counted(node):
    node.create_publisher(Empty, 'model', qos.latched()).publish(Empty())
    node.create_subscription(Empty, 'model', raising(ZeroDivisionError('of a message')), qos.latched())
    node.create_timer(0.01, raising(IndexError('of a timer')))
    spin(node, lambda: node.faults.counts['ZeroDivisionError'] == 1 and node.faults.counts['IndexError'] > 2)


def test_a_missing_library_ends_it(node):
    node.create_timer(0.01, raising(MissingLibrary.named('numba')))
    with pytest.raises(MissingLibrary):
        spin(node, lambda: False)
