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

"""Real nodes over DDS, each test in a domain of its own."""

import itertools
import os
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from debris_scanner.cli.live.domain import free_domain
from debris_scanner.cli.live.processes import Children
from debris_scanner.nodes.forked import load
from debris_scanner.nodes.lifecycle import middleware, qos
from debris_scanner.nodes.lifecycle.diagnostics import TOPIC, read_reports

_starts = itertools.count(os.getpid())
DEADLINE_S = 60.0


@pytest.fixture
def domain(monkeypatch):
    """A ROS domain that nobody else is in, kept to this machine; set for this process and its children."""
    number = free_domain(next(_starts))
    for name in (middleware.PROFILE_VARIABLE, 'AMENT_PREFIX_PATH', 'ROS_AUTOMATIC_DISCOVERY_RANGE'):
        monkeypatch.setenv(name, 'x')  # so that monkeypatch restores what prepare() sets
        monkeypatch.delenv(name)
    monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
    middleware.prepare(local_only=True)
    return number


@pytest.fixture(scope='session')
def loaded():
    """The process that nodes are forked from."""
    load({})


@pytest.fixture
def nodes(domain, tmp_path, loaded):
    """Node processes, stopped at the end."""
    with Children(tmp_path / 'logs') as children:
        yield children


SETTLING_S = 1.0


class Peer:
    """A node of the test's own: it listens, sends and asks."""

    def __init__(self, domain):
        self.context = Context()
        rclpy.init(
            args=[], context=self.context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self.node = rclpy.create_node('peer', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.node.create_timer(0.05, lambda: None)  # so that spin_once returns
        self.reports = {}
        self._clients = {}
        self.node.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())

    def _on_diagnostics(self, msg):
        self.reports.update({report.stage: report for report in read_reports(msg)})

    def until(self, condition, what, deadline_s=DEADLINE_S):
        """Spin until a condition holds; its value."""
        end = time.monotonic() + deadline_s
        while not (value := condition()):
            assert time.monotonic() < end, f'{what} did not come in {deadline_s:.0f} s'
            self.executor.spin_once()
        return value

    def listen(self, msg_type, topic, profile=None):
        """List that messages of a topic are appended to."""
        messages = []
        self.node.create_subscription(msg_type, topic, messages.append, profile or qos.waiting())
        return messages

    def talk(self, msg_type, topic, profile=None):
        """A publisher that has found a subscriber."""
        publisher = self.node.create_publisher(msg_type, topic, profile or qos.waiting())
        self.until(publisher.get_subscription_count, f'a subscriber on {topic}')
        self._settle()  # the subscriber finds the publisher a little later; best effort is lost until then
        return publisher

    def call(self, srv_type, name, request=None):
        """The answer of a service."""
        client = self._client(srv_type, name)
        answer = client.call_async(request or srv_type.Request())
        self.until(answer.done, f'the answer of {name}')
        return answer.result()

    def _client(self, srv_type, name):
        if name not in self._clients:
            self._clients[name] = self.node.create_client(srv_type, name)
            self.until(self._clients[name].service_is_ready, name)
            self._settle()  # the service finds the reader of its answers a little later
        return self._clients[name]

    def _settle(self):
        end = time.monotonic() + SETTLING_S
        while time.monotonic() < end:
            self.executor.spin_once(0.05)

    def rejected(self, stage):
        """Drops by reason as a stage last reported them."""
        return self.reports[stage].rejected if stage in self.reports else {}

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def peer(domain):
    made = Peer(domain)
    yield made
    made.close()
