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

"""Frame-to-frame ICP against PCL, and prealignment."""

import numpy as np
import pytest

from debris_scanner.core.geometry import apply, exp_se3
from debris_scanner.research.thesis.frame_registration import mean_square_distance, register_points

# Ties between neighbours fall the other way than in PCL, hence rotation and metres at the cloud's centre.
TOLERANCES = {1: (4e-5, 1e-5), 10: (4e-4, 7e-5), 200: (4e-4, 7e-5)}


@pytest.fixture(scope='module')
def pairs(golden):
    cases, icp = np.load(golden / 'cases.npz'), np.load(golden / 'icp.npz')
    return [
        (cases[f'c{2 * i + 1:02d}_voxel'], cases[f'c{2 * i:02d}_voxel'], icp['icp_T'][i], icp['icp_info'][i])
        for i in range(6)
    ]


@pytest.mark.parametrize(('setting', 'iterations'), [(0, 1), (1, 10), (2, 200)])
def test_agrees_with_pcl_from_one_iteration_to_convergence(pairs, setting, iterations):
    rotation, metres = TOLERANCES[iterations]
    for source, target, T_pcl, info in pairs:
        a = register_points(source, target, 0.01, iterations, 1e-12)
        T, reference = a.T_target_source, T_pcl[setting].astype(float)
        assert np.abs(T[:3, :3] - reference[:3, :3]).max() < rotation
        centre = source.mean(axis=0, dtype=float)
        assert np.linalg.norm(apply(T, centre) - apply(reference, centre)) < metres
        assert a.fitness == pytest.approx(float(info[setting, 0]), rel=0.01)


def test_fitness_is_the_mean_squared_distance_of_all_points():
    target = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = target + [[0.1, 0, 0], [0, 0, 0.2], [0, 0, 0]]
    assert mean_square_distance(points, target) == pytest.approx((0.01 + 0.04) / 3)


def test_recovers_a_small_motion_and_repeats_bit_for_bit():
    rng = np.random.default_rng(4)
    cloud = rng.uniform(-0.1, 0.1, (3000, 3)) + [0, 0, 0.8]
    T = exp_se3(np.array([0.004, -0.003, 0.002, 0.001, 0.0, -0.001]))
    moved = apply(np.linalg.inv(T), cloud)
    first, again = (register_points(moved, cloud, 0.01, 100) for _ in range(2))
    assert np.allclose(first.T_target_source, T, atol=1e-9)
    assert first.fitness < 1e-18
    assert first.matched == 1.0
    assert first.T_target_source.tobytes() == again.T_target_source.tobytes()


def test_clouds_apart_and_empty_clouds_have_no_alignment():
    cloud = np.random.default_rng(1).uniform(0, 0.1, (100, 3))
    assert register_points(cloud, cloud + 5.0) is None
    assert register_points(cloud[:0], cloud) is None


def test_more_iterations_do_not_fit_worse(pairs):
    source, target, _, _ = pairs[3]
    fits = [register_points(source, target, 0.01, n).fitness for n in (1, 10, 200)]
    assert fits == sorted(fits, reverse=True)
    assert fits[2] < 0.8 * fits[0]
