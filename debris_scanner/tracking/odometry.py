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

"""What the odometry says of one frame.

Odometry and tracking: one filter, registered to recent key frames, later to the model.

Scanning: every frame is registered to the last key frames inside the motion filter, and becomes a
key frame when the target has turned far enough. Tracking: the same against the model's surface.
A frame that does not agree is not believed; after several the target counts as lost and is searched
for around the prediction, then everywhere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from debris_scanner.core.frames import KeyFrame, Model, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import (
    FrameFit,
    OdometrySettings,
    Reference,
    fit_frame,
    passes_gate,
    shows_unmapped_surface,
)
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.occlusion import LONGEST_OCCLUSION_NS, Occlusion
from debris_scanner.tracking.pose_search import attitude_sigma, tracking_surface
from debris_scanner.tracking.relocalizer import Relocalizer
from debris_scanner.tracking.submaps import Submaps, choose_references


@dataclass(frozen=True)
class OdometryEstimate:
    """What the filter says of one frame."""

    stamp_ns: int
    state: str
    accepted: bool  # the gate's verdict
    T_sensor_target: Array  # (4, 4)
    covariance: Array  # (6, 6): rotation, translation, sensor frame
    omega_target: Array  # (3,) rad/s
    omega_sigma: Array  # (3,) rad/s
    velocity: Array  # (3,) m/s, of the rotation centre, sensor frame
    stats: RegistrationStats
    observability: float | None  # None where nothing was registered
    submap: int = 0  # poses of different submaps cannot be compared
    keyframe: KeyFrame | None = None  # set when this frame became one
    missing_reference_ratio: float = 0.0  # share of the reference's points beside the frame's silhouette
    usable_for_mapping: bool = (
        True  # the whole side is seen, and where it is not told by its looks alone: fit for a model
    )
    ambiguous: bool = False  # found again, but another attitude explains the frame as well

    @staticmethod
    def of(motion: MotionFilter, view: View, fit: FrameFit | None, **verdict: Any) -> 'OdometryEstimate':
        """What a filter says of a frame, how the frame fits, and what was made of it."""
        return OdometryEstimate(
            stamp_ns=view.frame.stamp_ns,
            T_sensor_target=motion.T_sensor_target,
            covariance=motion.pose_covariance,
            omega_target=motion.omega_target,
            omega_sigma=motion.omega_sigma,
            velocity=motion.velocity.copy(),
            stats=fit.stats if fit else RegistrationStats(),
            observability=fit.observability if fit else None,
            missing_reference_ratio=fit.missing_reference_ratio if fit else 0.0,
            **verdict,
        )


SCANNING, TRACKING, LOST = 'scanning', 'tracking', 'lost'

GATES = (0.03, 0.02, 0.012, 0.012, 0.008, 0.008)  # m, shrinking over the iterations


class Odometry:
    """Pose, rates and key frames of the target, frame by frame."""

    def __init__(
        self,
        settings: OdometrySettings,
        motion: MotionSettings,
        normals: NormalSettings,
        timer: StageTimer | None = None,
    ) -> None:
        self.settings = settings
        self.motion = motion
        self.normals = normals
        self.timer = timer or StageTimer()
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next frame is the first key frame of a new scan."""
        self._submaps = Submaps(self.normals)
        self._clear()

    def _begin_submap(self) -> None:
        """Go on though nothing tells how the target has turned: with key frames comparable to none before."""
        self._submaps.begin(travelled=np.pi)  # or more: nobody saw it
        self._clear()

    def _clear(self) -> None:
        self.state = SCANNING
        self.filter: MotionFilter | None = None
        self.model: Model | None = None
        self._surface: Surface | None = None
        self._stamp_ns = 0
        self._rejected_in_a_row = 0
        self._occlusion = Occlusion()
        self._relocalizer = Relocalizer(self._references)
        self.consistent_with_prediction = (
            True  # the target was never lost so long that looks alone told where it is
        )

    @property
    def keyframes(self) -> KeyFrameSet:
        """Those of the current submap."""
        return self._submaps.keyframes

    @property
    def submap(self) -> int:
        """Number of the current one; poses of different submaps cannot be compared."""
        return self._submaps.number

    @property
    def scan_ns(self) -> int:
        """Stamp of the scan's first key frame."""
        return self._submaps.scan_ns

    @property
    def full(self) -> str:
        """Why the scan gets no more key frames, in words; empty while it may."""
        return self._submaps.full(self.settings)

    def process(self, frame: TargetFrame) -> OdometryEstimate:
        """Filter one target frame; stamps must increase."""
        with self.timer.stage('view'):
            view = View(frame)
        if self._enough(view):
            self._occlusion.note(view, self.settings.max_gap)
        view.unoccluded = not self._occlusion.entering_view
        if self.filter is None:
            return self._start(view)
        dt = (frame.stamp_ns - self._stamp_ns) * 1e-9
        predicted = self._predicted(frame.stamp_ns, dt)
        with self.timer.stage('tracking' if self.model else 'registration'):
            fit, accepted = self._estimate(predicted, view, dt)
        if not accepted:
            self._rejected_in_a_row += 1
            if self._rejected_in_a_row >= self.settings.lost_after:
                self.state = LOST
                if self._must_begin_submap(predicted, view):
                    self._begin_submap()
                    return self._start(view)
            return self._report(predicted, view, fit)
        assert fit is not None
        self._rejected_in_a_row = 0
        self.consistent_with_prediction &= self._relocalizer.consistent_with_prediction
        ambiguous = self._relocalizer.ambiguous
        self._relocalizer.reset()
        self._stamp_ns = frame.stamp_ns
        self.filter = fit.filter
        if dt < self.settings.max_gap:
            self.filter.adapt(dt)
        self.state = TRACKING if self.model else SCANNING
        view.unoccluded = not (
            self._occlusion.entering_view or self._occlusion.hides(fit, frame.stamp_ns, self.settings)
        )
        self._occlusion.take(view, fit.filter)
        keyframe = None
        if view.unoccluded and self.consistent_with_prediction:
            keyframe = self._submaps.choose(view, self.filter, self.model is not None, self.settings)
        return self._report(fit.filter, view, fit, keyframe, True, ambiguous)

    def adopt_model(self, model: Model, poses: dict[int, Array]) -> None:
        """Switch to tracking a model.

        Args:
            model: in its own target frame.
            poses: optimised T_target_sensor (4, 4) of key frames by stamp, in the model's target frame.

        Raises:
            ValueError: if none of the poses is of a key frame known here.
        """
        known = [k for k in self.keyframes.frames if k.stamp_ns in poses]
        if not known or self.filter is None:
            raise ValueError('the model shares no key frame with this odometry')
        last = known[-1]
        T_new_old = compose(poses[last.stamp_ns], inverse(last.T_target_sensor))
        self.keyframes.move(poses, T_new_old)
        self.filter.change_target_frame(T_new_old)
        self._occlusion.change_target_frame(T_new_old)
        self.model = model
        self._surface = tracking_surface(model)
        self._relocalizer.reset()  # what it followed was in the old target frame
        self.state = TRACKING if self.state != LOST else LOST

    def resume(self, keyframes: list[KeyFrame], motion: MotionFilter, stamp_ns: int) -> None:
        """Go on, after a reset, where another process stopped: its key frames, and its filter at a stamp."""
        self._submaps.resume(keyframes)
        self.filter, self._stamp_ns = motion, stamp_ns

    def _start(self, view: View) -> OdometryEstimate:
        behind = np.array([0.0, 0.0, self.motion.centre_depth])
        self.filter = MotionFilter(view.centroid + behind, self.motion)
        self._stamp_ns = view.frame.stamp_ns
        keyframe = self._submaps.add(view, self.filter)
        return self._report(self.filter, view, None, keyframe, accepted=True)

    def _predicted(self, stamp_ns: int, dt: float) -> MotionFilter:
        """The filter at a stamp; after a gap as it was when the whole side was last seen."""
        assert self.filter is not None
        predicted = self.filter.copy()
        if dt >= self.settings.max_gap and (seen := self._occlusion.last_unoccluded()) is not None:
            predicted, dt = seen[0], (stamp_ns - seen[1]) * 1e-9
        predicted.predict(dt)
        return predicted

    def _estimate(self, predicted: MotionFilter, view: View, dt: float) -> tuple[FrameFit | None, bool]:
        if not self._enough(view):
            return None, False
        fit = None
        if dt < self.settings.max_gap:
            references = self._references(predicted)
            if references:
                fit = fit_frame(predicted, view, references, GATES)
                if self._occlusion.hides(fit, view.frame.stamp_ns, self.settings):
                    # something hides a part: its shadow's edge would pass for the target's
                    view.unoccluded = False
                    fit = fit_frame(predicted, view, references, GATES)
                if shows_unmapped_surface(fit, self.settings) and self._submap_is_young(view):
                    # a submap of whole views: those so far turn out to be half hidden
                    self._occlusion.uncover(references)
                    self._submaps.begin()
                    view.unoccluded = False
                    fit = fit_frame(predicted, view, references, GATES)
                if passes_gate(fit, self.settings):
                    self._relocalizer.reset()
                    return fit, True
        if self._occlusion.entering_view:
            return fit, False  # the edge that it seems to have would mislead
        view.unoccluded = True
        lost = self._rejected_in_a_row + 1 >= self.settings.lost_after
        found = self._relocalizer.find(predicted, view, self._surface, lost, self.settings)
        return (found, True) if found is not None else (fit, False)

    def _submap_is_young(self, view: View) -> bool:
        """No whole view from before this submap's key frames tells that they show the whole side."""
        return self.model is None and self._submaps.younger(view.frame.stamp_ns, LONGEST_OCCLUSION_NS)

    def _must_begin_submap(self, predicted: MotionFilter, view: View) -> bool:
        """The target is in sight as a whole, but no model and no prediction tells how it has turned."""
        lost_track = attitude_sigma(predicted) > np.radians(self.settings.max_uncertainty_deg)
        shown = self._enough(view) and not self._occlusion.entering_view
        return self.model is None and lost_track and shown and not self.full

    def _enough(self, view: View) -> bool:
        return len(view.points) >= self.settings.min_points

    def _references(self, motion: MotionFilter) -> list[Reference]:
        return choose_references(
            motion, self.keyframes, self._occlusion.partial, self._surface, self.settings
        )

    def _report(
        self,
        motion: MotionFilter,
        view: View,
        fit: FrameFit | None,
        keyframe: KeyFrame | None = None,
        accepted: bool = False,
        ambiguous: bool = False,
    ) -> OdometryEstimate:
        return OdometryEstimate.of(
            motion,
            view,
            fit,
            state=self.state,
            accepted=accepted,
            submap=self.submap,
            keyframe=keyframe,
            usable_for_mapping=view.unoccluded and self.consistent_with_prediction,
            ambiguous=ambiguous,
        )
