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

"""Errors of estimated poses against the true ones: alignment, pose errors, drift; closures by attitude."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import scipy

from debris_scanner.core.geometry import Array, exp_so3, inverse, log_so3, transform
from debris_scanner.core.results import ClosureRecord, StampedPose

# The thesis's measure: a closure is true when the two frames' true attitudes differ by no more.
TRUE_CLOSURE_RAD = np.radians(10.0)
# A key frame revisits an earlier one only if the target was turned farther away in between.
_LEFT_RAD = np.radians(45.0)

# Errors below these count quadratically in the alignment, larger ones linearly.
_SMALL_RAD = 0.003
_SMALL_M = 0.0005
_ITERATIONS = 30
_TILT_ITERATIONS = 100

Poses = Mapping[int, Array]  # T_sensor_target (4, 4) by stamp, nanoseconds
Scores = dict[str, float | int | None]  # precision, recall, false


def by_stamp(poses: Sequence[StampedPose]) -> dict[int, Array]:
    """The poses by their stamps."""
    return {pose.stamp_ns: pose.T_sensor_target for pose in poses}


def align(truth: Poses, estimate: Poses) -> Array:
    """T_truth_target (4, 4): the one constant that maps the estimate's target frame into the true one.

    It is the median over the frames' own alignments, rotation and origin separately, so that a minority of
    wrong poses does not bias it.

    Raises:
        ValueError: no frame is in both.
    """
    stamps = sorted(truth.keys() & estimate.keys())
    if not stamps:
        raise ValueError('no estimated pose has the stamp of a true one')
    each = np.array([inverse(truth[s]) @ estimate[s] for s in stamps])
    return transform(_median_rotation(each[:, :3, :3]), _median_point(each[:, :3, 3]))


def pose_errors(truth: Poses, estimate: Poses, T_truth_target: Array) -> tuple[Array, Array]:
    """Attitude errors (n,) in radians and errors of the target frame's origin (n,) in metres.

    One of each for every frame that is in both, by stamp.
    """
    stamps = sorted(truth.keys() & estimate.keys())
    attitude, position = np.zeros(len(stamps)), np.zeros(len(stamps))
    for k, stamp in enumerate(stamps):
        expected, found = truth[stamp] @ T_truth_target, estimate[stamp]
        attitude[k] = np.linalg.norm(log_so3(expected[:3, :3].T @ found[:3, :3]))
        position[k] = np.linalg.norm(expected[:3, 3] - found[:3, 3])
    return attitude, position


def without_tilt(truth: Poses, estimate: Poses) -> tuple[float, Array]:
    """A rotation that is the same in the sensor's frame in all frames (rad), and the errors (n,) without it.

    A smooth offset of a sensor's depth tilts all that it sees. A target that turns before it looks the same
    with and without, so that no scan can tell it. About the axis of a spin it is one with the alignment.
    """
    stamps = sorted(truth.keys() & estimate.keys())
    true = scipy.spatial.transform.Rotation.from_matrix([truth[s][:3, :3] for s in stamps])
    found = scipy.spatial.transform.Rotation.from_matrix([estimate[s][:3, :3] for s in stamps])
    tilt = scipy.spatial.transform.Rotation.identity()
    for _ in range(_TILT_ITERATIONS):
        aligned = ((tilt * true).inv() * found).mean()
        tilt = (found * (true * aligned).inv()).mean()
    rest = found * (tilt * true * aligned).inv()
    return float(tilt.magnitude()), np.asarray(rest.magnitude())


def drift(truth: Poses, odometry: Poses, closure_ns: int) -> tuple[float, float] | None:
    """Odometry's attitude error (rad) and origin error (m) at a closure, tied to the truth at the start.

    Taken at the last odometry pose not after the closure; None where truth or odometry has none.
    """
    stamps = sorted(s for s in truth.keys() & odometry.keys() if s <= closure_ns)
    if len(stamps) < 2:
        return None
    first, last = stamps[0], stamps[-1]
    T_truth_target = inverse(truth[first]) @ odometry[first]
    attitude, position = pose_errors({last: truth[last]}, odometry, T_truth_target)
    return float(attitude[0]), float(position[0])


def turned(truth: Sequence[Array]) -> float:
    """Total rotation of the target, radians: the sum of the angles from frame to frame."""
    return float(accumulated_rotation(truth)[-1]) if truth else 0.0


def accumulated_rotation(truth: Sequence[Array]) -> Array:
    """Rotation of the target (n,) up to each frame, radians: the angles from frame to frame add up."""
    steps = np.array([log_so3(a[:3, :3].T @ b[:3, :3]) for a, b in pairwise(truth)]).reshape(-1, 3)
    return np.concatenate([np.zeros(min(len(truth), 1)), np.cumsum(np.linalg.norm(steps, axis=1))])


def is_true(truth: Poses, closure: ClosureRecord) -> bool | None:
    """Whether the two frames' true attitudes agree, as the thesis has it; None where the truth lacks one."""
    if closure.from_stamp_ns not in truth or closure.to_stamp_ns not in truth:
        return None
    a, b = truth[closure.from_stamp_ns], truth[closure.to_stamp_ns]
    return bool(np.linalg.norm(log_so3(a[:3, :3].T @ b[:3, :3])) <= TRUE_CLOSURE_RAD)


