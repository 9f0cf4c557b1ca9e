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

"""Gating: one frame registered to its references, and whether that fit is accepted.

:func:`fit_frame` is the filter's iterated update with the registration as its measurement. Its result, a
:class:`FrameFit`, is accepted near the prediction if it passes :func:`passes_gate`. A fit that a search found
has to pass :func:`passes_strict_gate`. :class:`OdometrySettings` holds the bounds, and those of key frames
and references.
"""

import statistics
from collections import deque
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array, hat, inverse
from debris_scanner.core.parameters import parameter
from debris_scanner.registration.likelihood import UsualLoss, frame_loss, typical_beam
from debris_scanner.registration.picture_terms import COARSE_GATE, PictureTerms, picture_terms
from debris_scanner.registration.projective import (
    RegistrationStats,
    linearise,
    linearise_shapes,
    rotation_observability,
    weigh_picture,
)
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.motion_filter import ATTITUDE, CENTRE, SIZE, MotionFilter

GOOD_RMS = 1.4  # px: residuals up to here do not lower the score
RMS_WEIGHT = 0.15  # of the score, a px beyond
PICTURE_WEIGHT = 0.1  # of the score, a nat a point: one that meets nothing loses some ten
COLOURED = 300  # points of a frame, whose colours are compared with each key frame's
COARSE_STEP = 2  # of the points, one is used while the gate is wider than it ends
CONVERGED_RAD, CONVERGED_PX = 1e-4, 0.02  # of a step

STRICT = 0.5  # of max_loss: the prediction is weak evidence for a pose that a search found
REMEMBERED = 100  # unoccluded frames, whose median is what frames usually lack of a reference
FEW = 5  # of them, from which on it is known

Reference = tuple[Surface, Array]  # a view or the model, with its pose in the target frame


@dataclass(frozen=True)
class OdometrySettings:
    """Key frames, references, and when a frame is accepted."""

    keyframe_angle_deg: float = parameter(6.0, 'rotation of the target between key frames', 'deg', 0.5, 45.0)
    max_keyframes: int = parameter(
        600,
        'most key frames of a scan',
        '',
        10,
        10**5,
    )
    recent_keyframes: int = parameter(4, 'key frames that a frame is registered to', '', 1, 20)
    tracked_keyframes: int = parameter(2, 'nearest key frames beside the model', '', 0, 20)
    min_share: float = parameter(
        0.4, 'a search needs this share of the points of its key frames', '', 0.0, 1.0
    )
    gate_sigma: float = parameter(
        4.0,
        'a search accepts attitudes so far from the prediction',
        'sigma',
        0.1,
        100.0,
    )
    max_uncertainty_deg: float = parameter(
        30.0,
        'with a larger uncertainty (1 sigma) a search accepts any attitude that fits',
        'deg',
        1.0,
        180.0,
    )
    reference_angle_deg: float = parameter(
        40.0, 'largest angle between a frame and a reference', 'deg', 5.0, 90.0
    )
    max_loss: float = parameter(
        0.6,
        'a frame may lose so much a point beyond accepted ones; one that a search found half of it',
        'nat',
        0.05,
        10.0,
    )
    max_keyframe_missing_reference: float = parameter(
        0.05,
        'a key frame lacks at most so much more than accepted frames',
        '',
        0.0,
        1.0,
    )
    lost_after: int = parameter(3, 'rejected frames in a row until lost', '', 1, 1000)

    def full(self, keyframes: int) -> str:
        """Why a scan with so many key frames gets no more; empty while it may."""
        if keyframes < self.max_keyframes:
            return ''
        return f'{keyframes} key frames, the limit of a scan (odometry.max_keyframes): no more are added'


@dataclass
class FrameFit:
    """The updated filter, and how the frame agrees with the reference that it overlaps most."""

    filter: MotionFilter
    stats: RegistrationStats
    observability: float
    overlap: float  # share of the points that should match and do
    visible_inlier_ratio: (
        float  # the same of the points that the reference shows; they may be the smaller part
    )
    # largest share of an unoccluded reference that lies outside the frame's silhouette
    missing_reference_ratio: float
    has_unoccluded_reference: bool = False  # one of the references would reveal an occlusion of the frame
    loss: float = np.inf  # nats a point: how badly the reference explains what the frame shows
    covered_loss: float = np.inf  # the same of what lies inside the reference's silhouette
    surprise: float = 0.0  # squared distance from the prediction, in multiples of its sigma
    picture: float = 0.0  # what a reference's picture says for it, nats a point, where fits are compared
    degenerate: bool = False  # no finite solution: the filter is the prediction, and passes no gate

    @staticmethod
    def without_solution(prior: MotionFilter) -> 'FrameFit':
        """The fit of a frame whose equations have no finite solution."""
        return FrameFit(prior.copy(), RegistrationStats(), 0.0, 0.0, 0.0, 0.0, degenerate=True)

    @property
    def score(self) -> float:
        """Compares fits of one frame: overlap minus all contradictions, and what pictures say."""
        a = self.stats
        outside = a.silhouette_violation_ratio + self.missing_reference_ratio
        rough = RMS_WEIGHT * max(0.0, a.rms - GOOD_RMS)
        return self.overlap - 2 * a.conflict_ratio - 0.5 * outside - rough + PICTURE_WEIGHT * self.picture


