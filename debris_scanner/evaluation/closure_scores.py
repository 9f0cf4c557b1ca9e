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

"""Precision and recall of a scan's closures, judged by the relative poses that were registered.

A closure of another attitude may be registered right, and one of the same attitude wrong, so only the
relative pose tells. The thesis's measure, by attitude alone, is in `trajectory_errors`.
"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.core.geometry import apply, compose, inverse, rotation_angle
from debris_scanner.core.results import ClosureRecord
from debris_scanner.evaluation.trajectory_errors import (
    Poses,
    Scores,
    accumulated_rotation,
    attitude_closure_scores,
    score,
)

BY_POSE, BY_ATTITUDE = 'pose', 'attitude'

# A closure is true when its registered relative pose is off by no more; design, "How good is good".
TRUE_POSE_RAD = np.radians(2.0)
TRUE_POSE_SHARE = 0.02  # of the target's size

# A key frame looks at a face again when an earlier one looked from this near, this much rotation before.
NEARBY_RAD = np.radians(15.0)
AGAIN_RAD = np.pi
_ROUNDING = 1e-6  # rad: half a turn is half a turn


def closure_scores(
    truth: Poses, closures: Sequence[ClosureRecord], keyframes_ns: Sequence[int], size: float
) -> tuple[Scores, str]:
    """Precision, recall and false positives of the accepted closures; and what they were judged by.

    Precision is the share of true closures among those accepted. Recall regards the key frames that look at
    the target from where an earlier one did: it is the share of them at which a true accepted closure ends.
    A search that takes one good closure of many equivalent pairs has missed nothing. Either is None where it
    would divide by zero.

    Earlier releases kept no poses. If an accepted closure has none, all are judged by the thesis's measure.

    Args:
        truth: T_sensor_target of the frames.
        closures: the hypotheses.
        keyframes_ns: stamps of the key frames.
        size: largest extent of the target, metres.
    """
    accepted = [c for c in closures if c.accepted]
    if any(c.T_from_to is None for c in accepted):
        return attitude_closure_scores(truth, closures, keyframes_ns), BY_ATTITUDE
    judged = [(c, has_true_pose(truth, c, size)) for c in accepted]
    return score(judged, seen_again(truth, keyframes_ns)), BY_POSE


def has_true_pose(truth: Poses, closure: ClosureRecord, size: float) -> bool | None:
    """Whether the registered relative pose is the true one; None where the truth lacks a frame.

    The shift is that of the target's origin. At the sensor's, far from the target, the error of the rotation
    would count a second time.

    Args:
        truth: T_sensor_target of the frames.
        closure: with its pose; False without.
        size: largest extent of the target, metres.
    """
    if closure.from_stamp_ns not in truth or closure.to_stamp_ns not in truth:
        return None
    found = closure.T_from_to
    if found is None:
        return False
    T_from_target, T_to_target = truth[closure.from_stamp_ns], truth[closure.to_stamp_ns]
    T_from_to = compose(T_from_target, inverse(T_to_target))
    turn = rotation_angle(T_from_to[:3, :3].T @ found[:3, :3])
    shift = float(np.linalg.norm(apply(found, T_to_target[:3, 3]) - T_from_target[:3, 3]))
    return bool(turn <= TRUE_POSE_RAD and shift <= TRUE_POSE_SHARE * size)


def seen_again(truth: Poses, keyframes_ns: Sequence[int]) -> set[int]:
    """Stamps of key frames that look at the target from where an earlier one did, half a turn or more ago.

    From where: from directions, in the target frame, within 15 degrees, however rolled. A turn is the
    rotation that adds up from frame to frame.
    """
    every = sorted(truth)
    path = dict(zip(every, accumulated_rotation([truth[s] for s in every]), strict=True))
    stamps = sorted(s for s in keyframes_ns if s in truth)
    sensors = np.array([inverse(truth[s])[:3, 3] for s in stamps]).reshape(-1, 3)
    directions = sensors / np.maximum(np.linalg.norm(sensors, axis=1, keepdims=True), 1e-9)
    near = directions @ directions.T >= np.cos(NEARBY_RAD)
    paths = np.array([path[s] for s in stamps])
    ago = paths - paths[:, None] >= AGAIN_RAD - _ROUNDING  # row: the earlier one
    return {stamps[k] for k in np.flatnonzero((near & ago).any(axis=0))}
