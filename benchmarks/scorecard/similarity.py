"""Which similarity tells the same face from another: ROC areas of one case.

A scan stops asking once it has a model, after little more than a turn, and too few pairs of views come of
that. So the same odometry and descriptors run on over the whole recording without ever being given a model;
its attitudes drift as they would. Pairs with less than half a turn between are left out: they are alike
merely because little has turned, and no closure may join them.
"""

from typing import Any

import numpy as np

from debris_scanner.closure_matrices import ClosureMatrices
from debris_scanner.closure_probability import joint_probability
from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array
from debris_scanner.report.discrimination import area_under, roc
from debris_scanner.scanner import make_closure_detector, make_odometry
from debris_scanner.settings import Settings
from debris_scanner.trajectory_errors import TRUE_CLOSURE_RAD, Poses

# Names of closure_matrices.MEASURES, and what they stand for: the thesis's binary is cut at each histogram's
# own median, ours bin by bin.
MEASURES = {'float': 'float', 'binary': 'binary, median', 'per_bin': 'binary, per bin'}
ATTITUDE = 'attitude'
_HALF_TURN = np.pi
_LEAST = 5  # pairs of a kind, below which an area says nothing


class SimilarityRun:
    """Odometry and descriptions of a recording, without a model."""

    def __init__(self, settings: Settings) -> None:
        self._odometry = make_odometry(settings)
        self._detector = make_closure_detector(settings)
        self._path: list[float] = []

    def add(self, frame: TargetFrame) -> None:
        """Take the next target frame."""
        keyframe = self._odometry.process(frame).keyframe
        if keyframe is not None:
            self._detector.remember(keyframe)
            self._path.append(keyframe.path_rad)

    def areas(self, truth: Poses) -> dict[str, Any] | None:
        """Areas under the ROC of each measure, alone and joined with the attitude; None with too few pairs.

        Args:
            truth: true T_sensor_target (4, 4) by stamp.
        """
        matrices = ClosureMatrices.of(self._detector.descriptions)
        n = len(matrices.stamps_ns)
        if n == 0:
            return None
        path = np.array(self._path[-n:])
        later, earlier = np.nonzero(path[:, None] - path[None] >= _HALF_TURN)
        same = _true_angle(truth, matrices)[later, earlier] <= TRUE_CLOSURE_RAD
        if min(same.sum(), (~same).sum()) < _LEAST:
            return None
        attitude = matrices.by_measure[ATTITUDE].astype(np.float64)
        scores = {ATTITUDE: attitude}
        for measure in MEASURES:
            alone = matrices.by_measure[measure].astype(np.float64)
            scores[measure] = alone
            scores[f'{measure}_joint'] = joint_probability(alone, attitude)
        areas = {k: round(area_under(*roc(s[later, earlier], same)), 4) for k, s in scores.items()}
        return {'keyframes': n, 'pairs': len(same), 'same': int(same.sum()), 'area': areas}


def _true_angle(truth: Poses, matrices: ClosureMatrices) -> Array:
    """True angle (n, n) between the attitudes of all key frames, radians."""
    R = np.array([truth[int(s)][:3, :3] for s in matrices.stamps_ns])
    return np.arccos(np.clip((np.einsum('aij,bij->ab', R, R) - 1) / 2, -1, 1))