def fit_frame(
    prior: MotionFilter,
    view: View,
    references: list[Reference],
    gates: tuple[float, ...],
    start: MotionFilter | None = None,
) -> FrameFit:
    """Register a view to all references at once, inside the filter.

    Args:
        prior: the predicted filter; left unchanged.
        view: the frame.
        references: at least one.
        gates: largest point-to-plane distance of a match in each iteration, px.
        start: where the iterations begin; None: at the prior.
    """
    try:
        fit = _fitted(prior, view, references, gates, start)
    except np.linalg.LinAlgError:
        return FrameFit.without_solution(prior)
    return fit if fit.filter.is_finite else FrameFit.without_solution(prior)


def _fitted(
    prior: MotionFilter,
    view: View,
    references: list[Reference],
    gates: tuple[float, ...],
    start: MotionFilter | None,
) -> FrameFit:
    """The fit of :func:`fit_frame`; its filter may hold what is no number."""
    motion = (start or prior).copy()
    information = np.asarray(np.linalg.inv(prior.P + 1e-14 * np.eye(SIZE)), np.float64)
    pictures = [
        PictureTerms(view, surface, pose, COLOURED) if isinstance(surface, View) else None
        for surface, pose in references
    ]
    off_px = np.inf if view.picture is None else _off_px(prior, view)
    for gate in gates:
        H, g = _measured(
            view, inverse(motion.T_sensor_target), references, pictures, gate, off_px, gate == gates[-1]
        )
        step = motion.update_step(prior, information, H, g)
        turn, shift = np.linalg.norm(step[ATTITUDE]), np.linalg.norm(step[CENTRE])
        converged = turn < CONVERGED_RAD and shift < CONVERGED_PX * view.footprint
        if converged and gate == gates[-1]:
            break
    fit = _evaluate(motion, view, references, gates[-1])
    moved = motion.difference(prior)
    fit.surprise = float(moved @ information @ moved)
    return fit


def pictured(fit: FrameFit, view: View, references: list[Reference], gate: float) -> FrameFit:
    """The fit with what the references' pictures say for it: where shapes look alike paint tells them apart.

    Args:
        fit: of the view.
        view: the frame.
        references: what it was registered to.
        gate: largest distance, px, of points that are compared; with a wide one the coarse pictures are.
    """
    if view.picture is not None and not fit.degenerate:
        T, coarse = inverse(fit.filter.T_sensor_target), gate > COARSE_GATE
        for surface, pose in references:
            if isinstance(surface, View):
                said = picture_terms(view, T, surface, pose, gate * surface.resolution, coarse=coarse)
                fit.picture = max(fit.picture, 0.0 if said is None else said[2] / len(view.points))
    return fit


class ScanLevel:
    """What is usual in a scan: the loss of accepted frames, and what unoccluded ones lack of a reference."""

    def __init__(self) -> None:
        self._loss = UsualLoss()
        self._missing: deque[float] = deque(maxlen=REMEMBERED)

    def add(self, fit: FrameFit, unoccluded: bool) -> None:
        """Learn from an accepted frame; from an unoccluded one also what is lacking."""
        self._loss.add(fit.loss)
        if unoccluded and fit.has_unoccluded_reference:
            self._missing.append(fit.missing_reference_ratio)

    def allows(self, loss: float, bound: float) -> bool:
        """Whether a loss exceeds the usual one by less than the bound, nats a point."""
        return self._loss.excess(loss) < bound

    def lacks(self, fit: FrameFit, bound: float) -> bool:
        """Whether a frame lacks more of its unoccluded references than usual, by more than the bound."""
        usual = statistics.median(self._missing) if len(self._missing) >= FEW else 0.0
        return fit.missing_reference_ratio - usual > bound


