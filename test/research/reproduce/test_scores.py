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

"""The table's figures on poses whose errors are known."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import ClosureRecord, StampedPose
from debris_scanner.research.reproduce.scores import COLUMNS, after_one_turn, drift_at, row

METRICS = {
    'attitude_deg': {'median': 0.5, 'p95': 1.0, 'max': 1.5},
    'model_mm': {'median': 0.5, 'rmse': 1.234, 'p95': 2.0},
    'closures': {'precision': 0.0, 'recall': 1 / 3, 'false': 1},  # by the pose: not the thesis's measure
    'completeness': 0.9,
    'verdict': 'right',
    'why': 'a model within bounds',
}


def turning(n, step, shift=0.0):
    """A target at 1 m that turns by ``step`` degrees a frame, and moves by ``shift`` metres a frame."""
    return {
        k: transform(exp_so3(np.array([0, np.radians(step) * k, 0])), np.array([shift * k, 0, 1.0]))
        for k in range(n)
    }


def test_a_turn_is_over_when_the_steps_sum_up_to_it():
    assert after_one_turn(turning(80, 10.0)) == 36
    assert after_one_turn(turning(36, 10.0)) is None
    back_and_forth = {k: transform(exp_so3(np.array([0, 0.5 * (k % 2), 0])), np.zeros(3)) for k in range(40)}
    assert after_one_turn(back_and_forth) == 13


def test_drift_is_what_the_odometry_is_off_by_wherever_its_frame_lies():
    truth = turning(40, 10.0)
    elsewhere = transform(exp_so3(np.array([0.3, -0.2, 1.0])), np.array([0.4, 0.1, -0.9]))
    drifting = turning(40, 10.5, 0.001)
    poses = [StampedPose(k, T @ elsewhere) for k, T in drifting.items()]
    angle, distance = drift_at(truth, poses, 36)
    assert np.degrees(angle) == pytest.approx(18.0, abs=1e-6)
    assert distance == pytest.approx(0.036, abs=1e-9)


def test_drift_is_taken_at_the_last_pose_before_the_turn():
    truth = turning(40, 10.0)
    poses = [StampedPose(k, T) for k, T in turning(21, 11.0).items()]
    assert np.degrees(drift_at(truth, poses, 36)[0]) == pytest.approx(20.0, abs=1e-6)
    assert drift_at(truth, poses[:1], 36) is None


def test_row_has_every_column_and_counts_proposals():
    truth = turning(40, 10.0)
    poses = [StampedPose(k, T) for k, T in truth.items()]
    closures = [
        ClosureRecord(0, 36, 0.9, True, ''),
        ClosureRecord(1, 37, 0.8, False, ''),
        ClosureRecord(0, 20, 0.7, False, ''),
        ClosureRecord(0, 30, 0.7, False, ''),
    ]
    line = row(truth, poses, closures, range(0, 40, 2), METRICS, 12.34)
    assert set(COLUMNS) <= set(line)
    assert (line['drift_deg'], line['drift_mm']) == (0.0, 0.0)
    assert (line['closures'], line['proposed'], line['proposed_precision']) == (1, 4, 0.5)
    assert line['closure_error_deg'] == pytest.approx(0.0, abs=0.01)
    # by attitude: of the key frames only 36 and 38 return, and a closure ends at 36
    assert (line['precision'], line['recall']) == (1.0, 0.5)
    assert (line['model_rmse_mm'], line['wall_s']) == (1.23, 12.3)


def test_the_thesis_judges_attitudes_wherever_the_pose_was_registered():
    truth = turning(40, 10.0)
    misplaced = transform(np.eye(3), np.array([0.5, 0, 0]))
    closures = [
        ClosureRecord(0, 36, 0.9, True, '', misplaced),
        ClosureRecord(0, 30, 0.9, True, '', truth[0] @ np.linalg.inv(truth[30])),
    ]
    line = row(truth, [], closures, range(0, 40, 2), METRICS, 1.0)
    assert (line['precision'], line['proposed_precision']) == (0.5, 0.5)


def test_closure_error_is_the_true_angle_of_the_accepted():
    truth = turning(40, 10.0)
    closures = [ClosureRecord(0, 34, 0.9, True, ''), ClosureRecord(0, 20, 0.9, False, '')]
    assert row(truth, [], closures, [], METRICS, 1.0)['closure_error_deg'] == pytest.approx(20.0)


def test_row_of_nothing_says_so():
    missing = {**METRICS, 'attitude_deg': None, 'model_mm': None, 'completeness': None}
    line = row(turning(5, 1.0), [], [], [], missing, 1.0)
    for key in ('drift_deg', 'drift_mm', 'attitude_max_deg', 'model_rmse_mm', 'completeness'):
        assert line[key] is None
    assert line['proposed_precision'] is None
    assert line['closure_error_deg'] is None
