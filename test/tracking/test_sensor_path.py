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

"""Poses in the world, by an odometry of the sensor."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, inverse, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.tracking.sensor_path import ODOMETRY, SENSOR, SensorPath

OMEGA, SPEED = np.array([0.3, -0.5, 0.2]), np.array([0.1, 0.0, -0.2])
TARGET = transform(exp_so3(np.array([0.4, 0.1, -0.2])), np.array([0.1, 0.2, 0.9]))  # in the world


def sensor(t):
    return transform(exp_so3(OMEGA * t), SPEED * t)


def path(seconds, sigma=0.0):
    found = SensorPath()
    for t in seconds:
        found.add(round((t + 5) * 1e9), sensor(t), sigma)
    return found


def seen(seconds):
    return [StampedPose(round((t + 5) * 1e9), compose(inverse(sensor(t)), TARGET)) for t in seconds]


def test_a_still_target_stands_still_before_a_moving_sensor():
    # an even turn is interpolated exactly; the last frame is almost an interval after the last sample
    poses = seen([-0.04, 0.0, 0.013, 0.5, 1.0, 1.04])
    placed = path(np.arange(0.0, 1.01, 0.05), sigma=2e-4).place(poses)
    assert (placed.frame, placed.why_not, placed.sigma_rad) == (ODOMETRY, '', 2e-4)
    for pose in placed.poses:
        np.testing.assert_allclose(pose.T_sensor_target, TARGET, atol=1e-9)
    np.testing.assert_allclose(placed.T_sensor_frame, inverse(sensor(1.04)), atol=1e-9)


def test_without_an_odometry_poses_are_the_sensors():
    poses = seen([0.0, 0.1])
    placed = SensorPath().place(poses)
    assert (placed.poses, placed.frame, placed.why_not) == (poses, SENSOR, '')
    assert path([0.0, 0.1]).place([]).frame == SENSOR


@pytest.mark.parametrize(
    ('seconds', 'said'),
    [
        ([0.5], 'a single sample'),
        (np.arange(0.2, 1.2, 0.05), 'begins after the first frames, by 0.20 s'),
        (np.arange(-0.1, 0.8, 0.05), 'ends before the last frames'),
        ([*np.arange(0, 0.3, 0.02), *np.arange(0.7, 1.2, 0.02)], 'gap of 0.42 s'),
    ],
)
def test_an_odometry_that_does_not_cover_the_frames_is_not_used(seconds, said):
    poses = seen(np.arange(0.0, 1.01, 0.1))
    placed = path(seconds).place(poses)
    assert placed.frame == SENSOR and placed.poses == poses
    assert said in placed.why_not


def test_an_odometry_of_another_frame_is_not_used():
    found = path(np.arange(0.0, 1.01, 0.05))
    found.sees('camera')
    assert found.place(seen([0.3])).frame == ODOMETRY  # it does not say of which frame it is
    found.add(6_050_000_000, sensor(1.05), 0.0, 'base_link')
    assert "'base_link'" in found.place(seen([0.3])).why_not


def test_old_samples_are_left_out_and_a_recording_that_is_played_again_begins_anew():
    found = path(np.arange(0.0, 1.01, 0.05))
    found.add(5_500_000_000, np.eye(4))
    np.testing.assert_allclose(found.place(seen([0.5])).poses[0].T_sensor_target, TARGET, atol=1e-9)
    found.add(5_000_000_000, sensor(0.0))
    assert 'a single sample' in found.place(seen([0.5])).why_not