def passes_gate(fit: FrameFit, level: ScanLevel, settings: OdometrySettings) -> bool:
    """Whether a frame near its prediction is explained well enough."""
    return level.allows(fit.loss, settings.max_loss)


def passes_strict_gate(fit: FrameFit, level: ScanLevel, settings: OdometrySettings) -> bool:
    """Whether a frame that a search found is explained well enough."""
    return level.allows(fit.loss, STRICT * settings.max_loss)


def shows_unmapped_surface(fit: FrameFit, level: ScanLevel, settings: OdometrySettings) -> bool:
    """Whether a frame lacks nothing of its references and shows more: they may be partially occluded."""
    return (
        not level.allows(fit.loss, settings.max_loss)
        and not level.lacks(fit, settings.max_keyframe_missing_reference)
        and level.allows(fit.covered_loss, STRICT * settings.max_loss)
    )


def seen_by(surface: Surface, view: View) -> View:
    """The view whose image the residuals are taken in: a model has none."""
    return surface if isinstance(surface, View) else view


def _off_px(prior: MotionFilter, view: View) -> float:
    """How far the view's points are from where the filter predicts them, px, 1 sigma."""
    P = prior.pose_covariance
    shift = np.hstack([-hat(view.centroid - prior.T_sensor_target[:3, 3]), np.eye(3)])
    square = view.gyration_square * np.trace(P[:3, :3]) + np.trace(shift @ P @ shift.T)
    return float(np.sqrt(max(0.0, square))) / view.footprint


def _measured(
    view: View,
    T_target_view: Array,
    references: list[Reference],
    pictures: list[PictureTerms | None],
    gate: float,
    off_px: float,
    finest: bool,
) -> tuple[Array, Array]:
    """Normal equations for a twist of the view, px, against other views or the model; few points first."""
    step = 1 if finest else COARSE_STEP
    H, g = np.zeros((6, 6)), np.zeros(6)
    H_picture, g_picture, variance, matched = np.zeros((6, 6)), np.zeros(6), 0.0, 0.0
    for (surface, pose), picture in zip(references, pictures, strict=True):
        weight = 1 / (len(references) * seen_by(surface, view).resolution ** 2)
        if not isinstance(surface, View):
            lin = linearise(surface, pose, view, T_target_view, gate, step)
            H += weight * lin.H
            g -= weight * lin.g
            continue
        lin = linearise_shapes(view, T_target_view, surface, pose, gate, step)
        H += weight * lin.H
        g += weight * lin.g
        shown = picture.at(T_target_view, gate, off_px) if picture is not None else None
        if shown is not None:
            H_picture += shown[0] / len(references)
            g_picture += shown[1] / len(references)
        variance += lin.stats.rms**2 / len(references)
        matched += weight * step * lin.stats.matched
    if H_picture.any() and variance > 0:
        weigh_picture(H, g, H_picture, g_picture, variance, view, T_target_view, matched)
    return H, g


def _evaluate(motion: MotionFilter, view: View, references: list[Reference], gate: float) -> FrameFit:
    """Compare the view with each reference at the filter's pose; the fit to the best one."""
    T_target_view = inverse(motion.T_sensor_target)
    best: FrameFit | None = None
    missing: list[float] = []
    for surface, pose in references:
        lin = reverse = linearise(surface, pose, view, T_target_view, gate)
        overlap = inliers = reverse.stats.visible_inlier_ratio
        if surface.unoccluded:  # what a partially occluded reference lacks may be occluded now, too
            missing.append(reverse.stats.silhouette_violation_ratio)
        if isinstance(surface, View):
            lin = linearise(view, T_target_view, surface, pose, gate)
            if not surface.unoccluded:
                lin.stats = lin.stats.within_silhouette()
            overlap, inliers = lin.stats.overlap, lin.stats.visible_inlier_ratio
        if best is None or overlap > best.overlap:
            source = view if isinstance(surface, View) else surface
            observability = rotation_observability(
                lin.H, lin.stats.matched / source.density, view, T_target_view
            )
            best = FrameFit(
                motion,
                lin.stats,
                observability,
                overlap,
                inliers,
                reverse.stats.silhouette_violation_ratio,
            )
    assert best is not None
    beam = typical_beam(view)
    # the reference that explains the frame best: others may show little of it
    best.loss, best.covered_loss = min(
        frame_loss(view, T_target_view, surface, pose, beam) for surface, pose in references
    )
    best.missing_reference_ratio = max(missing, default=best.missing_reference_ratio)
    best.has_unoccluded_reference = bool(missing)
    return best
