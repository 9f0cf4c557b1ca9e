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

"""What a node says of inputs that do not come, and of clocks that jump: real nodes, real QoS."""

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2
from test_preprocess import disc_cloud

from debris_scanner.nodes.lifecycle.diagnostics import ERROR
from msg_adapters.stamps import read_stamp, time_message

pytestmark = pytest.mark.ros
S = 1_000_000_000


def start(nodes, *parameters):
    nodes.start('preprocess', ['--ros-args', *(p for q in parameters for p in ('-p', q))])


def message(peer, stage, text):
    """The report whose message has a text."""
    peer.until(lambda: stage in peer.reports and text in peer.reports[stage].message, f'{stage}: {text}')
    return peer.reports[stage]


def test_incompatible_reliability_is_said_by_topic_and_policy(nodes, peer):
    start(nodes, 'input_reliability:=reliable', 'input:=points')
    weak = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    peer.node.create_publisher(PointCloud2, 'points', weak)
    report = message(peer, 'preprocess', '/peer offers')
    assert '/points: /peer offers RELIABILITY best effort, reliable is asked for' in report.message
    assert report.values['input.points.publishers'] == '1'


def test_another_type_on_the_topic_is_said(nodes, peer):
    start(nodes)
    peer.node.create_publisher(Image, 'points', 5)
    said = '/points: /peer publishes sensor_msgs/msg/Image, not sensor_msgs/msg/PointCloud2'
    assert said in message(peer, 'preprocess', said).message  # the publisher's name is discovered last


def test_a_topic_that_nobody_remapped_is_offered(nodes, peer):
    peer.node.create_publisher(PointCloud2, '/camera/depth_registered/points', 5)
    start(nodes, 'input:=points')
    peer.node.create_publisher(Image, '/camera/color/image_raw', 5)
    nodes.start('odometry')  # its clouds are no input
    nodes.start('graph')
    peer.until(lambda: {'odometry', 'graph'} <= set(peer.reports), 'the other nodes')
    said = 'there are /camera/depth_registered/points (PointCloud2), /camera/color/image_raw (Image): remap'
    report = message(peer, 'preprocess', said)
    assert '/points has no publisher; there are' in report.message
    assert report.level == ERROR


def test_silence_is_explained_with_the_last_stamp(nodes, peer):
    start(nodes)
    points = peer.talk(PointCloud2, 'points')
    message(peer, 'preprocess', 'no message yet')
    points.publish(disc_cloud(1_500_000_000))
    report = message(peer, 'preprocess', 'stamped 1.500 s')
    assert '1 publisher, /peer (reliable, volatile)' in report.message
    assert 'the last message came' in report.message
    assert report.values['input.points.stamp_ns'] == '1500000000'
    assert float(report.values['input.points.age_s']) > 1


@pytest.mark.parametrize('stage', ['preprocess', 'scanner'])
@pytest.mark.parametrize('stamp_ns', [0, 7_000_000_000])
def test_one_stamp_for_all_frames_is_said_in_the_log_and_the_diagnostics(
    nodes, peer, tmp_path, stage, stamp_ns
):
    nodes.start(stage, ['--ros-args', '-r', 'points:=/camera/cloud'])
    points = peer.talk(PointCloud2, '/camera/cloud')

    def told():
        points.publish(disc_cloud(stamp_ns))
        peer.executor.spin_once(0.05)
        report = peer.reports.get(stage)
        return report if report and 'all stamps are' in report.message else None

    report = peer.until(told, 'the hint')
    said = f'all stamps are {stamp_ns}: the driver does not stamp its messages'
    assert said in report.message
    log = (tmp_path / 'logs' / f'{stage}.log').read_text()
    assert log.count(said) == 1
    assert f'frame rejected: non_monotone_stamp: {stamp_ns} after {stamp_ns}' in log


@pytest.mark.parametrize('stage', ['preprocess', 'scanner'])
def test_messages_name_the_topics_that_are_remapped(nodes, peer, tmp_path, stage):
    nodes.start(stage, ['--ros-args', '-r', 'points:=/camera/cloud', '-r', 'depth/image_raw:=/camera/depth'])
    points = peer.talk(PointCloud2, '/camera/cloud')
    depth = peer.talk(Image, '/camera/depth')
    log = tmp_path / 'logs' / f'{stage}.log'
    broken = disc_cloud(1)
    broken.row_step, broken.data = 1, broken.data[:10]

    for publisher, sent, text in (  # again and again, for the log is throttled
        (points, broken, 'message on /camera/cloud rejected: '),
        (depth, Image(), 'no message on /depth/camera_info yet'),
        (points, disc_cloud(S), 'scanning /camera/cloud; /camera/depth is ignored'),
    ):

        def said(publisher=publisher, sent=sent, text=text):
            publisher.publish(sent)
            peer.executor.spin_once(0.05)
            return text in log.read_text()

        peer.until(said, text)


def test_a_clock_that_is_set_back_or_forward_stops_nothing(nodes, peer):
    start(nodes)
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points')
    hour = 3600 * S
    stamps = [*range(2 * hour, 2 * hour + 8 * S, S // 10)][:20]
    stamps += [s - hour for s in stamps] + [s + hour for s in stamps]
    doubted = {20, 21, 40, 41}  # two frames after each jump: the third of one clock is believed
    for k, stamp_ns in enumerate(stamps):
        points.publish(disc_cloud(stamp_ns))
        if k not in doubted:  # at the node's own pace: a slow one would shed frames
            come = len(targets)
            peer.until(lambda come=come: len(targets) > come, f'target {k}')
    placed = [read_stamp(t.header.stamp) for t in targets]
    assert placed == sorted(placed)
    assert placed[-1] - placed[0] < 9 * S
    values = peer.until(
        lambda: (r := peer.reports['preprocess']).values.get('stamps.forward_jumps') and r.values,
        'the counts',
    )
    assert values['stamps.back_jumps'] == '1'
    assert values['stamps.forward_jumps'] == '1'
    assert peer.reports['preprocess'].rejected == {'non_monotone_stamp': 4}


def test_simulated_time_with_and_without_a_clock(nodes, peer):
    start(nodes, 'use_sim_time:=true')
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points')
    points.publish(disc_cloud(1_000_000_000))
    peer.until(lambda: targets, 'a frame without /clock')
    first = peer.until(lambda: peer.reports.get('preprocess'), 'a report without /clock')
    assert first.stamp_ns == 0
    clock = peer.talk(Clock, '/clock')
    for second in (500, 200):  # and it may go back

        def tick(second=second):
            clock.publish(Clock(clock=time_message(second * S)))
            return peer.reports['preprocess'].stamp_ns == second * S

        peer.until(tick, f'a report at {second} s')
    points.publish(disc_cloud(1_100_000_000))
    peer.until(lambda: len(targets) == 2, 'a frame after the clock went back')
