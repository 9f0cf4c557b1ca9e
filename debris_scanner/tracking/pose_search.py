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

"""Pose search: fits of a frame from many starting attitudes.

:func:`search` fits a frame from given starts, such as :func:`nearby` the prediction, and
:func:`competing_fits` picks those that contradict the best one. :func:`global_pose_search` needs no
prediction: it scores a grid of attitudes against the model and refines the best. :func:`mapped_fraction`
measures how much of a view is known.
"""

from collections.abc import Callable, Sequence

import numpy as np

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    exp_se3,
    inverse,
    log_so3,
    rotation_angle,
    sphere_directions,
    transform,
)
from debris_scanner.registration.projective import linearise, solve_step
from debris_scanner.sensing.rim import Rim
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import FrameFit, Reference, fit_frame, pictured
from debris_scanner.tracking.motion_filter import ATTITUDE, CENTRE, SIZE, MotionFilter

# search around a prediction
# px; far from the solution the edges move a flat face in many small steps
COARSE_GATES = (*(27.0,) * 5, *(20.0,) * 4, *(13.0,) * 4)
GATES = (13.0, 13.0, 8.0, 8.0, 5.5, 5.5, 5.5)
THINNED = 5  # coarse steps use one point in so many
FINE_FITS = 5  # the best of the coarse ones
SAME_TURN, SAME_PLACE = np.radians(2.0), 3.3  # rad, px: coarse fits closer than this are one
START_TURN, START_SHIFT = 0.1, 13.0  # rad, px, 1 sigma: added to the prediction's uncertainty
LOST_CENTRE = 13.0  # px: with a more uncertain centre the view's is tried as well
LIKELY = 4.0  # sigma: a larger rotation came from an impact, not from a wrong rate
REACH = 2.0  # sigma, of the starts about the prediction
FURTHEST_START = 0.9  # rad
STEP = np.radians(18.0)  # starts closer to each other lead to the same fit
DISTINCT = np.radians(4.0)  # fits further apart than this contradict each other
MARGIN = 0.06  # of the score, by which the best must exceed all that contradict it

# search over all attitudes of a model
MATCH_GATE = 5.5  # px
SCORE_STEPS = (27.0, 20.0)  # px, of the steps from a grid's attitude to what is scored
SCORE_GATES = (13.0, 20.0, 8.0)  # px, of the grid, after the first steps, and of the refined
REFINE_GATES = (13.0, 13.0, 8.0, 8.0)  # px
TRACKED_POINTS = 3000
SCORED_POINTS = 200
REFINED_POINTS = 800
DIRECTIONS = 65
ROLLS = 18
STEPPED, REFINED = 400, 20
DISTINCT_ATTITUDES = np.radians(8.0)


