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

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array, inverse
from debris_scanner.core.parameters import parameter
from debris_scanner.registration.projective import (
    RegistrationStats,
    linearise,
    linearise_pair,
    rotation_observability,
)
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.motion_filter import ATTITUDE, CENTRE, SIZE, MotionFilter

GOOD_RMS = 1.4  # px: residuals up to here do not lower the score
RMS_WEIGHT = 0.15  # of the score, a px beyond
CONVERGED_RAD, CONVERGED_PX = 1e-4, 0.02  # of a step

# The prediction is weak evidence for a pose that a search found, so the frame has to agree better.
STRICT_OVERLAP = 0.78
# after a gap the frame may show mostly unmapped surface: so much of it is enough
STRICT_PARTIAL_OVERLAP = 0.35
STRICT_INLIER_RATIO = 0.88  # if it matches so much of what the reference shows
STRICT_RMS = 1.55  # px
STRICT_CONFLICT_RATIO = 0.035
STRICT_SILHOUETTE_VIOLATION = 0.06
UNEXPECTED_FREE_SPACE_VIOLATION = 0.008  # of a pose that the prediction does not support

Reference = tuple[Surface, Array]  # a view or the model, with its pose in the target frame


@dataclass(frozen=True)
class OdometrySettings:
    """Key frames, references, and when a frame is accepted."""

    keyframe_angle_deg: float = parameter(6.0, 'rotation of the target between key frames', 'deg', 0.5, 45.0)
    max_keyframes: int = parameter(
        600,
        'key frames of a scan; once reached none is added, and frames are registered to the nearest ones',
        '',
        10,
        10**5,
    )
    recent_keyframes: int = parameter(4, 'key frames that a frame is registered to', '', 1, 20)
    tracked_keyframes: int = parameter(
        2, 'nearest key frames that a frame is registered to in addition to the model', '', 0, 20
    )
    min_share: float = parameter(
        0.4, 'a search needs this share of the surface points that its key frames show', '', 0.0, 1.0
    )
    gate_sigma: float = parameter(
        4.0,
        'a search accepts attitudes up to this distance from the prediction',
        'sigma',
        0.1,
        100.0,
    )
    max_uncertainty_deg: float = parameter(
        30.0,
        'attitude uncertainty (1 sigma) above which a search accepts any attitude that fits the model',
        'deg',
        1.0,
        180.0,
    )
    search_period: float = parameter(
        0.5, 'time between searches over all attitudes while the target is lost', 's', 0.0, 60.0
    )
    reference_angle_deg: float = parameter(
        40.0, 'largest angle between the views of a frame and of a reference key frame', 'deg', 5.0, 90.0
    )
    min_points: int = parameter(
        150, 'a frame with fewer sampled surface points is not registered', '', 20, 10**5
    )
    min_overlap: float = parameter(0.6, 'smallest share of matched points', '', 0.0, 1.0)
    max_rms: float = parameter(1.95, 'largest residual of the matched points', 'px', 0.01, 100.0)
    max_conflict_ratio: float = parameter(
        0.10, 'largest share of points in space that was seen to be free', '', 0.0, 1.0
    )
    max_silhouette_violation: float = parameter(
        0.25, 'largest share of points outside the silhouette', '', 0.0, 1.0
    )
    max_keyframe_missing_reference: float = parameter(
        0.05, 'the same as max_missing_reference, for a key frame: it has to be unoccluded', '', 0.0, 1.0
    )
    max_missing_reference: float = parameter(
        0.6, "largest share of the reference's points outside the frame's silhouette", '', 0.0, 1.0
    )
    max_relocalized_missing_reference: float = parameter(
        0.15, 'the same as max_missing_reference, for a frame that a search found', '', 0.0, 1.0
    )
    lost_after: int = parameter(3, 'rejected frames in a row until the target is lost', '', 1, 1000)
    max_gap: float = parameter(
        0.35,
        'after a longer gap the target is searched; a sensor slower than 10 Hz stretches it',
        's',
        0.01,
        60.0,
    )

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

    @property
    def score(self) -> float:
        """Compares fits of one frame: overlap minus all contradictions."""
        a = self.stats
        outside = a.silhouette_violation_ratio + self.missing_reference_ratio
        return self.overlap - 2 * a.conflict_ratio - 0.5 * outside - RMS_WEIGHT * max(0.0, a.rms - GOOD_RMS)


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
    motion = (start or prior).copy()
    information = np.asarray(np.linalg.inv(prior.P + 1e-14 * np.eye(SIZE)), np.float64)
    for gate in gates:
        T_target_view = inverse(motion.T_sensor_target)
        H, g = np.zeros((6, 6)), np.zeros(6)
        for surface, pose in references:
            Hr, gr = _measure(view, T_target_view, surface, pose, gate)
            weight = 1 / (len(references) * seen_by(surface, view).resolution ** 2)
            H += Hr * weight
            g += gr * weight
        step = motion.update_step(prior, information, H, g)
        turn, shift = np.linalg.norm(step[ATTITUDE]), np.linalg.norm(step[CENTRE])
        converged = turn < CONVERGED_RAD and shift < CONVERGED_PX * view.footprint
        if converged and gate == gates[-1]:
            break
    return _evaluate(motion, view, references, gates[-1])


