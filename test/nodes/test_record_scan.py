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

"""The results of a scan in a bag, as they were sent."""

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.record_scan import free_name
from msg_adapters.raw_messages import jazzy_types

pytestmark = pytest.mark.ros


def test_it_keeps_what_comes_and_waits_for_the_end_of_the_scan(nodes, peer, tmp_path):
    bag = tmp_path / 'out' / 'recorded'
    state = peer.node.create_publisher(String, '/left/state', qos.latched())
    state.publish(String(data='scanning'))  # before it is there
    given = ['--ros-args', '-r', '__ns:=/left', '-p', f'bag:={bag}']
    nodes.start('record_scan', given)
    poses = peer.talk(PoseWithCovarianceStamped, '/left/target_pose')
    for k in range(5):
        message = PoseWithCovarianceStamped()
        message.header.stamp.sec = k
        poses.publish(message)
    peer.until(
        lambda: 'record_scan' in peer.reports and peer.reports['record_scan'].counts.get('recorded') == 6,
        'six messages',
    )
    nodes.interrupt('record_scan')
    assert not nodes.wait('record_scan', 3)  # the scan goes on
    state.publish(String(data='finished'))
    peer.executor.spin_once()
    assert nodes.wait('record_scan', 30)
    assert nodes.exit_code('record_scan') == 0
    types = jazzy_types()
    with Reader(bag) as reader:
        read = [(c.topic, types.deserialize_cdr(data, c.msgtype)) for c, _, data in reader.messages()]
    assert [m.data for topic, m in read if topic == '/left/state'] == ['scanning', 'finished']
    assert [m.header.stamp.sec for topic, m in read if topic == '/left/target_pose'] == list(range(5))


def test_a_taken_name_gets_a_number(tmp_path):
    assert free_name(tmp_path / 'recorded') == tmp_path / 'recorded'
    for name in ('recorded', 'recorded_2'):
        (tmp_path / name).mkdir()
    assert free_name(tmp_path / 'recorded') == tmp_path / 'recorded_3'
