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

"""One method's line in the table: what ``evaluate`` says, and the drift after the first turn."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from debris_scanner.core.geometry import Array, inverse, log_so3, rotation_angle
from debris_scanner.core.results import ClosureRecord, StampedPose
from debris_scanner.evaluation.trajectory_errors import attitude_closure_scores, by_stamp, is_true

# Keys of a line, and how the table heads them.
COLUMNS = {
    'drift_deg': 'drift after one turn, °',
    'drift_mm': 'drift, mm',
    'closures': 'closures',
    'precision': 'precision',
    'recall': 'recall',
    'attitude_median_deg': 'attitude error, median °',
    'attitude_max_deg': 'max °',
    'model_rmse_mm': 'model RMSE, mm',
    'completeness': 'completeness',
    'wall_s': 'wall time, s',
    'verdict': 'verdict',
}

ROUNDING = 1e-6  # rad: a turn is a turn


def after_one_turn(truth: Mapping[int, Array]) -> int | None:
    """Stamp of the first frame by which the target has turned once round; None where it never has."""
    stamps = sorted(truth)
    path = 0.0
    for before, after in pairwise(stamps):
        path += float(np.linalg.norm(log_so3(truth[before][:3, :3].T @ truth[after][:3, :3])))
        if path >= 2 * np.pi - ROUNDING:
            return after
    return None


def drift_at(
    truth: Mapping[int, Array], poses: Sequence[StampedPose], stamp_ns: int
) -> tuple[float, float] | None:
    """Attitude error (rad) and error of the true target's centre (m), tied to the truth at the start.

    Taken at the last pose not after the stamp. Every method's target frame is moved onto the true one
    first, so that none has a longer lever than another.
    """
    estimate = by_stamp(poses)
    stamps = sorted(s for s in truth.keys() & estimate.keys() if s <= stamp_ns)
    if len(stamps) < 2:
        return None
    first, last = stamps[0], stamps[-1]
    found = estimate[last] @ inverse(estimate[first]) @ truth[first]
    turned = rotation_angle(truth[last][:3, :3].T @ found[:3, :3])
    return float(turned), float(np.linalg.norm(found[:3, 3] - truth[last][:3, 3]))


def row(
    truth: Mapping[int, Array],
    odometry: Sequence[StampedPose],
    closures: Sequence[ClosureRecord],
    keyframes_ns: Sequence[int],
    metrics: Mapping[str, Any],
    wall_s: float,
) -> dict[str, Any]:
    """The line; None where a figure does not apply.

    Args:
        truth: T_sensor_target by stamp.
        odometry: the method's poses before any closure.
        closures: all that it tried; judged by the thesis's measure, for every method.
        keyframes_ns: stamps of its key frames.
        metrics: of its result, as ``evaluate`` gives them.
        wall_s: time it took.
    """
    turn = after_one_turn(truth)
    drift = None if turn is None else drift_at(truth, odometry, turn)
    attitude, model = metrics['attitude_deg'], metrics['model_mm']
    scores = attitude_closure_scores(truth, closures, keyframes_ns)
    proposed = [is_true(truth, c) for c in closures]
    return {
        'drift_deg': drift and round(float(np.degrees(drift[0])), 2),
        'drift_mm': drift and round(drift[1] * 1e3, 2),
        'closures': sum(c.accepted for c in closures),
        'precision': _rounded(scores['precision']),
        'recall': _rounded(scores['recall']),
        # how far the accepted ones really are from closing, whatever counts as true
        'closure_error_deg': _closure_error(truth, closures),
        'proposed': len(proposed),
        'proposed_precision': _rounded(sum(map(bool, proposed)) / len(proposed) if proposed else None),
        'attitude_median_deg': attitude and round(attitude['median'], 2),
        'attitude_max_deg': attitude and round(attitude['max'], 2),
        'model_rmse_mm': model and round(model['rmse'], 2),
        'completeness': _rounded(metrics['completeness']),
        'wall_s': round(wall_s, 1),
        'verdict': metrics['verdict'],
        'why': metrics['why'],
    }


def _closure_error(truth: Mapping[int, Array], closures: Sequence[ClosureRecord]) -> float | None:
    """Median angle between the true attitudes of the frames that accepted closures join, degrees."""
    pairs = [(c.from_stamp_ns, c.to_stamp_ns) for c in closures if c.accepted]
    angles = [
        rotation_angle(truth[a][:3, :3].T @ truth[b][:3, :3]) for a, b in pairs if a in truth and b in truth
    ]
    return round(float(np.degrees(np.median(angles))), 2) if angles else None


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
