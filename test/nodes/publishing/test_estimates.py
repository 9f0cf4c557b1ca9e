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

"""Estimates and their statuses survive the round trip through messages."""

import copy
import dataclasses

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import exp_so3, inverse
from debris_scanner.nodes.publishing.estimates import (
    FrameStatus,
    estimate_messages,
    read_estimate,
    read_status,
    status_message,
)
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.odometry import OdometryEstimate
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import read_odometry, read_target_pose

STAMP = 1_795_264_289_657_995_302


def estimate(motion, accepted=True):
    return OdometryEstimate(
        stamp_ns=STAMP,
        state='scanning',
        accepted=accepted,
        T_sensor_target=motion.T_sensor_target,
        covariance=motion.pose_covariance,
        omega_target=motion.omega_target,
        omega_sigma=motion.omega_sigma,
        velocity=motion.velocity.copy(),
        stats=RegistrationStats(points=100.0, matched=80.0),
        observability=None,
    )


@pytest.fixture
def motion():
    made = MotionFilter(np.array([0.01, 0.02, 0.8]), MotionSettings(), footprint=0.0015)
    made.R = exp_so3(np.array([0.3, -0.2, 0.5]))
    made.omega, made.velocity = np.array([0.1, 0.5, -0.2]), np.array([0.03, -0.01, 0.02])
    made.pivot = np.array([0.04, -0.03, 0.02])
    return made


@pytest.mark.parametrize('tracked', [False, True])
def test_status_comes_back(motion, tracked):
    sent = dataclasses.replace(
        estimate(motion, accepted=not tracked),
        state='lost',
        scan_ns=STAMP - 5,
        tracked=tracked,
        path_rad=1.2345678901234567,
        usable_for_mapping=False,
        submap=3,
    )
    status = read_status(status_message(sent))
    assert status == FrameStatus.of(sent)


def test_what_is_no_status_is_malformed(motion):
    good = status_message(estimate(motion))
    for key, value in (('accepted', 'yes'), ('path_rad', 'nan'), ('path_rad', '1e9'), ('submap', '-1'),
                       ('scan_ns', '-5'), ('submap', 'one'), ('tracked', None)):  # fmt: skip
        msg = copy.deepcopy(good)
        pairs = msg.status[0].values
        msg.status[0].values = [p for p in pairs if p.key != key]
        if value is not None:
            msg.status[0].values.append(KeyValue(key=key, value=value))
        with pytest.raises(MalformedMessage):
            read_status(msg)
    for msg in (DiagnosticArray(), DiagnosticArray(status=[DiagnosticStatus()])):
        with pytest.raises(MalformedMessage):
            read_status(msg)


def test_an_estimate_is_put_together_from_its_messages(motion, recording):
    target = recording.targets[0]
    keyframe = KeyFrame(target, inverse(motion.T_sensor_target), 1.5, motion.pose_covariance, 2)
    sent = dataclasses.replace(estimate(motion), keyframe=keyframe, path_rad=1.5, submap=2, scan_ns=STAMP)
    odometry, _ = estimate_messages(sent, motion, 'sensor', 'target')
    back = read_estimate(read_status(status_message(sent)), read_odometry(odometry), target)
    assert (back.stamp_ns, back.scan_ns, back.submap, back.state) == (STAMP, STAMP, 2, 'scanning')
    np.testing.assert_allclose(back.omega_target, sent.omega_target, atol=1e-12)
    np.testing.assert_allclose(back.omega_sigma, sent.omega_sigma, atol=1e-12)
    assert (back.keyframe.stamp_ns, back.keyframe.path_rad, back.keyframe.submap) == (target.stamp_ns, 1.5, 2)
    np.testing.assert_allclose(back.keyframe.T_target_sensor, keyframe.T_target_sensor, atol=1e-9)
    np.testing.assert_allclose(back.keyframe.covariance, keyframe.covariance, atol=1e-15)


def test_estimate_comes_back_and_its_twist_moves_the_origin(motion):
    odometry, pose = estimate_messages(estimate(motion), motion, 'sensor', 'left/target')
    back = read_odometry(odometry)
    assert (back.stamp_ns, back.frame_id, back.child_frame_id) == (STAMP, 'sensor', 'left/target')
    np.testing.assert_allclose(back.T_sensor_target, motion.T_sensor_target, atol=1e-12)
    np.testing.assert_allclose(back.covariance, motion.pose_covariance, atol=1e-15)
    np.testing.assert_allclose(back.twist[:3], motion.omega_target)
    np.testing.assert_allclose(back.twist_covariance.diagonal()[:3] ** 0.5, motion.omega_sigma)
    np.testing.assert_allclose(read_target_pose(pose).T_sensor_target, back.T_sensor_target)

    # the published velocity of the origin is how it moves when the filter propagates
    dt = 1e-5
    before = motion.T_sensor_target
    motion.predict(dt)
    moved = (motion.T_sensor_target[:3, 3] - before[:3, 3]) / dt
    np.testing.assert_allclose(before[:3, :3] @ back.twist[3:], moved, atol=1e-4)