def nearby(predicted: MotionFilter) -> list[Array]:
    """Rotation vectors (3,), sensor frame: zero, and along the uncertain directions of the attitude."""
    variance, axes = np.linalg.eigh(predicted.P[ATTITUDE, ATTITUDE])
    sigma = np.sqrt(np.maximum(variance, 0.0))
    starts = [np.zeros(3)]
    for k in range(3):
        reach = min(REACH * sigma[k], FURTHEST_START)
        for turn in np.arange(STEP, reach + STEP / 2, STEP):
            starts += [turn * axes[:, k], -turn * axes[:, k]]
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
        min_share: of the surface points that the references show; a small part of the target fits anywhere.
    """
    thin_view = view.thinned(THINNED)
    start_sigma = np.repeat([START_TURN, START_SHIFT * view.footprint, 0, 0, 0, 0, 0], 3)
    thinned: dict[int, Surface] = {}

    def thin(reference: Reference) -> Reference:
        surface, pose = reference
        if id(surface) not in thinned:
            thinned[id(surface)] = surface.thinned(THINNED)
        return thinned[id(surface)], pose

    coarse: list[tuple[FrameFit, MotionFilter]] = []
    for turn in starts:
        motion = predicted.copy()
        motion.correct(_turned(predicted, turn))
        references = references_of(motion)
        if not references or len(view.points) < min_share * _points_shown(references):
            continue
        few = [thin(r) for r in (references if len(references) < 3 else (references[0], references[-1]))]
        shifts = [np.zeros(3)]
        if _centre_sigma(predicted) > LOST_CENTRE * view.footprint:
            shifts.append(_recentre(motion, view, references[-1]))
        for shift in shifts:
            prior = motion.copy()
            prior.correct(np.concatenate([np.zeros(3), shift, np.zeros(15)]))
            prior.P = prior.P + np.diag(start_sigma**2)
            fit = fit_frame(prior, thin_view, few, COARSE_GATES)
            coarse.append((pictured(fit, thin_view, few, COARSE_GATES[-1]), prior))
    fits = []
    for fit, prior in _best(coarse, SAME_PLACE * view.footprint):
        if references := references_of(fit.filter):
            fit = fit_frame(prior, view, references, GATES, start=fit.filter)
            fits.append(pictured(fit, view, references, GATES[-1]))
    return sorted(fits, key=lambda f: -f.score)


def competing_fits(fits: list[FrameFit], score: Callable[[FrameFit], float]) -> list[FrameFit]:
    """Fits, best first, whose attitudes contradict the best one's although they score hardly worse."""
    chosen = fits[:1]
    for f in fits[1:]:
        distinct = all(rotation_angle(f.filter.R @ c.filter.R.T) > DISTINCT for c in chosen)
        if distinct and score(fits[0]) - score(f) <= MARGIN:
            chosen.append(f)
    return chosen[1:]


def attitude_sigma(motion: MotionFilter) -> float:
    """Standard deviation, rad, of the attitude about its least certain axis."""
    return float(np.sqrt(np.linalg.eigvalsh(motion.P[ATTITUDE, ATTITUDE])[-1]))


def mahalanobis(motion: MotionFilter, predicted: MotionFilter) -> float:
    """Distance of an attitude from the predicted one in its standard deviations."""
    turn = log_so3(motion.R @ predicted.R.T)
    return float(np.sqrt(turn @ np.linalg.solve(predicted.P[ATTITUDE, ATTITUDE], turn)))


def global_pose_search(surface: Surface, view: View, best: int = 5) -> list[Array]:
    """Poses T_sensor_target (4, 4) at which the surface looks most like the view, best first.

    Coarse scores over a sphere of view directions and rolls, two Gauss-Newton steps from the better third,
    and more on the best.

    Args:
        surface: the model, target frame.
        view: the frame.
        best: how many distinct attitudes to return.
    """
    few, some = _first(surface, SCORED_POINTS), _first(surface, REFINED_POINTS)
    grid = [_centred(R, surface, view) for R in attitude_grid()]
    grid.sort(key=lambda T: -_score(few, T, view, SCORE_GATES[0]))
    # half a cell away a right pose looks as bad as many wrong ones: those are compared after the first steps
    stepped = [_stepped(few, T, view, SCORE_STEPS) for T in grid[:STEPPED]]
    scored = [(_score(few, T, view, SCORE_GATES[1]), T) for T in stepped]
    scored.sort(key=lambda s: -s[0])
    refined = []
    for _, T in scored[:REFINED]:
        T = _stepped(some, T, view, REFINE_GATES)
        refined.append((_score(some, T, view, SCORE_GATES[2]), T))
    refined.sort(key=lambda s: -s[0])
    poses: list[Array] = []
    for _, T in refined:
        if all(rotation_angle(T[:3, :3] @ P[:3, :3].T) > DISTINCT_ATTITUDES for P in poses):
            poses.append(T)
    return poses[:best]


def attitude_grid() -> list[Array]:
    """Rotations (3, 3) over all view directions and rolls."""
    rotations = []
    for x, y, c in sphere_directions(DIRECTIONS):
        s, a = np.hypot(x, y), np.arctan2(y, x)
        tilt = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        for roll in np.arange(ROLLS) * (2 * np.pi / ROLLS):
            r = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
            rotations.append(r @ (turn @ tilt).T)
    return rotations


