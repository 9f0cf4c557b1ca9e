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

"""Which similarity discriminates the same face from others: ROC areas of one case.

A scan searches for closures only until it has a model, after little more than a revolution, which gives too
few pairs of views. So the same odometry and descriptors run over the full recording without a model, with the
drift that this has. Pairs with less than half a revolution between are left out: they are similar merely
because the target has rotated little, and no closure may join them.

Two questions. A description alone is invariant to roll about the line of sight, so it is tested for the same
face at any roll. Joined with the attitude it is not, so it is tested for the same attitude. In a tumble faces
return rolled, and the same attitude within ten degrees seldom returns at all.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.evaluation.trajectory_errors import TRUE_CLOSURE_RAD, Poses
from debris_scanner.mapping.closure_matrices import ClosureMatrices
from debris_scanner.mapping.closure_search import joint_probability, relative_angle
from debris_scanner.report.discrimination import area_under, roc
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector, make_odometry

# Names of closure_matrices.MEASURES, and their titles: the thesis's binary descriptor is thresholded at each
# histogram's own median, ours bin by bin.
MEASURES = {'float': 'float', 'binary': 'binary, median', 'per_bin': 'binary, per bin'}
ATTITUDE = 'attitude'
_HALF_TURN = np.pi
_LEAST = 5  # pairs of a kind that an area needs


class SimilarityRun:
    """Odometry and descriptions of a recording, without a model."""

    def __init__(self, settings: Settings) -> None:
        self._odometry = make_odometry(settings)
        self._detector = make_closure_detector(settings)
        self._path: list[float] = []

    def add(self, frame: TargetFrame) -> None:
        """Process the next target frame."""
        keyframe = self._odometry.process(frame).keyframe
        if keyframe is not None:
            self._detector.remember(keyframe)
            self._path.append(keyframe.path_rad)

    def areas(self, truth: Poses) -> dict[str, Any] | None:
        """Areas under the ROC of each measure, alone and joined with the attitude; None without key frames.

        Args:
            truth: true T_sensor_target (4, 4) by stamp.
        """
        matrices = ClosureMatrices.of(self._detector.descriptions)
        n = len(matrices.stamps_ns)
        if n == 0:
            return None
        path = np.array(self._path[-n:])
        later, earlier = np.nonzero(path[:, None] - path[None] >= _HALF_TURN)
        poses = np.array([truth[int(s)] for s in matrices.stamps_ns])
        same_face = _face_angle(poses)[later, earlier] <= TRUE_CLOSURE_RAD
        same_attitude = _attitude_angle(poses)[later, earlier] <= TRUE_CLOSURE_RAD
        attitude = matrices.by_measure[ATTITUDE].astype(np.float64)
        areas = {ATTITUDE: _area(attitude[later, earlier], same_attitude)}
        for measure in MEASURES:
            alone = matrices.by_measure[measure].astype(np.float64)
            joint = joint_probability(alone, attitude)
            areas[measure] = _area(alone[later, earlier], same_face)
            areas[f'{measure}_joint'] = _area(joint[later, earlier], same_attitude)
        counts = {'same_face': int(same_face.sum()), 'same_attitude': int(same_attitude.sum())}
        return {'keyframes': n, 'pairs': len(later), **counts, 'area': areas}


def _area(score: Array, same: NDArray[np.bool_]) -> float | None:
    """Area under the ROC, or None where too few pairs are the same or differ."""
    if min(same.sum(), (~same).sum()) < _LEAST:
        return None
    return round(area_under(*roc(score, same)), 4)


def _attitude_angle(poses: Array) -> Array:
    """Angle (n, n) between the true attitudes of poses T_sensor_target (n, 4, 4), radians."""
    return np.array([relative_angle(R, poses[:, :3, :3]) for R in poses[:, :3, :3]])


def _face_angle(poses: Array) -> Array:
    """Angle (n, n) between the directions from which the target is seen, in its own frame, radians."""
    sight = np.einsum('aij,ai->aj', poses[:, :3, :3], poses[:, :3, 3])
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    return np.arccos(np.clip(sight @ sight.T, -1, 1))
