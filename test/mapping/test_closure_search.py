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

"""Probability of a closure, and the order in which candidates are verified."""

import numpy as np
import pytest
from candidate_turns import SECOND, STEP, indices, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from debris_scanner.core.geometry import exp_so3
from debris_scanner.mapping.closure_search import (
    ClosureSearchSettings,
    attitude_probability,
    candidates,
    joint_probability,
    relative_angle,
)

AXIS = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
START = exp_so3(np.array([0.3, 0.8, -0.4]))


def turned(*angles):
    return np.array([START @ exp_so3(a * AXIS) for a in angles])


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-4, 1.0, np.pi / 2, np.pi - 1e-6, np.pi])
def test_angle_keeps_the_digits_of_small_angles(angle):
    assert relative_angle(START, turned(angle))[0] == pytest.approx(angle, abs=1e-14, rel=1e-7)


def test_angle_wraps_beyond_half_a_turn():
    # Eq. 2.99 alone would give 350 and 200 degrees.
    angles = np.radians([350.0, 200.0, -170.0])
    np.testing.assert_allclose(
        np.degrees(relative_angle(START, turned(*angles))), [10.0, 160.0, 170.0], atol=1e-6
    )


def test_angle_equals_the_thesis_quaternions():
    rng = np.random.default_rng(2)
    rotations = Rotation.random(200, rng)
    first = rotations[0]
    # Eq. 2.95-2.100: scalar of the composed quaternion, twice its arc cosine, wrapped.
    scalar = (first.inv() * rotations).as_quat()[:, 3]
    phi = 2 * np.arccos(np.clip(scalar, -1, 1))
    phi = np.where(phi > np.pi, phi - 2 * np.pi, phi)
    ours = relative_angle(first.as_matrix(), rotations.as_matrix())
    np.testing.assert_allclose(ours, np.abs(phi), atol=1e-7)


def test_angle_does_not_depend_on_the_direction_of_the_poses():
    rotations = Rotation.random(50, np.random.default_rng(4)).as_matrix()
    np.testing.assert_allclose(
        relative_angle(rotations[0], rotations),
        relative_angle(rotations[0].T, rotations.transpose(0, 2, 1)),
        atol=1e-12,
    )


def test_attitude_probability_falls_linearly():
    p = attitude_probability(START, turned(0.0, np.pi / 4, np.pi / 2, np.pi))
    np.testing.assert_allclose(p, [1.0, 0.75, 0.5, 0.0], atol=1e-7)


def test_slightly_drifted_rotations_stay_within_bounds():
    p = attitude_probability(START * (1 + 1e-12), np.array([START, -START, turned(np.pi)[0] * (1 - 1e-9)]))
    assert np.isfinite(p).all()
    assert (p >= 0).all()
    assert (p <= 1).all()


def test_joint_is_the_geometric_mean():
    np.testing.assert_allclose(
        joint_probability(np.array([0.25, 1.0, 0.0]), np.array([1.0, 0.64, 1.0])), [0.5, 0.8, 0.0]
    )


def test_nothing_earlier():
    assert candidates(*turn([])) == []


def test_inputs_are_left_alone(full_turn):
    before = [np.copy(a) for a in full_turn]
    candidates(*full_turn)
    for a, b in zip(before, full_turn, strict=True):
        np.testing.assert_array_equal(a, b)


def test_candidates_try_peaks_before_their_neighbours():
    p = np.full(30, 0.1) - np.arange(30) * 1e-3
    p[4:9] = 0.6, 0.8, 0.9, 0.85, 0.5
    p[12] = 0.7
    order = indices(candidates(*turn(p)))
    assert order[:3] == [6, 12, 0]
    # All that have a better neighbour follow, again best first.
    assert order[order.index(7) :][:4] == [7, 5, 4, 8]


def test_candidates_lie_far_enough_back():
    stamps, p, paths, path = turn(np.full(36, 0.5))
    found = candidates(stamps, p, paths, path, ClosureSearchSettings(min_path=np.radians(95.0)))
    assert sorted(indices(found)) == list(range(27))


def test_an_excluded_frame_does_not_hold_its_neighbour_back():
    stamps, p, paths, path = turn([0.1, 0.2, 0.9])
    found = candidates(stamps, p, paths, path, ClosureSearchSettings(min_path=1.5 * STEP))
    assert indices(found) == [1, 0]


def test_named_are_some_of_the_first_but_all_count_in_the_order(full_turn):
    everything = indices(candidates(*full_turn))
    even = np.arange(36) % 2 == 0
    found = indices(candidates(*full_turn, among=even, most=3))
    assert found == [k for k in everything if k % 2 == 0][:3]
    assert found != indices(candidates(*full_turn))[:3]


@settings(derandomize=True, max_examples=80)
@given(st.lists(st.sampled_from([0.1, 0.2, 0.5, 0.7, 0.9]), max_size=40), st.integers(0, 3))
def test_candidates_are_a_ranking(probabilities, neighbours):
    arrays = turn(probabilities)
    found = candidates(*arrays, ClosureSearchSettings(min_path=0.0, neighbours=neighbours))
    assert sorted(indices(found)) == list(range(len(probabilities)))
    if not found:
        return
    assert found[0].probability == max(probabilities)
    drops = [k for k in range(1, len(found)) if found[k].probability > found[k - 1].probability]
    assert len(drops) <= 1  # two runs: peaks, then the others
    for c in found:
        assert (c.stamp_ns, c.probability) == (c.index * SECOND, probabilities[c.index])