def attitude_closure_scores(
    truth: Poses, closures: Sequence[ClosureRecord], keyframes_ns: Sequence[int]
) -> Scores:
    """Precision, recall and false positives of the accepted closures by the thesis's measure.

    Recall regards the key frames that truly return to the attitude of an earlier one.
    """
    judged = [(c, is_true(truth, c)) for c in closures if c.accepted]
    return score(judged, revisiting(truth, keyframes_ns))


def score(judged: Sequence[tuple[ClosureRecord, bool | None]], revisits: set[int]) -> Scores:
    """Precision, recall and number of false ones; None where it would divide by zero.

    Args:
        judged: accepted closures and whether each is true; one that the truth does not cover counts nowhere.
        revisits: stamps of the key frames at which a true closure should end.
    """
    right = [c for c, true in judged if true]
    wrong = sum(true is False for _, true in judged)
    found = revisits & {c.to_stamp_ns for c in right}
    return {
        'precision': len(right) / (len(right) + wrong) if right or wrong else None,
        'recall': len(found) / len(revisits) if revisits else None,
        'false': wrong,
    }


def revisiting(truth: Poses, keyframes_ns: Sequence[int]) -> set[int]:
    """Stamps of key frames that return to the true attitude of an earlier one after leaving it."""
    stamps = sorted(s for s in keyframes_ns if s in truth)
    if len(stamps) < 3:
        return set()
    rotations = np.array([truth[s][:3, :3] for s in stamps])
    cosine = (np.einsum('aij,bij->ab', rotations, rotations) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    found = set()
    for j, row in enumerate(angle):
        farthest = np.maximum.accumulate(row[j:])
        back = (row[j:] <= TRUE_CLOSURE_RAD) & (farthest > _LEFT_RAD)
        found |= {stamps[j + int(k)] for k in np.flatnonzero(back)}
    return found


def _median_rotation(rotations: Array) -> Array:
    """Rotation (3, 3) with the least sum of angles to the given ones (n, 3, 3)."""
    # start at the rotation nearest to all others: the mean of two clusters belongs to neither
    some = rotations[:: max(1, len(rotations) // 200)]
    cosine = (np.einsum('aij,bij->ab', some, some) - 1) / 2
    R = some[int(np.arccos(np.clip(cosine, -1, 1)).sum(axis=1).argmin())]
    for _ in range(_ITERATIONS):
        vectors = np.array([log_so3(R.T @ other) for other in rotations])
        weight = 1 / np.maximum(np.linalg.norm(vectors, axis=1), _SMALL_RAD)
        R = R @ exp_so3(weight @ vectors / weight.sum())
    return R


def _median_point(points: Array) -> Array:
    """Point (3,) with the least sum of distances to the given ones (n, 3)."""
    point = np.median(points, axis=0)
    for _ in range(_ITERATIONS):
        weight = 1 / np.maximum(np.linalg.norm(points - point, axis=1), _SMALL_M)
        point = weight @ points / weight.sum()
    return np.asarray(point)