def tracking_surface(model: Model, count: int = TRACKED_POINTS) -> Surface:
    """Evenly sampled points of the model that a view is registered to."""
    surface = Surface.sampled(model.points, model.normals, count)
    surface.point_area = len(model.points) * model.spacing**2 / max(1, len(surface.points))
    return surface


def mapped_fraction(references: Sequence[Reference], view: View, T_sensor_target: Array) -> float:
    """Share of a view that matches a reference, the best of them: a key frame or a model."""
    T_target_view = inverse(T_sensor_target)
    pixels_per_m2 = view.intrinsics[0] * view.intrinsics[1] / view.centroid[2] ** 2
    shares = [0.0]
    for surface, pose in references:
        if isinstance(surface, View):
            shares.append(linearise(view, T_target_view, surface, pose, MATCH_GATE).stats.overlap)
        else:
            matched = linearise(surface, pose, view, T_target_view, MATCH_GATE).stats.matched
            area = matched * surface.point_area * pixels_per_m2
            shares.append(area / max(1, np.count_nonzero(view.depth_map)))
    return max(shares)


def _best(
    coarse: list[tuple[FrameFit, MotionFilter]], same_place: float
) -> list[tuple[FrameFit, MotionFilter]]:
    """The best few distinct fits; centres closer than ``same_place``, m, are one."""
    chosen: list[tuple[FrameFit, MotionFilter]] = []
    for fit, prior in sorted(coarse, key=lambda c: -c[0].score):
        motion = fit.filter
        if len(chosen) < FINE_FITS and all(
            rotation_angle(motion.R @ c.filter.R.T) > SAME_TURN
            or np.linalg.norm(motion.centre - c.filter.centre) > same_place
            for c, _ in chosen
        ):
            chosen.append((fit, prior))
    return chosen


def _turned(predicted: MotionFilter, turn: Array) -> Array:
    """Change of the whole state (21,) that goes with a rotation (3,) of the attitude.

    A likely error of the predicted attitude comes from a wrong rate, which is corrected with it.
    """
    gain = np.linalg.solve(predicted.P[ATTITUDE, ATTITUDE], predicted.P[ATTITUDE, :]).T
    if turn @ np.linalg.solve(predicted.P[ATTITUDE, ATTITUDE], turn) > LIKELY**2:
        return np.concatenate([turn, np.zeros(SIZE - 3)])
    return np.asarray(gain @ turn, np.float64)


def _centre_sigma(motion: MotionFilter) -> float:
    """Standard deviation, m, of the centre in its least certain direction."""
    return float(np.sqrt(np.linalg.eigvalsh(motion.P[CENTRE, CENTRE])[-1]))


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


def _first(surface: Surface, n: int) -> Surface:
    rim = Rim(surface.rim.points[:n], surface.rim.normals[:n], surface.rim.edge[:n])
    return Surface(surface.points[:n], surface.normals[:n], surface.anchors[:n], rim)


def _centred(R: Array, surface: Surface, view: View) -> Array:
    """Pose with the rotation R whose visible points have the view's centroid."""
    facing = surface.normals @ R[2] < 0
    points = surface.points[facing] if facing.any() else surface.points
    return transform(R, view.centroid - R @ points.mean(axis=0))


def _stepped(surface: Surface, T: Array, view: View, gates: Sequence[float]) -> Array:
    """T_sensor_target (4, 4) after one Gauss-Newton step at each gate."""
    for gate in gates:
        lin = linearise(surface, np.eye(4), view, inverse(T), gate)
        # the twist moves the model, so it multiplies T_sensor_target from the right
        T = compose(T, exp_se3(solve_step(lin.H, lin.g)))
    return T


def _score(surface: Surface, T_sensor_target: Array, view: View, gate: float) -> float:
    a = linearise(surface, np.eye(4), view, inverse(T_sensor_target), gate).stats
    return a.visible_inlier_ratio - 2 * a.conflict_ratio - 0.5 * a.silhouette_violation_ratio
