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

""""""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, inverse, transform
from debris_scanner.core.results import ClosureRecord
from debris_scanner.evaluation.trajectory_errors import (
    accumulated_rotation,
    align,
    attitude_closure_scores,
    drift,
    is_true,
    pose_errors,
    revisiting,
    turned,
    without_tilt,
)

S = 1_000_000_000
T_TRUTH_TARGET = transform(exp_so3(np.array([0.3, -1.2, 0.7])), np.array([0.02, 0.01, -0.03]))


def spin(count=126, step_deg=3.0):
    """Truth by stamp: a little more than one turn, one frame a second."""
    axis = np.array([0.2, -0.9, 0.1]) / np.linalg.norm([0.2, -0.9, 0.1])
    return {
        k * S: transform(exp_so3(np.radians(step_deg * k) * axis), np.array([0.01, 0.02, 0.8]))
        for k in range(count)
    }


def closure(a, b, accepted=True):
    return ClosureRecord(a * S, b * S, 0.9, accepted, '')


def turned_by(T, degrees, axis=(0, 0, 1)):
    """The pose with its attitude changed about the target's origin."""
    return compose(T, transform(exp_so3(np.radians(degrees) * np.array(axis, float)), np.zeros(3)))


def test_a_tilt_of_the_sensor_is_told_apart():
    truth, tilt = spin(), exp_so3(np.radians(1.5) * np.array([0.0, 0.0, 1.0]))
    estimate = {s: turned_by(T @ T_TRUTH_TARGET, 0.0) for s, T in truth.items()}
    estimate = {s: transform(tilt @ T[:3, :3], T[:3, 3]) for s, T in estimate.items()}
    found, rest = without_tilt(truth, estimate)
    # the part about the spin axis is one with the alignment
    assert 1.35 < np.degrees(found) <= 1.5
    assert np.degrees(rest).max() < 1e-3
    assert np.degrees(np.median(pose_errors(truth, estimate, align(truth, estimate))[0])) > 0.3


def test_perfect_poses_align_exactly():
    truth = spin()
    estimate = {s: T @ T_TRUTH_TARGET for s, T in truth.items()}
    found = align(truth, estimate)
    np.testing.assert_allclose(found, T_TRUTH_TARGET, atol=1e-9)
    attitude, position = pose_errors(truth, estimate, found)
    assert len(attitude) == len(truth)
    assert attitude.max() < 1e-7 and position.max() < 1e-9


def test_a_minority_of_wrong_poses_does_not_bend_the_alignment():
    truth = spin()
    estimate = {
        s: turned_by(T @ T_TRUTH_TARGET, 170 if k % 3 == 0 else 0, (0, 1, 0))
        for k, (s, T) in enumerate(truth.items())
    }
    for k, s in enumerate(truth):
        if k % 3 == 0:
            estimate[s][:3, 3] += 0.3
    np.testing.assert_allclose(align(truth, estimate), T_TRUTH_TARGET, atol=2e-3)
    attitude, position = pose_errors(truth, estimate, align(truth, estimate))
    assert np.degrees(np.median(attitude)) < 0.2 and np.median(position) < 1e-3
    assert np.degrees(attitude.max()) == pytest.approx(170, abs=0.5)
    assert position.max() == pytest.approx(0.3 * np.sqrt(3), abs=2e-3)


def test_noise_on_both_sides_averages_out():
    truth, rng = spin(), np.random.default_rng(0)
    estimate = {
        s: compose(T, T_TRUTH_TARGET, transform(exp_so3(rng.normal(0, 0.01, 3)), rng.normal(0, 0.002, 3)))
        for s, T in truth.items()
    }
    off = inverse(T_TRUTH_TARGET) @ align(truth, estimate)
    assert np.linalg.norm(off[:3, 3]) < 6e-4 and np.arccos((np.trace(off[:3, :3]) - 1) / 2) < 3e-3


def test_frames_without_a_counterpart_are_left_out():
    truth = spin(10)
    estimate = {s: T for s, T in truth.items() if s > 4 * S} | {999 * S: np.eye(4)}
    attitude, _ = pose_errors(truth, estimate, np.eye(4))
    assert len(attitude) == 5
    with pytest.raises(ValueError, match='stamp'):
        align(truth, {999 * S: np.eye(4)})


def test_drift_is_tied_at_the_first_frame_and_read_at_the_closure():
    truth = spin()
    odometry = {}
    for k, (s, T) in enumerate(truth.items()):
        odometry[s] = turned_by(T @ T_TRUTH_TARGET, 0.05 * k)
        odometry[s][:3, 3] += np.array([0, 0.0001 * k, 0])
    found = drift(truth, odometry, 120 * S)
    assert np.degrees(found[0]) == pytest.approx(6.0) and found[1] == pytest.approx(0.012)
    # a closure between two poses takes the earlier one
    assert drift(truth, odometry, 100 * S + 7)[1] == pytest.approx(0.010)
    assert drift(truth, {}, 120 * S) is None
    assert drift(truth, odometry, -1) is None


def test_the_turn_adds_up_however_far_it_goes():
    assert np.degrees(turned(list(spin(241).values()))) == pytest.approx(720)
    assert turned([]) == turned([np.eye(4)]) == 0
    path = accumulated_rotation(list(spin(5).values()))
    np.testing.assert_allclose(np.degrees(path), [0, 3, 6, 9, 12], atol=1e-9)
    assert accumulated_rotation([]).shape == (0,)


def test_for_the_thesis_closures_are_true_within_ten_degrees():
    truth = spin()
    assert is_true(truth, closure(0, 120)) and is_true(truth, closure(0, 117))
    assert is_true(truth, closure(0, 116)) is False
    assert is_true(truth, closure(0, 999)) is None


def test_key_frames_revisit_only_what_they_had_left():
    truth = spin()
    # every second frame is a key frame: neighbours 6 degrees apart are no revisits
    keyframes = [k * S for k in range(0, 126, 2)]
    assert sorted(s // S for s in revisiting(truth, keyframes)) == [118, 120, 122, 124]
    # there and back again within 40 degrees is not leaving
    rock = {k * S: truth[min(k, 26 - k) * S] for k in range(27)}
    assert revisiting(rock, list(rock)) == set()


def test_precision_and_recall_by_attitude():
    truth = spin()
    keyframes = [k * S for k in range(0, 126, 2)]
    closures = [
        closure(0, 120),
        closure(2, 120),
        closure(0, 60),
        closure(4, 122, accepted=False),
        closure(0, 999),
    ]
    scores = attitude_closure_scores(truth, closures, keyframes)
    assert scores == {'precision': pytest.approx(2 / 3), 'recall': pytest.approx(1 / 4), 'false': 1}
    assert attitude_closure_scores(truth, [], []) == {'precision': None, 'recall': None, 'false': 0}
    nothing = attitude_closure_scores(truth, [], keyframes)
    assert nothing == {'precision': None, 'recall': 0.0, 'false': 0}