def passes_gate(fit: FrameFit, settings: OdometrySettings) -> bool:
    """Whether a frame near its prediction agrees well enough."""
    a = fit.stats
    return (
        fit.missing_reference_ratio < settings.max_missing_reference
        and fit.overlap > settings.min_overlap
        and a.rms < settings.max_rms
        and a.conflict_ratio < settings.max_conflict_ratio
        and a.silhouette_violation_ratio < settings.max_silhouette_violation
    )


def passes_strict_gate(
    fit: FrameFit, settings: OdometrySettings, consistent_with_prediction: bool = True
) -> bool:
    """Whether a frame that a search found agrees well enough; stricter still far from the prediction."""
    a = fit.stats
    return (
        fit.missing_reference_ratio < settings.max_relocalized_missing_reference
        and (
            fit.overlap > STRICT_OVERLAP
            or (fit.overlap > STRICT_PARTIAL_OVERLAP and fit.visible_inlier_ratio > STRICT_INLIER_RATIO)
        )
        and a.rms < STRICT_RMS
        and a.conflict_ratio < STRICT_CONFLICT_RATIO
        and (consistent_with_prediction or a.free_space_violation_ratio < UNEXPECTED_FREE_SPACE_VIOLATION)
        and a.silhouette_violation_ratio < STRICT_SILHOUETTE_VIOLATION
    )


def shows_unmapped_surface(fit: FrameFit, settings: OdometrySettings) -> bool:
    """Whether a frame agrees with its references and shows more: they may be partially occluded."""
    a = fit.stats
    return (
        a.silhouette_violation_ratio > settings.max_silhouette_violation
        and fit.missing_reference_ratio < settings.max_keyframe_missing_reference
        and a.rms < STRICT_RMS
        and a.conflict_ratio < STRICT_CONFLICT_RATIO
    )


def seen_by(surface: Surface, view: View) -> View:
    """The view whose image the residuals are taken in: a model has none."""
    return surface if isinstance(surface, View) else view


def _measure(
    view: View, T_target_view: Array, surface: Surface, pose: Array, gate: float
) -> tuple[Array, Array]:
    """Normal equations for a twist of the view, against another view or the model."""
    if isinstance(surface, View):
        lin = linearise_pair(view, T_target_view, surface, pose, gate)
        return lin.H, lin.g
    lin = linearise(surface, pose, view, T_target_view, gate)
    return lin.H, -lin.g


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
            observability = rotation_observability(lin.H, lin.stats.matched, view, T_target_view)
            best = FrameFit(
                motion,
                lin.stats,
                observability,
                overlap,
                inliers,
                reverse.stats.silhouette_violation_ratio,
            )
    assert best is not None
    best.missing_reference_ratio = max(missing, default=best.missing_reference_ratio)
    best.has_unoccluded_reference = bool(missing)
    return best
