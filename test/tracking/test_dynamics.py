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

"""What is told of a body's mass from noisy poses of motions whose truth is known."""

import json

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.sim.motions import MotionSettings, make_motion
from debris_scanner.sim.tumble import TorqueFreeBody
from debris_scanner.tracking.dynamics import (
    NOT_OBSERVABLE,
    NOT_TORQUE_FREE,
    TORQUE_FREE,
    fit_dynamics,
)
from debris_scanner.tracking.forecast import predict

NOISE, EXTENT = np.radians(0.05), 0.3
CENTRE = np.array([0.02, -0.01, 0.005])  # of mass, target frame
R_TARGET_BODY = exp_so3(np.array([0.3, -0.8, 0.4]))  # principal axes in the target frame
MOMENTS = np.array([0.5, 0.8, 1.0])


def noisy(poses, rng):
    return [T @ transform(exp_so3(NOISE * rng.normal(size=3)), 2e-4 * rng.normal(size=3)) for T in poses]


def scan(attitude, seconds, seed=0):
    """Final poses of a target whose centre of mass drifts, its attitude (3, 3) a function of time."""
    poses = []
    for t in seconds:
        R = attitude(t)
        poses.append(transform(R, np.array([0.01, 0.0, 0.8]) + 0.001 * t - R @ CENTRE))
    rng = np.random.default_rng(seed)
    return [StampedPose(round((t + 5) * 1e9), T) for t, T in zip(seconds, noisy(poses, rng), strict=True)]


def tumble(omega, seed=0, seconds=None):
    body = TorqueFreeBody(MOMENTS, np.eye(3), np.asarray(omega, float), 60.0)
    seconds = np.arange(0.0, 60.0, 0.1) if seconds is None else seconds
    return scan(lambda t: np.asarray(body.attitude(t)) @ R_TARGET_BODY.T, seconds, seed)


@pytest.mark.parametrize('omega', [(0.1, 0.4, 0.15), (0.4, 0.1, 0.1), (0.02, 0.5, 0.02)])
def test_a_tumble_tells_ratios_axes_and_centre(omega):
    found = fit_dynamics(tumble(omega), NOISE, EXTENT)
    assert found.kind == TORQUE_FREE
    told = found.mass_properties()
    errors = np.abs(np.array(told['inertia_ratios']) - MOMENTS[:2] / MOMENTS[2])
    assert (errors < 0.005).all()
    assert (errors < 5 * np.array(told['inertia_ratios_sigma']) + 1e-5).all()
    cosines = np.abs(np.einsum('ki,ik->k', np.array(told['principal_axes']), R_TARGET_BODY))
    assert np.degrees(np.arccos(np.minimum(cosines, 1.0))).max() < 0.5
    np.testing.assert_allclose(told['centre_of_mass_m'], CENTRE, atol=2e-4)
    assert max(told['centre_of_mass_sigma_m']) < 1e-3
    json.dumps(told)


@pytest.mark.slow
def test_a_fast_tumble_is_fitted_however_few_poses_are_drawn():
    """It turns by more than half a turn between the poses of which the fit is made."""
    body = TorqueFreeBody(MOMENTS, np.eye(3), np.array([0.6, 2.4, 0.8]), 200.0)
    seconds = np.arange(0.0, 200.0, 0.2)
    found = fit_dynamics(
        scan(lambda t: np.asarray(body.attitude(t)) @ R_TARGET_BODY.T, seconds), NOISE, EXTENT
    )
    assert found.kind == TORQUE_FREE
    np.testing.assert_allclose(found.inertia_ratios, MOMENTS[:2], atol=0.005)


def test_gaps_and_few_poses_do_no_harm():
    seconds = np.array([t for t in np.arange(0.0, 60.0, 0.5) if not 20 < t < 30])
    found = fit_dynamics(tumble((0.1, 0.4, 0.15), seconds=seconds), NOISE, EXTENT)
    assert found.kind == TORQUE_FREE
    np.testing.assert_allclose(found.inertia_ratios, MOMENTS[:2], atol=0.02)
    assert fit_dynamics(tumble((0.1, 0.4, 0.15))[:10], NOISE, EXTENT) is None


def test_a_clock_that_was_set_leaves_what_comes_after_it():
    """No motion leads across it, and the way there would take for ever."""
    poses = tumble((0.1, 0.4, 0.15))
    moved = [StampedPose(p.stamp_ns + 1_600_000_000 * 10**9, p.T_sensor_target) for p in poses[200:]]
    broken = [*poses[:200], *moved]
    found, alone = (fit_dynamics(each, NOISE, EXTENT) for each in (broken, moved))
    assert found.kind == TORQUE_FREE
    np.testing.assert_array_equal(found.numbers, alone.numbers)
    forecast = predict(found, broken, NOISE, EXTENT).ahead()
    np.testing.assert_array_equal(forecast.poses, predict(alone, moved, NOISE, EXTENT).ahead().poses)


def test_the_last_seconds_alone_do_not_mislead_the_fit():
    """They fit other bodies as well, from which no way leads to the right one."""
    motion = make_motion(MotionSettings('tumble', seed=3, duration_s=60.0))
    R_truth_target, noise = exp_so3(np.array([0.3, -0.75, -0.6])), np.radians(0.02)
    rng = np.random.default_rng(0)
    poses = []
    for t in np.arange(0.0, 60.0, 0.1):
        T = motion.T_sensor_target(t) @ transform(
            R_truth_target @ exp_so3(noise * rng.normal(size=3)), np.zeros(3)
        )
        poses.append(StampedPose(round((t + 5) * 1e9), T))
    found = fit_dynamics(poses, noise, EXTENT)
    assert found.kind == TORQUE_FREE
    np.testing.assert_allclose(found.inertia_ratios, [0.5, 0.8], atol=0.005)


@pytest.mark.parametrize('axis', np.eye(3))
def test_a_pure_spin_tells_no_ratios(axis):
    found = fit_dynamics(tumble(0.5 * axis), NOISE, EXTENT)
    assert found.kind == NOT_OBSERVABLE
    assert found.mass_properties() == {'observable': False, 'why': 'not_observable'}
    # along the axis the centre is as unknown as the target is large
    assert found.centre.sigma @ np.abs(R_TARGET_BODY @ axis) > 0.3 * EXTENT


def test_a_turntable_that_stops_and_starts_takes_no_longer():
    """Within the last seconds its rate may fall by any factor; carried back that is no rate of anything."""
    seconds = np.arange(0.0, 60.0, 0.1)
    rate = 0.5 * np.where((seconds > 8) & (seconds < 18) | (seconds > 33) & (seconds < 43), 0.0, 1.0)
    rate[-40:] = 0.5 * np.exp(-2.0 * (seconds[-40:] - seconds[-40]))
    turned = np.concatenate([[0.0], np.cumsum(rate[:-1] * 0.1)])
    angle = dict(zip(seconds, turned, strict=True))
    poses = scan(lambda t: exp_so3(np.array([0.0, angle[t], 0.0])), seconds)
    assert fit_dynamics(poses, NOISE, EXTENT).kind == NOT_TORQUE_FREE
