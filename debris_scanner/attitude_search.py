"""Search for a target whose attitude is in doubt: fits from several starts, and when to trust the best."""

from collections.abc import Callable

import numpy as np

from debris_scanner.frame_fit import FrameFit, Reference, fit_frame
from debris_scanner.geometry import Array, apply, log_so3, rotation_angle
from debris_scanner.motion_filter import ATTITUDE, SIZE, MotionFilter
from debris_scanner.views import View

GATES = (0.04, 0.03, 0.03, 0.02, 0.02, 0.012, 0.012, 0.008, 0.008)  # m
START_SIGMA = np.repeat([0.1, 0.02, 0, 0, 0, 0, 0], 3)  # rad and m, added to the prediction's uncertainty
FURTHEST_START = 0.7  # rad
NEAREST_START = np.radians(3.0)  # starts closer to the prediction lead to the same fit
DISTINCT = np.radians(8.0)  # fits further apart than this contradict each other
MARGIN = 0.06  # of the score, by which the best must beat all that contradict it


def nearby(predicted: MotionFilter) -> list[Array]:
    """Rotation vectors (3,), sensor frame: none, and along the uncertain directions of the attitude."""
    variance, axes = np.linalg.eigh(predicted.P[ATTITUDE, ATTITUDE])
    sigma = np.sqrt(np.maximum(variance, 0.0))
    starts = [np.zeros(3)]
    for k in range(3):
        for m in (-2, -1, 1, 2):
            if abs(m) * sigma[k] > NEAREST_START:
                starts.append(np.clip(m * sigma[k], -FURTHEST_START, FURTHEST_START) * axes[:, k])
    return starts


def search(
    predicted: MotionFilter,
    view: View,
    starts: list[Array],
    references_of: Callable[[MotionFilter], list[Reference]],
    min_share: float,
) -> list[FrameFit]:
    """Fits of a frame from several starting attitudes, best first.

    Args:
        predicted: the predicted filter.
        view: the frame.
        starts: rotation vectors (3,) from the predicted attitude, sensor frame.
        references_of: what to register to at a given state.
        min_share: of the surface points that the references show; a sliver of the target fits anywhere.
    """
    fits = []
    for turn in starts:
        motion = predicted.copy()
        motion.correct(np.concatenate([turn, np.zeros(SIZE - 3)]))
        references = references_of(motion)
        if not references or len(view.points) < min_share * _points_shown(references):
            continue
        shift = _recentre(motion, view, references[-1])
        motion.correct(np.concatenate([np.zeros(3), shift, np.zeros(15)]))
        motion.P = motion.P + np.diag(START_SIGMA**2)
        fits.append(fit_frame(motion, view, references, GATES))
    return sorted(fits, key=lambda f: -f.score)


def attitude_sigma(motion: MotionFilter) -> float:
    """Standard deviation, rad, of the attitude about its least certain axis."""
    return float(np.sqrt(np.linalg.eigvalsh(motion.P[ATTITUDE, ATTITUDE])[-1]))


def choose(
    fits: list[FrameFit], predicted: MotionFilter, gate_sigma: float, max_sigma: float, anywhere: bool
) -> tuple[FrameFit | None, bool]:
    """The fit to believe, or None; and whether another attitude explains the frame as well.

    As long as the prediction says something, continuity decides: nothing else tells a face from its like on
    the other side of the target. After that only a model can, and where two attitudes fit it alike, the
    nearer to the prediction is taken.

    Args:
        fits: best first.
        predicted: the prediction for the same frame.
        gate_sigma: largest Mahalanobis distance of an attitude from the prediction.
        max_sigma: a prediction more uncertain than this, rad, says nothing.
        anywhere: whether a fit counts without a prediction.
    """
    P = predicted.P[ATTITUDE, ATTITUDE]
    if attitude_sigma(predicted) < max_sigma:
        turns = [log_so3(f.filter.R @ predicted.R.T) for f in fits]
        near = [f for f, t in zip(fits, turns, strict=True) if t @ np.linalg.solve(P, t) < gate_sigma**2]
        if near:
            return (None, False) if _rivals(near) else (near[0], False)
        # it was knocked, then; but only an attitude without its like tells so
        return (fits[0], False) if anywhere and fits and not _rivals(fits) else (None, False)
    if not fits or not anywhere:
        return None, False
    alike = [fits[0], *_rivals(fits)]
    nearest = min(alike, key=lambda f: rotation_angle(f.filter.R @ predicted.R.T))
    return nearest, len(alike) > 1


def _rivals(fits: list[FrameFit]) -> list[FrameFit]:
    """Those whose attitude contradicts the first and which fit hardly worse."""
    best = fits[0]
    return [
        f
        for f in fits[1:]
        if best.score - f.score <= MARGIN and rotation_angle(f.filter.R @ best.filter.R.T) > DISTINCT
    ]


def _recentre(motion: MotionFilter, view: View, reference: Reference) -> Array:
    """Shift (3,) that puts the reference's visible centroid onto the view's."""
    surface, pose = reference
    T_sensor_reference = motion.T_sensor_target @ pose
    points, normals = surface.points, surface.normals
    if not isinstance(surface, View):
        facing = normals @ T_sensor_reference[2, :3] < 0
        points = points[facing] if facing.any() else points
    return view.centroid - apply(T_sensor_reference, points.mean(axis=0).astype(np.float64))


def _points_shown(references: list[Reference]) -> float:
    """How many surface points the key frames among the references show, on average."""
    counts = [len(surface.points) for surface, _ in references if isinstance(surface, View)]
    return float(np.mean(counts)) if counts else 0.0
