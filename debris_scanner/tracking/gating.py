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

"""Settings of the odometry: key frames, references, and when a frame is believed.

One frame fitted: the filter's iterated update with the registration as its measurement.

Whether a registered frame is believed: it must agree with its references, and doubt none of them.
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


@dataclass(frozen=True)
class OdometrySettings:
    """Key frames, references, and when a frame is believed."""

    keyframe_angle_deg: float = parameter(6.0, 'turn of the target between key frames', 'deg', 0.5, 45.0)
    max_keyframes: int = parameter(
        600,
        'key frames of a scan; from then on none is added, and frames are registered to those most alike',
        '',
        10,
        10**5,
    )
    recent_keyframes: int = parameter(4, 'key frames a frame is registered to', '', 1, 20)
    tracked_keyframes: int = parameter(
        2, 'key frames most alike that a frame is registered to beside the model', '', 0, 20
    )
    min_share: float = parameter(
        0.4, 'a search needs this share of the surface points that its key frames show', '', 0.0, 1.0
    )
    gate_sigma: float = parameter(
        4.0,
        'a search may find attitudes this far from the prediction',
        'sigma',
        0.1,
        100.0,
    )
    max_uncertainty_deg: float = parameter(
        30.0, 'until it is this uncertain, 1 sigma; then any that a model explains', 'deg', 1.0, 180.0
    )
    search_period: float = parameter(
        0.5, 'while lost, time between searches of all attitudes', 's', 0.0, 60.0
    )
    reference_angle_deg: float = parameter(
        40.0, 'key frames seen from further away are no reference', 'deg', 5.0, 90.0
    )
    min_points: int = parameter(150, 'fewer sampled surface points are no frame', '', 20, 10**5)
    min_overlap: float = parameter(0.6, 'share of the points that must match', '', 0.0, 1.0)
    max_rms: float = parameter(0.0029, 'largest residual of the matched points', 'm', 1e-5, 0.1)
    max_conflict_ratio: float = parameter(0.10, 'largest share of points in seen free space', '', 0.0, 1.0)
    max_silhouette_violation: float = parameter(
        0.25, 'largest share of points beside the silhouette', '', 0.0, 1.0
    )
    max_keyframe_missing_reference: float = parameter(
        0.05, 'and of a key frame, which is to show the whole side', '', 0.0, 1.0
    )
    max_missing_reference: float = parameter(
        0.6, "largest share of the reference's points beside the frame's silhouette", '', 0.0, 1.0
    )
    max_relocalized_missing_reference: float = parameter(
        0.15, 'and of a frame that a search found', '', 0.0, 1.0
    )
    lost_after: int = parameter(3, 'disbelieved frames in a row until the target is lost', '', 1, 1000)
    max_gap: float = parameter(0.35, 'a longer gap is searched, not just predicted', 's', 0.01, 60.0)

    def full(self, keyframes: int) -> str:
        """Why a scan of so many key frames gets no more, in words; empty while it may."""
        if keyframes < self.max_keyframes:
            return ''
        return f'{keyframes} key frames, the most of a scan (odometry.max_keyframes): none is added any more'


Reference = tuple[Surface, Array]  # a view or the model, with its pose in the target frame

GOOD_RMS = 0.0021  # m: residuals up to here say nothing against a fit


@dataclass
class FrameFit:
    """The updated filter, and how the frame agrees with the reference it agrees with best."""

    filter: MotionFilter
    stats: RegistrationStats
    observability: float
    overlap: float  # share of what should match and does
    visible_inlier_ratio: float  # the same of what the reference shows at all: it may be the smaller part
    missing_reference_ratio: (
        float  # largest share of a whole reference that lies beside the frame's silhouette
    )
    has_unoccluded_reference: bool = False  # one of the references was whole: what is hidden would be missed

    @property
    def score(self) -> float:
        """To compare fits of one frame: overlap less all contradictions."""
        a = self.stats
        beside = a.silhouette_violation_ratio + self.missing_reference_ratio
        return self.overlap - 2 * a.conflict_ratio - 0.5 * beside - 100 * max(0.0, a.rms - GOOD_RMS)


def fit_frame(
    prior: MotionFilter,
    view: View,
    references: list[Reference],
    gates: tuple[float, ...],
    start: MotionFilter | None = None,
) -> FrameFit:
    """Register a view to all references at once, inside the filter.

    Args:
        prior: the predicted filter; left as it is.
        view: the frame.
        references: at least one.
        gates: largest point-to-plane distance of a match in each iteration, metres.
        start: where the iterations begin; None: at the prior.
    """
    motion = (start or prior).copy()
    information = np.asarray(np.linalg.inv(prior.P + 1e-14 * np.eye(SIZE)), np.float64)
    for gate in gates:
        T_target_view = inverse(motion.T_sensor_target)
        H, g = np.zeros((6, 6)), np.zeros(6)
        for surface, pose in references:
            Hr, gr = _measure(view, T_target_view, surface, pose, gate)
            H += Hr / len(references)
            g += gr / len(references)
        step = motion.update_step(prior, information, H, g)
        settled = np.linalg.norm(step[ATTITUDE]) < 1e-4 and np.linalg.norm(step[CENTRE]) < 3e-5
        if settled and gate == gates[-1]:
            break
    return _judge(motion, view, references, gates[-1])


def _judge(motion: MotionFilter, view: View, references: list[Reference], gate: float) -> FrameFit:
    T_target_view = inverse(motion.T_sensor_target)
    best: FrameFit | None = None
    missing: list[float] = []
    for surface, pose in references:
        lin = reverse = linearise(surface, pose, view, T_target_view, gate)
        overlap = explained = reverse.stats.visible_inlier_ratio
        if surface.unoccluded:  # of a half hidden one, what the same shadow hides is not missing
            missing.append(reverse.stats.silhouette_violation_ratio)
        if isinstance(surface, View):
            lin = linearise(view, T_target_view, surface, pose, gate)
            if not surface.unoccluded:
                lin.stats = lin.stats.within_silhouette()
            overlap, explained = lin.stats.overlap, lin.stats.visible_inlier_ratio
        if best is None or overlap > best.overlap:
            seen = rotation_observability(lin.H, lin.stats.matched, view, T_target_view)
            best = FrameFit(
                motion, lin.stats, seen, overlap, explained, reverse.stats.silhouette_violation_ratio
            )
    assert best is not None
    best.missing_reference_ratio, best.has_unoccluded_reference = (
        max(missing, default=best.missing_reference_ratio),
        bool(missing),
    )
    return best


def _measure(
    view: View, T_target_view: Array, surface: Surface, pose: Array, gate: float
) -> tuple[Array, Array]:
    """Normal equations for a twist of the view, against another view or the model."""
    if isinstance(surface, View):
        lin = linearise_pair(view, T_target_view, surface, pose, gate)
        return lin.H, lin.g
    lin = linearise(surface, pose, view, T_target_view, gate)
    return lin.H, -lin.g


# A prediction vouches little for a pose that a search found, so its frame must agree beyond doubt.
STRICT_OVERLAP = 0.78
STRICT_PARTIAL_OVERLAP = (
    0.35  # of the frame is enough where a gap let the target turn out of all that is known,
)
STRICT_INLIER_RATIO = 0.88  # if it explains that part so well
STRICT_RMS = 0.0023  # m
STRICT_CONFLICT_RATIO = 0.035
STRICT_SILHOUETTE_VIOLATION = 0.06
UNEXPECTED_FREE_SPACE_VIOLATION = 0.008  # where not even the prediction says that the target may be there


def passes_gate(fit: FrameFit, settings: OdometrySettings) -> bool:
    """A frame near its prediction agrees well enough."""
    a = fit.stats
    return (
        fit.missing_reference_ratio < settings.max_missing_reference
        and fit.overlap > settings.min_overlap
        and a.rms < settings.max_rms
        and a.conflict_ratio < settings.max_conflict_ratio
        and a.silhouette_violation_ratio < settings.max_silhouette_violation
    )


def shows_unmapped_surface(fit: FrameFit, settings: OdometrySettings) -> bool:
    """A frame agrees with all that its references show, and shows more: something may have hidden a part."""
    a = fit.stats
    return (
        a.silhouette_violation_ratio > settings.max_silhouette_violation
        and fit.missing_reference_ratio < settings.max_keyframe_missing_reference
        and a.rms < STRICT_RMS
        and a.conflict_ratio < STRICT_CONFLICT_RATIO
    )


def passes_strict_gate(
    fit: FrameFit, settings: OdometrySettings, consistent_with_prediction: bool = True
) -> bool:
    """A frame found by search agrees so well that it is accepted; the more so where nobody expected it."""
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
