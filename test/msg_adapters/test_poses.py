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

import numpy as np
import pytest
from geometry_msgs.msg import Pose
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message

from debris_scanner.core.geometry import exp_se3
from msg_adapters import poses
from msg_adapters.errors import MalformedMessage
from msg_adapters.raw_messages import jazzy_types

STAMP = 1_700_000_000_987_654_321
twists = st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array)


def covariance(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T


def through_bag(message):
    package = type(message).__module__.split('.')[0]
    name = f'{package}/msg/{type(message).__name__}'
    return jazzy_types().deserialize_cdr(serialize_message(message), name)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(twists)
def test_poses_and_transforms_come_back(twist):
    T = exp_se3(twist)
    np.testing.assert_allclose(poses.read_pose(poses.pose_message(T)), T, atol=1e-12)
    message = poses.transform_message(STAMP, 'sensor', 'target', T)
    assert (message.header.frame_id, message.child_frame_id) == ('sensor', 'target')
    np.testing.assert_allclose(poses.read_transform(message), T, atol=1e-12)


def test_a_pose_places_the_target_in_the_sensors_frame():
    # a quarter turn about z: the target's x axis points along the sensor's y
    message = poses.pose_message(exp_se3(np.array([0, 0, np.pi / 2, 1, 2, 3])))
    assert (message.position.x, message.position.y, message.position.z) == (1, 2, 3)
    q = message.orientation
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)


@pytest.mark.parametrize('decode', [lambda m: m, through_bag])
def test_odometry_comes_back(decode):
    T, twist = exp_se3(np.array([0.1, -0.2, 0.3, 1, 2, 3])), np.arange(1.0, 7.0)
    message = decode(
        poses.odometry_message(STAMP, 'sensor', 'target', T, covariance(1), twist, covariance(2))
    )
    back = poses.read_odometry(message)
    assert (back.stamp_ns, back.frame_id, back.child_frame_id) == (STAMP, 'sensor', 'target')
    np.testing.assert_allclose(back.T_sensor_target, T, atol=1e-12)
    np.testing.assert_array_equal(back.covariance, covariance(1))
    np.testing.assert_array_equal(back.twist, twist)
    np.testing.assert_array_equal(back.twist_covariance, covariance(2))


def test_messages_order_translation_before_rotation():
    ours = np.diag([1.0, 2, 3, 4, 5, 6])  # rotation x y z, translation x y z
    ours[0, 3] = ours[3, 0] = 0.5  # rotation about x with translation along x
    message = poses.odometry_message(STAMP, 's', 't', np.eye(4), ours, np.arange(1.0, 7.0), ours)
    theirs = message.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(np.diag(theirs), [4, 5, 6, 1, 2, 3])
    assert theirs[0, 3] == theirs[3, 0] == 0.5
    np.testing.assert_array_equal(message.twist.covariance, message.pose.covariance)
    twist = message.twist.twist
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == (1, 2, 3)
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == (4, 5, 6)


@pytest.mark.parametrize('decode', [lambda m: m, through_bag])
def test_the_targets_pose_comes_back(decode):
    T = exp_se3(np.array([0.5, 0.1, 0, 0, 0, 0.6]))
    back = poses.read_target_pose(decode(poses.target_pose_message(STAMP, 'sensor', T, covariance(3))))
    assert (back.stamp_ns, back.frame_id) == (STAMP, 'sensor')
    np.testing.assert_allclose(back.T_sensor_target, T, atol=1e-12)
    np.testing.assert_array_equal(back.covariance, covariance(3))


@pytest.mark.parametrize('decode', [lambda m: m, through_bag])
def test_a_path_keeps_the_stamp_of_every_pose(decode):
    path = [(STAMP + i, exp_se3(np.full(6, 0.1 * i))) for i in range(4)]
    back = poses.read_path(decode(poses.path_message(STAMP + 9, 'target', path)))
    assert [stamp for stamp, _ in back] == [stamp for stamp, _ in path]
    np.testing.assert_allclose([T for _, T in back], [T for _, T in path], atol=1e-12)


@pytest.mark.parametrize('decode', [lambda m: m, through_bag])
def test_a_closure_is_named_by_the_stamps_of_its_key_frames(decode):
    closure = poses.ClosureTransform(STAMP, STAMP + 50, exp_se3(np.array([0, 0.1, 0, 0.01, 0, 0])))
    message = decode(poses.closure_message(closure))
    assert (message.header.frame_id, message.child_frame_id) == (
        f'keyframe_{STAMP}',
        f'keyframe_{STAMP + 50}',
    )
    back = poses.read_closure(message)
    assert (back.from_stamp_ns, back.to_stamp_ns) == (STAMP, STAMP + 50)
    np.testing.assert_allclose(back.T_from_to, closure.T_from_to, atol=1e-12)


@pytest.mark.parametrize(
    'name', ['', 'keyframe_', 'keyframe_-3', 'keyframe_1.5', 'camera', '17', 'keyframe_²']
)
def test_a_frame_that_names_no_key_frame_is_refused(name):
    message = poses.closure_message(poses.ClosureTransform(1, 2, np.eye(4)))
    message.child_frame_id = name
    with pytest.raises(MalformedMessage, match='names no key frame'):
        poses.read_closure(message)


def test_a_quaternion_of_no_length_is_refused():
    pose = Pose()
    pose.orientation.w = 0.0
    with pytest.raises(MalformedMessage, match='is no rotation'):
        poses.read_pose(pose)


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(value):
    pose = poses.pose_message(np.eye(4))
    pose.position.y = value
    with pytest.raises(MalformedMessage, match='pose is not finite'):
        poses.read_pose(pose)
    good = np.eye(4), np.eye(6), np.zeros(6), np.eye(6)
    for i, named in ((1, 'covariance'), (2, 'twist'), (3, 'covariance')):
        bad = [array.copy() for array in good]
        bad[i].flat[0] = value
        with pytest.raises(MalformedMessage, match=f'{named} is not finite'):
            poses.read_odometry(poses.odometry_message(0, 's', 't', *bad))
