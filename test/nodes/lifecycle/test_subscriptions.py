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

"""Messages that are lost in transport, and what a node says of them; the node is a stub."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from std_msgs.msg import Empty

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import WARN
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.subscriptions import CountingSubscription


@pytest.fixture
def subscription():
    publisher = SimpleNamespace(
        node_namespace='/', node_name='driver', qos_profile=qos.sensor_input('best_effort', 5)
    )
    node = SimpleNamespace(
        create_subscription=lambda _type, topic, _callback, _qos: SimpleNamespace(topic_name=f'/{topic}'),
        count_publishers=lambda _topic: 1,
        get_publishers_info_by_topic=lambda _topic: [publisher],
    )
    return CountingSubscription(node, Empty, 'depth/image_raw', lambda _msg, _ns: None, qos.waiting())


def receive(subscription, numbers):
    for number in numbers:
        subscription._receive(Empty(), {'publication_sequence_number': number, 'source_timestamp': 0})


def test_a_share_lost_is_said_with_its_numbers(subscription):
    receive(subscription, [*range(30), *range(46, 69)])
    said = (
        'lost in transport: 16 of 69 messages on /depth/image_raw (23 %): have /driver publish reliably, or '
    )
    assert subscription.loss.startswith(said)
    assert Path(subscription.loss.rpartition('=')[2]).is_file()
    subscription.reset()
    assert subscription.loss == ''


def test_a_single_loss_at_the_start_is_not_said(subscription):
    receive(subscription, [0, *range(2, 40)])
    assert (subscription.lost, subscription.loss) == (1, '')


def test_the_diagnostics_of_every_stage_warn_of_it_beside_its_own_problem(subscription):
    receive(subscription, range(0, 100, 2))
    node = SimpleNamespace(
        counting_subscriptions=[subscription], _duplicates=lambda: None, problem=lambda: (WARN, 'lost target')
    )
    level, message = StageNode._problem(node)
    assert level == WARN
    assert message.startswith(
        'lost target; lost in transport: 49 of 99 messages on /depth/image_raw (49 %): '
    )
