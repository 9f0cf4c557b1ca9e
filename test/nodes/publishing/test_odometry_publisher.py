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

"""TF from sensor to target, with a tf2_ros in place of the real one, which PyPI has not."""

import dataclasses

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from sensor_msgs.msg import PointCloud2

from debris_scanner.nodes.publishing import odometry_publisher
from msg_adapters.poses import read_target_pose, read_transform
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import target_frame_message

pytestmark = pytest.mark.ros
SENSOR = 'camera_depth_optical_frame'
# as tf2_ros: made with the node, fed one transform at a time; on a topic that this test can read
TF2_ROS = """\
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node


class TransformBroadcaster:
    def __init__(self, node, qos=None):
        assert isinstance(node, Node)
        self._publisher = node.create_publisher(TransformStamped, 'sent_to_tf', 100)

    def sendTransform(self, transform):
        assert isinstance(transform, TransformStamped)
        self._publisher.publish(transform)
"""


def send_targets(peer, recording, count=6):
    points = peer.talk(PointCloud2, 'target_points')
    for target in recording.targets[:count]:
        points.publish(target_frame_message(target, SENSOR))
        peer.executor.spin_once()


def test_every_believed_pose_is_sent_as_the_sensors_child(nodes, peer, recording, tmp_path, monkeypatch):
    (tmp_path / 'tf2_ros.py').write_text(TF2_ROS)
    monkeypatch.syspath_prepend(tmp_path)
    poses = peer.listen(PoseWithCovarianceStamped, 'target_pose')
    sent = peer.listen(TransformStamped, 'sent_to_tf')
    nodes.start('odometry')
    send_targets(peer, recording)
    peer.until(lambda: len(poses) == 6 and len(sent) == 12, 'six poses, and two transforms of each')
    named = [transform for transform in sent if transform.child_frame_id == 'sensor']
    assert all(transform.header.frame_id == SENSOR for transform in named)
    assert all(np.array_equal(read_transform(transform), np.eye(4)) for transform in named)
    sent = [transform for transform in sent if transform.child_frame_id != 'sensor']
    for pose, transform in zip(poses, sent, strict=True):
        assert (transform.header.frame_id, transform.child_frame_id) == (SENSOR, 'target_scanning')
        assert read_stamp(transform.header.stamp) == read_stamp(pose.header.stamp)
        assert np.allclose(read_transform(transform), read_target_pose(pose).T_sensor_target)
    nodes.check()


def test_another_nodes_target_of_the_far_future_blocks_nothing(nodes, peer, recording):
    poses = peer.listen(PoseWithCovarianceStamped, 'target_pose')
    nodes.start('odometry')
    targets = recording.targets[:6]
    ahead_ns = 50 * 365 * 24 * 3600 * 10**9
    stray = dataclasses.replace(targets[2], stamp_ns=targets[2].stamp_ns + ahead_ns)
    points = peer.talk(PointCloud2, 'target_points')
    for target in [*targets[:2], stray, *targets[2:]]:
        points.publish(target_frame_message(target, SENSOR))
        peer.executor.spin_once()
    peer.until(lambda: len(poses) == len(targets), 'the poses of our own')
    assert [read_stamp(p.header.stamp) for p in poses] == [t.stamp_ns for t in targets]
    peer.until(lambda: peer.rejected('odometry') == {'non_monotone_stamp': 1}, 'the other one, counted')


def test_without_tf2_ros_poses_come_all_the_same(nodes, peer, recording):
    if odometry_publisher.TransformBroadcaster is not None:
        pytest.skip('tf2_ros is installed')
    poses = peer.listen(PoseWithCovarianceStamped, 'target_pose')
    nodes.start('odometry')
    send_targets(peer, recording, 2)
    peer.until(lambda: len(poses) == 2, 'two poses')
    nodes.check()
