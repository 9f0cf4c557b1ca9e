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

"""Finding a target again: near its prediction, then anywhere; rivals are followed until one is left."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array, exp_so3, log_so3, rotation_angle
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import (
    FrameFit,
    OdometrySettings,
    Reference,
    fit_frame,
    passes_strict_gate,
)
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
PATIENCE = 2  # searches everywhere that found nothing near the prediction, until it is given up
FOLLOWED = 5  # rivals
LACKING = 0.6  # of the outline of one side: the other side, which has less, is not in the model
UNLIKELY = 0.006  # of the score, times the square of the distance from the prediction in sigma
SAME = np.radians(3.0)  # rivals that have come this close are one
CONFIRMED = 4  # frames that the only one left must have explained
SURE = np.radians(5.0)  # 1 sigma: a fit where so good a prediction has the target needs no confirmation
HELD = 0.001  # rotation information; with less, one flat face may slide along another and explain all
SLID, AS_GOOD = np.radians(2.0), 0.1  # then fits so far apart, of scores so close, lie in one valley
KNOWN = 0.2  # of what a frame shows must match what is known; less is an edge-on plate's rim
DECIDED = 0.03  # lead of the mean score, with a model times the root of the number of frames, that decides
DECIDED_AFTER_NS = 400_000_000
LONGEST_AMBIGUITY_NS = (
    1_000_000_000  # after so long they are alike for good, and the nearest is as good as any
)
LONGEST_SCANNING_NS = 2_500_000_000  # without a model to go back to, a wrong one would spoil the scan


@dataclass
class PoseHypothesis:
    """One of several attitudes that explain the frames seen since."""

    fit: FrameFit
    unlikely: float  # how far the prediction speaks against it, as a score
    scores: list[float]

    @property
    def score(self) -> float:
        """Mean over the frames, less what the prediction says against it."""
        return float(np.mean(self.scores)) - self.unlikely


class Relocalizer:
    """Searches for a lost target, frame by frame.

    ``ambiguous``: what was found has a rival that no frame contradicted. ``consistent_with_prediction``:
    it lies where the prediction said; what was found by appearance alone may be another face like it.
    """

    def __init__(self, references_of: Callable[[MotionFilter], list[Reference]]) -> None:
        self.settings = OdometrySettings()
        self._references_of = references_of
        self.reset()

    def reset(self) -> None:
        """The target was seen where it should be, or everything is forgotten."""
        self.ambiguous, self.consistent_with_prediction = False, True
        self._hypotheses: list[PoseHypothesis] = []
        self._since_ns = self._stamp_ns = 0
        self._searched_ns = self._searches = 0

    def find(
        self,
        predicted: MotionFilter,
        view: View,
        surface: Surface | None,
        lost: bool,
        settings: OdometrySettings,
    ) -> FrameFit | None:
        """The one fit that explains the frame, once there is one.

        Args:
            predicted: the prediction for the frame.
            view: the frame.
            surface: of the model, if there is one.
            lost: for so long that it may be anywhere.
            settings: they may change while a scan goes on.
        """
        self.settings = settings
        if self._hypotheses:
            found = self._advance_hypotheses(predicted, view, surface)
            if found is not None or self._hypotheses:
                return found
        fits = self._search(predicted, view, nearby(predicted))
        near = self._near(predicted, fits)
        overdue = (view.frame.stamp_ns - self._searched_ns) * 1e-9 >= self.settings.search_period
        self.consistent_with_prediction = bool(near)
        if not near and surface is not None and lost and overdue:
            self._searched_ns = view.frame.stamp_ns
            fits = sorted([*fits, *self._anywhere(predicted, view, surface)], key=lambda f: -f.score)
            if self._searches >= PATIENCE or not self._certain(predicted):
                near = fits
            self._searches += 1

        def unlikely(fit: FrameFit) -> float:
            return (
                UNLIKELY * mahalanobis(fit.filter, predicted) ** 2 if self.consistent_with_prediction else 0.0
            )

        near = sorted(near, key=lambda f: unlikely(f) - f.score)
        # where the best is in doubt, as with a target half hidden, no worse one is the better for it
        if not near or not passes_strict_gate(
            near[0], self.settings, consistent_with_prediction=self.consistent_with_prediction
        ):
            return None
        if (
            not self.consistent_with_prediction
            and surface is not None
            and opposite_side_unmapped(near[0], surface)
        ):
            return None
        sure = attitude_sigma(predicted) < SURE
        # with a model the next frames put it right, without one it would spoil the scan
        if not sure and surface is None and near[0].observability < HELD and is_underconstrained(near):
            return None
        if (
            surface is not None
            and not (sure and self.consistent_with_prediction)
            and self._is_hardly_mapped(near[0], view)
        ):
            return None
        others = competing_fits(near, lambda f: f.score - unlikely(f))
        if not others and sure:
            return near[0]
        self._hypotheses = [PoseHypothesis(f, unlikely(f), [f.score]) for f in (near[0], *others)][:FOLLOWED]
        self._since_ns = self._stamp_ns = view.frame.stamp_ns
        return None

    def _certain(self, predicted: MotionFilter) -> bool:
        """Whether the prediction says anything of the attitude."""
        return attitude_sigma(predicted) < np.radians(self.settings.max_uncertainty_deg)

    def _near(self, predicted: MotionFilter, fits: list[FrameFit]) -> list[FrameFit]:
        """Fits where the prediction says that the target is: as long as it says anything, it decides."""
        if not self._certain(predicted):
            return []
        gate = self.settings.gate_sigma
        near = [
            f
            for f in fits
            if mahalanobis(f.filter, predicted) < gate
            and rotation_angle(f.filter.R @ predicted.R.T) < FURTHEST
        ]
        return near if any(passes_strict_gate(f, self.settings) for f in near) else []

    def _is_hardly_mapped(self, fit: FrameFit, view: View) -> bool:
        """Nothing known matches but a little of what the frame shows: a rim will, wherever it is put."""
        return mapped_fraction(self._references_of(fit.filter), view, fit.filter.T_sensor_target) < KNOWN

    def _search(self, predicted: MotionFilter, view: View, starts: list[Array]) -> list[FrameFit]:
        return search(predicted, view, starts, self._references_of, self.settings.min_share)

    def _anywhere(self, predicted: MotionFilter, view: View, surface: Surface) -> list[FrameFit]:
        """Fits from the attitudes that look most alike, and from those that the best might be taken for."""
        starts = [T[:3, :3] for T in global_pose_search(surface, view)]
        fits = self._search(predicted, view, [log_so3(R @ predicted.R.T) for R in starts])
        if fits and passes_strict_gate(fits[0], self.settings):
            turned = [fits[0].filter.R @ F for F in _flips(surface)]
            fits += self._search(predicted, view, [log_so3(R @ predicted.R.T) for R in turned])
        return fits

    def _advance_hypotheses(
        self, predicted: MotionFilter, view: View, surface: Surface | None
    ) -> FrameFit | None:
        """The rivals in the next frame; the one that is left, or leads, or at last the nearest."""
        dt = (view.frame.stamp_ns - self._stamp_ns) * 1e-9
        alive: list[PoseHypothesis] = []
        if dt < self.settings.max_gap:
            followed = [f for f in (self._next(r, view, dt) for r in self._hypotheses) if f is not None]
            for rival in sorted(self._not_refuted(followed, surface), key=lambda r: -r.score):
                if all(_apart(rival, other) > SAME for other in alive):
                    alive.append(rival)
        self._hypotheses, self._stamp_ns = alive, view.frame.stamp_ns
        if not alive:
            return None
        frames, age_ns = len(alive[0].scores), view.frame.stamp_ns - self._since_ns
        passes = self._passes(alive[0])
        if len(alive) == 1 and frames >= CONFIRMED and passes:
            return self._select(alive[0])
        lead = alive[0].score - alive[1].score if len(alive) > 1 else 0.0
        # errors last from frame to frame; without a model, which would find out, frames do not add up
        lead *= 1.0 if surface is None else np.sqrt(frames)
        if age_ns >= DECIDED_AFTER_NS and lead > DECIDED and passes:
            return self._select(alive[0])
        if age_ns < (LONGEST_SCANNING_NS if surface is None else LONGEST_AMBIGUITY_NS):
            return None
        if surface is None:
            self._hypotheses = []
            return None
        nearest = min(alive, key=lambda r: rotation_angle(r.fit.filter.R @ predicted.R.T))
        return self._select(nearest, ambiguous=True)

    def _next(self, rival: PoseHypothesis, view: View, dt: float) -> PoseHypothesis | None:
        motion = rival.fit.filter.copy()
        motion.predict(dt)
        references = self._references_of(motion)
        if not references:
            return None
        fit = fit_frame(motion, view, references, GATES)
        return PoseHypothesis(fit, rival.unlikely, [*rival.scores, fit.score])

    def _not_refuted(self, followed: list[PoseHypothesis], surface: Surface | None) -> list[PoseHypothesis]:
        """Those that the frame bears out; without a model also what fails where the best just passes."""
        best = max((r.fit.score for r in followed if self._passes(r)), default=np.inf)
        return [r for r in followed if self._passes(r) or (surface is None and r.fit.score > best - DECIDED)]

    def _passes(self, rival: PoseHypothesis) -> bool:
        return passes_strict_gate(rival.fit, self.settings)

    def _select(self, rival: PoseHypothesis, ambiguous: bool = False) -> FrameFit:
        self._hypotheses = []
        self.ambiguous = ambiguous
        self.consistent_with_prediction &= not ambiguous
        return rival.fit


def is_underconstrained(fits: list[FrameFit]) -> bool:
    """Whether fits from several starts, best first, came to rest apart though they explain about as much."""
    best = fits[0]
    return any(
        f.score > best.score - AS_GOOD and rotation_angle(f.filter.R @ best.filter.R.T) > SLID for f in fits
    )


def _apart(a: PoseHypothesis, b: PoseHypothesis) -> float:
    return rotation_angle(a.fit.filter.R @ b.fit.filter.R.T)


def opposite_side_unmapped(fit: FrameFit, surface: Surface) -> bool:
    """Whether the side across is missing from the model: what shows it then looks most like this one."""

    def outline(sight: Array) -> float:
        """Area of the surface as seen against a direction: the same from both sides of a closed one."""
        return float(np.maximum(surface.normals @ sight, 0.0).sum())

    sight = -fit.filter.R[2]  # towards the sensor, target frame
    across = [exp_so3(np.pi * axis) @ sight for axis in _principal_axes(surface).T]
    return min(outline(s) for s in across) < LACKING * outline(sight)


def _flips(surface: Surface) -> list[Array]:
    """Rotations (3, 3) by half and quarter turns about the principal axes: of most bodies, faces alike."""
    axes = _principal_axes(surface).T
    return [exp_so3(angle * axis) for axis in axes for angle in (np.pi, np.pi / 2, -np.pi / 2)]


def _principal_axes(surface: Surface) -> Array:
    centred = surface.points.astype(np.float64)
    centred -= centred.mean(axis=0)
    return np.asarray(np.linalg.eigh(centred.T @ centred)[1])
