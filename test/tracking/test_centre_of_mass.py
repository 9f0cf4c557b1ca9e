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

"""Centre of mass and its path, from noisy poses of motions whose truth is known."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.sim.motions import MotionSettings, clohessy_wiltshire, make_motion
from debris_scanner.sim.tumble import TorqueFreeBody
from debris_scanner.tracking.centre_of_mass import fit_centre

NOISE, EXTENT = np.radians(0.05), 0.3
BENCH = 2 * np.pi / 40  # rad/s, mean motion of the simulator's orbit
CENTRE = np.array([0.012, -0.012, 0.0106])  # of mass, target frame


def poses_of(attitude, centre_at, seconds, seed):
    rng, poses = np.random.default_rng(seed), []
    for t in seconds:
        R = attitude(t)
        error = transform(exp_so3(NOISE * rng.normal(size=3)), 2e-4 * rng.normal(size=3))
        T = compose(transform(R, centre_at(t) - R @ CENTRE), error)
        poses.append(StampedPose(round((t + 1) * 1e9), T))
    return poses


def tumbling(t_max=125.0):
    return TorqueFreeBody(np.array([1.0, 0.8, 0.5]), np.eye(3), np.array([0.2, 0.4, 0.15]), t_max).attitude


def errors(poses, attitude, centre_at, mean_motion, last_s):
    """Of the centre, m, and of the position half a minute ahead, m, and that in standard deviations."""
    found = fit_centre(poses, NOISE, EXTENT, mean_motion)
    ahead = np.array([30.0])
    R = np.array([attitude(last_s + 30.0)])
    p, covariance = found.target_at(poses[-1].stamp_ns, ahead, R)
    missed = p[0] - (centre_at(last_s + 30.0) - R[0] @ CENTRE)
    sigmas = np.sqrt(np.diag(covariance[0]))
    return np.linalg.norm(found.point - CENTRE), np.linalg.norm(missed), np.abs(missed / sigmas).max()


@pytest.mark.parametrize('seed', range(3))
def test_before_an_observer_on_an_orbit_the_centre_follows_it(seed):
    motion = make_motion(MotionSettings('clohessy_wiltshire', seed=seed, duration_s=60.0))
    attitude, seconds = tumbling(), np.arange(0.0, 60.0, 0.4)

    def centre_at(t):
        return motion.T_sensor_target(t)[:3, 3]

    poses = poses_of(attitude, centre_at, seconds, seed)
    of_orbit = errors(poses, attitude, centre_at, BENCH, seconds[-1])
    of_line = errors(poses, attitude, centre_at, 0.0, seconds[-1])
    assert of_orbit[0] < 1e-3 and of_orbit[1] < 1e-3 and of_orbit[2] < 5
    assert of_line[0] > 5 * of_orbit[0] and of_line[1] > 20 * of_orbit[1]


def test_a_low_orbit_is_no_worse_than_a_line():
    """In a minute it hardly bends: what noise would bend it by is held to what the orbit can do."""
    mean_motion, attitude = 0.00113, tumbling()
    seconds = np.arange(0.0, 25.0, 0.2)

    def centre_at(t):
        x, y, z = clohessy_wiltshire(
            t, np.array([8.0, 1.0, -2.0]), np.array([0.01, -0.018, 0.004]), mean_motion
        )
        return np.array([y, z, x])

    missed = [
        [errors(poses, attitude, centre_at, n, seconds[-1])[1:] for n in (mean_motion, 0.0)]
        for poses in (poses_of(attitude, centre_at, seconds, seed) for seed in range(8))
    ]
    of_orbit, of_line = np.median(missed, axis=0)
    assert of_orbit[0] < of_line[0]
    assert of_orbit[1] < 3
