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

"""Relocalization: finds a lost target near its prediction, then among all attitudes.

Fits that the prediction does not decide between become hypotheses. Each is tracked through the following
frames until one is left, or leads clearly.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array, exp_so3, log_so3, rotation_angle
from debris_scanner.registration.projective import MIN_OVERLAP, OBSERVABLE
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.cadence import USUAL_HZ
from debris_scanner.tracking.gating import FrameFit, fit_frame, passes_strict_gate, pictured
from debris_scanner.tracking.local_map import LocalMap
from debris_scanner.tracking.motion_filter import MotionFilter
from debris_scanner.tracking.pose_search import (
    GATES,
    attitude_sigma,
    competing_fits,
    global_pose_search,
    mahalanobis,
    mapped_fraction,
    nearby,
    search,
)

FURTHEST = np.radians(60.0)  # from the prediction; beyond are the other faces of a box
PATIENCE = 2  # global searches without a fit near the prediction until the prediction is given up
MOST_HYPOTHESES = 5
SEARCH_PERIOD_S = 0.5  # between searches over all attitudes: one takes some tenths of a second
UNMAPPED_SIDE = 0.6  # of the outline of one side: the opposite side, which has less, is not in the model
UNLIKELY = 0.006  # of the score, times the square of the distance from the prediction in sigma
SAME = np.radians(3.0)  # hypotheses closer than this are one
CONFIRMED = 4  # frames that the last surviving hypothesis must fit
PRECISE_SIGMA = np.radians(
    5.0
)  # 1 sigma: a fit where so precise a prediction has the target needs no confirmation
VALLEY_ANGLE, AS_GOOD = np.radians(2.0), 0.1  # then fits so far apart, of scores so close, lie in one valley
DECIDED = 0.03  # decisive lead of the mean score; with a model it is scaled by the root of the frame count
DECIDED_AFTER_NS = 400_000_000
LONGEST_AMBIGUITY_NS = 1_000_000_000  # with a model the hypothesis nearest the prediction is taken then
LONGEST_SCANNING_NS = 2_500_000_000  # without a model all are dropped then: a wrong one would spoil the scan


@dataclass
class PoseHypothesis:
    """One of several attitudes that fit all frames since the search."""

    fit: FrameFit
    penalty: float  # of the score, for its distance from the prediction
    scores: list[float]

    @property
    def score(self) -> float:
        """Mean over the frames, less the penalty."""
        return float(np.mean(self.scores)) - self.penalty


class Relocalizer:
    """Searches for a lost target, frame by frame.

    ``ambiguous``: another hypothesis fitted all frames as well. ``consistent_with_prediction``: the target is
    near its predicted attitude; a pose found by appearance alone may be another face that looks alike.

    Args:
        local_map: what frames are registered to.
    """

    def __init__(self, local_map: LocalMap) -> None:
        self._map = local_map
        self.reset()

    def reset(self) -> None:
        """Forget all hypotheses: the target was tracked, or the scan begins anew."""
        self.ambiguous, self.consistent_with_prediction = False, True
        self._hypotheses: list[PoseHypothesis] = []
        self._followed = False
        self._watched_ns = self._stamp_ns = 0
        self._searched_ns = self._searches = 0

    def find(
        self, predicted: MotionFilter, view: View, lost: bool, followed: bool = False
    ) -> FrameFit | None:
        """The accepted fit of the frame; None while there is none, or several hypotheses.

        Args:
            predicted: the prediction for the frame.
            view: the frame.
            lost: long enough that the target may have any attitude.
            followed: the target was where it was predicted in the frame before.
        """
        self._followed = followed
        if self._hypotheses:
            found = self._advance_hypotheses(predicted, view)
            if found is not None or self._hypotheses:
                return found
        fits = self._candidates(predicted, view, lost)

        def penalty(fit: FrameFit) -> float:
            return (
                UNLIKELY * mahalanobis(fit.filter, predicted) ** 2 if self.consistent_with_prediction else 0.0
            )

        fits = sorted(fits, key=lambda f: penalty(f) - f.score)
        if not fits or not self._accepts(fits, predicted, view):
            return None
        others = competing_fits(fits, lambda f: f.score - penalty(f))
        if not others and (followed or attitude_sigma(predicted) < PRECISE_SIGMA):
            return fits[0]
        self._hypotheses = [PoseHypothesis(f, penalty(f), [f.score]) for f in (fits[0], *others)][
            :MOST_HYPOTHESES
        ]
        self._watched_ns, self._stamp_ns = 0, view.frame.stamp_ns
        return None

    # search ------------------------------------------------------------------------------------------

    def _candidates(self, predicted: MotionFilter, view: View, lost: bool) -> list[FrameFit]:
        """Fits near the prediction; of a target lost for long, those of a global search, now and then."""
        fits = self._search(predicted, view, nearby(predicted))
        near = self._near(predicted, fits)
        due = (view.frame.stamp_ns - self._searched_ns) * 1e-9 >= SEARCH_PERIOD_S
        self.consistent_with_prediction = bool(near)
        surface = self._map.surface
        if not near and surface is not None and lost and due:
            self._searched_ns = view.frame.stamp_ns
            fits = sorted([*fits, *self._anywhere(predicted, view, surface)], key=lambda f: -f.score)
            if self._searches >= PATIENCE or not self._is_informative(predicted):
                near = fits
            self._searches += 1
        return near

    def _accepts(self, fits: list[FrameFit], predicted: MotionFilter, view: View) -> bool:
        """Whether the best of the fits, sorted, may be taken; if it is in doubt, no other one is."""
        best, sure = fits[0], attitude_sigma(predicted) < PRECISE_SIGMA
        if not self._passes(best):
            return False
        if not (sure and self.consistent_with_prediction) and self._is_hardly_mapped(best, view):
            return False
        if self._map.surface is None:
            # a wrong pose would spoil the scan; with a model the next frames correct it
            return sure or not (best.observability < OBSERVABLE and is_underconstrained(fits))
        return self.consistent_with_prediction or not opposite_side_unmapped(best, self._map.surface)

    def _is_informative(self, predicted: MotionFilter) -> bool:
        """Whether the prediction constrains the attitude; from one frame to the next it does."""
        largest = np.radians(self._map.settings.max_uncertainty_deg)
        return self._followed or attitude_sigma(predicted) < largest

    def _near(self, predicted: MotionFilter, fits: list[FrameFit]) -> list[FrameFit]:
        """Fits near the prediction, if it is informative and one of them passes the strict gate."""
        if not self._is_informative(predicted):
            return []
        gate = self._map.settings.gate_sigma
        near = [
            f
            for f in fits
            if mahalanobis(f.filter, predicted) < gate
            and rotation_angle(f.filter.R @ predicted.R.T) < FURTHEST
        ]
        return near if any(self._passes(f) for f in near) else []

    def _is_hardly_mapped(self, fit: FrameFit, view: View) -> bool:
        """Whether most of the frame matches nothing mapped: then nothing tells of its attitude."""
        return (
            mapped_fraction(self._map.references(fit.filter), view, fit.filter.T_sensor_target) < MIN_OVERLAP
        )

    def _search(self, predicted: MotionFilter, view: View, starts: list[Array]) -> list[FrameFit]:
        return search(predicted, view, starts, self._map.references, self._map.settings.min_share)

    def _anywhere(self, predicted: MotionFilter, view: View, surface: Surface) -> list[FrameFit]:
        """Fits from the attitudes that look most alike, and from those easily confused with the best."""
        starts = [T[:3, :3] for T in global_pose_search(surface, view)]
        fits = self._search(predicted, view, [log_so3(R @ predicted.R.T) for R in starts])
        if fits and self._passes(fits[0]):
            turned = [fits[0].filter.R @ F for F in _flips(surface)]
            fits += self._search(predicted, view, [log_so3(R @ predicted.R.T) for R in turned])
        return fits

    # hypotheses ----------------------------------------------------------------------------------------

    def _advance_hypotheses(self, predicted: MotionFilter, view: View) -> FrameFit | None:
        """Track all hypotheses into the next frame; select the last, the leading, or finally the nearest."""
        dt, stretch = (view.frame.stamp_ns - self._stamp_ns) * 1e-9, self._map.stretch
        # while a slow machine searched, nothing was watched
        longest_ns = round(1e9 * (self._map.settings.lost_after + 0.5) / USUAL_HZ * stretch)
        self._watched_ns += min(view.frame.stamp_ns - self._stamp_ns, longest_ns)
        surviving: list[PoseHypothesis] = []
        advanced = [h for h in (self._advanced(h, view, dt) for h in self._hypotheses) if h is not None]
        for hypothesis in sorted(self._not_refuted(advanced), key=lambda h: -h.score):
            if all(_angle_between(hypothesis, other) > SAME for other in surviving):
                surviving.append(hypothesis)
        self._hypotheses, self._stamp_ns = surviving, view.frame.stamp_ns
        if not surviving:
            return None
        frames = len(surviving[0].scores)
        age_ns = self._watched_ns / stretch  # as at 10 Hz
        passes = self._passes(surviving[0].fit)
        if len(surviving) == 1 and frames >= CONFIRMED and passes:
            return self._select(surviving[0])
        lead = surviving[0].score - surviving[1].score if len(surviving) > 1 else 0.0
        # errors are correlated between frames; without a model, which averages them, frames do not add up
        surface = self._map.surface
        lead *= 1.0 if surface is None else np.sqrt(frames)
        if age_ns >= DECIDED_AFTER_NS and lead > DECIDED and passes:
            return self._select(surviving[0])
        if age_ns < (LONGEST_SCANNING_NS if surface is None else LONGEST_AMBIGUITY_NS):
            return None
        if surface is None:
            self._hypotheses = []
            return None
        nearest = min(surviving, key=lambda h: rotation_angle(h.fit.filter.R @ predicted.R.T))
        return self._select(nearest, ambiguous=True)

    def _advanced(self, hypothesis: PoseHypothesis, view: View, dt: float) -> PoseHypothesis | None:
        """A hypothesis registered to the next frame; None where it is no longer known what that shows.

        A slow machine is done with a search when many frames have passed: how far the rates reach decides,
        and no time.
        """
        motion = hypothesis.fit.filter.predicted(dt)
        references = self._map.references(motion)
        if not references or attitude_sigma(motion) > np.radians(self._map.settings.max_uncertainty_deg):
            return None
        fit = pictured(fit_frame(motion, view, references, GATES), view, references, GATES[-1])
        return PoseHypothesis(fit, hypothesis.penalty, [*hypothesis.scores, fit.score])

    def _not_refuted(self, advanced: list[PoseHypothesis]) -> list[PoseHypothesis]:
        """Hypotheses that pass the strict gate; without a model also those that score nearly as well."""
        best = max((h.fit.score for h in advanced if self._passes(h.fit)), default=np.inf)
        least = best - DECIDED if self._map.surface is None else np.inf
        return [h for h in advanced if self._passes(h.fit) or h.fit.score > least]

    def _passes(self, fit: FrameFit) -> bool:
        return passes_strict_gate(fit, self._map.level, self._map.settings)

    def _select(self, hypothesis: PoseHypothesis, ambiguous: bool = False) -> FrameFit:
        self._hypotheses = []
        self.ambiguous = ambiguous
        self.consistent_with_prediction &= not ambiguous
        return hypothesis.fit


def is_underconstrained(fits: list[FrameFit]) -> bool:
    """Whether fits from several starts, best first, converged to different poses with similar scores."""
    best = fits[0]
    return any(
        f.score > best.score - AS_GOOD and rotation_angle(f.filter.R @ best.filter.R.T) > VALLEY_ANGLE
        for f in fits
    )


def opposite_side_unmapped(fit: FrameFit, surface: Surface) -> bool:
    """Whether the model lacks the side opposite to the visible one: a frame of that matches this one best."""

    def outline(sight: Array) -> float:
        """Projected area of the surface along a direction: equal from both sides of a closed surface."""
        return float(np.maximum(surface.normals @ sight, 0.0).sum())

    sight = -fit.filter.R[2]  # towards the sensor, target frame
    opposite = [exp_so3(np.pi * axis) @ sight for axis in _principal_axes(surface).T]
    return min(outline(s) for s in opposite) < UNMAPPED_SIDE * outline(sight)


def _angle_between(a: PoseHypothesis, b: PoseHypothesis) -> float:
    return rotation_angle(a.fit.filter.R @ b.fit.filter.R.T)


def _flips(surface: Surface) -> list[Array]:
    """Half and quarter turns (3, 3) about the principal axes: most bodies look alike after them."""
    axes = _principal_axes(surface).T
    return [exp_so3(angle * axis) for axis in axes for angle in (np.pi, np.pi / 2, -np.pi / 2)]


def _principal_axes(surface: Surface) -> Array:
    centred = surface.points.astype(np.float64)
    centred -= centred.mean(axis=0)
    return np.asarray(np.linalg.eigh(centred.T @ centred)[1])
