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

"""Odometry and tracking: one filter, registered to recent key frames, later to the model.

Scanning: every frame is registered to the latest key frames inside the motion filter, and becomes a key frame
when the target has turned far enough. Tracking: the same against the model's surface. A frame that does not
pass the gate is rejected. After several rejected frames the target counts as lost; the relocalizer then
searches around the prediction, and later over all attitudes.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.frames import FrameRejected, KeyFrame, Model, TargetFrame
from debris_scanner.core.geometry import Array, compose
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View
from debris_scanner.tracking.cadence import Cadence
from debris_scanner.tracking.gating import FrameFit, OdometrySettings, passes_gate
from debris_scanner.tracking.local_map import MIN_POINTS, LocalMap
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.occlusion import Occlusion
from debris_scanner.tracking.pose_search import attitude_sigma
from debris_scanner.tracking.relocalizer import Relocalizer

SCANNING, TRACKING, LOST = 'scanning', 'tracking', 'lost'
# Why the pose of a frame was not accepted: counted under these keys in summary.json.
NOT_REGISTERED = 'not_registered'  # it does not fit, or shows too little surface
DEGENERATE_FIT = 'degenerate_fit'  # what it shows leaves no finite pose

CENTRE_DEPTH = 0.6  # of its sigma: the rotation centre lies behind the surface


@dataclass(frozen=True)
class OdometryEstimate:
    """The filter's estimate for one frame, and how the frame was used."""

    stamp_ns: int
    state: str  # scanning, tracking or lost
    accepted: bool  # the frame passed the gate
    T_sensor_target: Array  # (4, 4)
    covariance: Array  # (6, 6): rotation, translation, sensor frame
    omega_target: Array  # (3,) rad/s
    omega_sigma: Array  # (3,) rad/s
    velocity: Array  # (3,) m/s, of the rotation centre, sensor frame
    stats: RegistrationStats
    observability: float | None  # None where nothing was registered
    scan_ns: int = 0  # stamp of the scan's first key frame: distinguishes scans after a reset
    submap: int = 0  # poses of different submaps cannot be compared
    tracked: bool = False  # the pose is in the model's target frame, else in that of the scan
    path_rad: float = 0.0  # rotation travelled up to the latest key frame
    keyframe: KeyFrame | None = None  # set when this frame became one
    missing_reference_ratio: float = 0.0  # share of the reference's points outside the frame's silhouette
    usable_for_mapping: bool = True  # unoccluded, and its pose does not rest on appearance alone
    ambiguous: bool = False  # relocalized, but another attitude fits the frame as well
    rejected: str = ''  # why the frame was not accepted


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
        self._map = LocalMap(self.settings, self.normals)
        self._clear()

    def _begin_submap(self) -> None:
        """Continue with key frames in a new submap: the rotation since the last one is unknown."""
        self._map.begin_submap()
        self._clear()

    def _clear(self) -> None:
        self.state = SCANNING
        self.filter: MotionFilter | None = None
        self.T_target_scanning: Array = np.eye(4)  # the target frame in which the submap began, in today's
        self._stamp_ns = 0
        self._rejected_in_a_row = 0
        self._cadence = Cadence()
        self._relocalizer = Relocalizer(self._map)
        # false once the target was relocalized by appearance alone
        self.consistent_with_prediction = True

    @property
    def model(self) -> Model | None:
        """The model that is tracked; None while scanning."""
        return self._map.model

    @property
    def keyframes(self) -> KeyFrameSet:
        """Key frames of the current submap."""
        return self._map.submaps.keyframes

    @property
    def submap(self) -> int:
        """Number of the current submap; poses of different submaps cannot be compared."""
        return self._map.submaps.number

    @property
    def full(self) -> str:
        """Why the scan gets no more key frames; empty while it may."""
        return self._map.submaps.full(self.settings)

    def process(self, frame: TargetFrame) -> OdometryEstimate:
        """Filter one target frame; stamps must increase.

        Raises:
            FrameRejected: ``not_registered``: a scan cannot begin with this frame.
        """
        try:
            return self._process(frame)
        except FrameRejected:
            raise
        except Exception:
            self._forget_what_raises()
            raise

    def _process(self, frame: TargetFrame) -> OdometryEstimate:
        self._cadence.add(frame.stamp_ns)
        with self.timer.stage('view'):
            view = self._map.prepare(frame, self.settings, self._max_gap, self._cadence.stretch)
        if self.filter is None:
            return self._start(view)
        dt = (frame.stamp_ns - self._stamp_ns) * 1e-9
        predicted = self._predict(frame.stamp_ns, dt)  # x(t|t-1), P(t|t-1)
        with self.timer.stage('tracking' if self.model else 'registration'):
            registered = None
            if dt < self._max_gap:  # argmin of |r|^2 + |x - x(t|t-1)|^2 in P^-1
                registered = self._map.register(predicted, view, self.filter, dt)
            fit = self._gate(registered) or self._relocalize(predicted, view, dt)
        if fit is None:
            return self._reject(predicted, view, registered)
        ambiguous = self._update(fit, dt, frame.stamp_ns)
        keyframe = self._map.add(fit, view, self.consistent_with_prediction)
        return self._report(fit.filter, view, fit, keyframe, accepted=True, ambiguous=ambiguous)

    def adopt_model(self, model: Model, poses: dict[int, Array], offset: DepthOffset = NO_OFFSET) -> None:
        """Switch to tracking a model.

        Args:
            model: in its own target frame.
            poses: optimised T_target_sensor (4, 4) of key frames by stamp, in the model's target frame.
            offset: of the sensor, that model and poses are free from.

        Raises:
            ValueError: if none of the poses is of a key frame known here.
        """
        T_new_old, inertia = self._map.adopt(model, poses, offset)
        assert self.filter is not None  # else there are no key frames
        self.T_target_scanning = compose(T_new_old, self.T_target_scanning)
        self.filter.change_target_frame(T_new_old)
        self.filter.know_inertia(inertia)
        self._relocalizer.reset()  # its hypotheses are in the old target frame
        self.state = TRACKING if self.state != LOST else LOST

    def drop_model(self) -> None:
        """Scan on without the model: it is not this target's, so poses that it gave lead nowhere."""
        if self.model is not None:
            self._begin_submap()

    def resume(
        self, keyframes: list[KeyFrame], motion: MotionFilter, stamp_ns: int, consistent: bool = True
    ) -> None:
        """After a reset, continue from another process's key frames and its filter at a stamp.

        Args:
            keyframes: in order of time.
            motion: the filter.
            stamp_ns: of the filter.
            consistent: the other's ``consistent_with_prediction``.
        """
        self._map.submaps.resume(keyframes)
        self.consistent_with_prediction = consistent
        self.filter, self._stamp_ns = motion, stamp_ns
        self._cadence = Cadence(k.stamp_ns for k in keyframes)

    def _start(self, view: View) -> OdometryEstimate:
        """Begin a scan or a submap: the frame is its first key frame."""
        if len(view.points) < MIN_POINTS:
            raise FrameRejected(NOT_REGISTERED, f'a scan cannot begin with {len(view.points)} surface points')
        behind = np.array([0.0, 0.0, CENTRE_DEPTH * self.motion.centre_sigma * view.footprint])
        motion = MotionFilter(view.centroid + behind, self.motion, view.footprint)
        keyframe = self._map.submaps.add(view, motion)
        self.filter, self._stamp_ns = motion, view.frame.stamp_ns
        return self._report(motion, view, None, keyframe, accepted=True)

    def _predict(self, stamp_ns: int, dt: float) -> MotionFilter:
        """The filter at a stamp; after a gap propagated from the last unoccluded view."""
        assert self.filter is not None
        if dt >= self._max_gap and (seen := self._map.occlusion.last_unoccluded()) is not None:
            return seen[0].predicted((stamp_ns - seen[1]) * 1e-9)
        return self.filter.predicted(dt)

    def _gate(self, fit: FrameFit | None) -> FrameFit | None:
        """The fit if it passes the gate: the target is where it was predicted."""
        if fit is None or not passes_gate(fit, self._map.level, self.settings):
            return None
        self._relocalizer.reset()
        return fit

    def _relocalize(self, predicted: MotionFilter, view: View, dt: float) -> FrameFit | None:
        """Search for the target: near its prediction, and over all attitudes once it is lost.

        A frame that is only now not where it was predicted may show a target that was set in motion.
        """
        if not self._map.shows_target(view):
            return None
        view.unoccluded = True
        lost = self._rejected_in_a_row + 1 >= self.settings.lost_after
        followed = not self._rejected_in_a_row and dt < self._max_gap
        if followed:
            assert self.filter is not None
            predicted = self.filter.released().predicted(dt)
        return self._relocalizer.find(predicted, view, lost, followed)

    def _reject(self, predicted: MotionFilter, view: View, fit: FrameFit | None) -> OdometryEstimate:
        """Report the prediction; begin a new submap if the target was lost for too long without a model."""
        self._rejected_in_a_row += 1
        if self._rejected_in_a_row >= self.settings.lost_after:
            self.state = LOST
            if self._must_begin_submap(predicted, view):
                self._begin_submap()
                return self._start(view)
        return self._report(predicted, view, fit)

    def _forget_what_raises(self) -> None:
        """After several frames in a row that raised, go on without the views that all of them were given."""
        self._rejected_in_a_row += 1
        if self._rejected_in_a_row < self.settings.lost_after:
            return
        self._map.occlusion = Occlusion()
        self._relocalizer.reset()
        if self.model is None and self.filter is not None:
            self._begin_submap()

    def _update(self, fit: FrameFit, dt: float, stamp_ns: int) -> bool:
        """Make an accepted fit the state; whether another attitude fits its frame as well."""
        self._rejected_in_a_row = 0
        self.consistent_with_prediction &= self._relocalizer.consistent_with_prediction
        ambiguous = self._relocalizer.ambiguous
        self._relocalizer.reset()
        self._stamp_ns = stamp_ns
        self.filter = fit.filter
        if dt < self._max_gap:
            self.filter.adapt(dt)
        self.state = TRACKING if self.model else SCANNING
        return ambiguous

    def _must_begin_submap(self, predicted: MotionFilter, view: View) -> bool:
        """Whether the target is in view, but neither a model nor the prediction gives its attitude."""
        lost_track = attitude_sigma(predicted) > np.radians(self.settings.max_uncertainty_deg)
        return self.model is None and lost_track and self._map.shows_target(view) and not self.full

    @property
    def _max_gap(self) -> float:
        """Time, s, after which the target is searched; of a slow sensor as many frames as of a fast one."""
        return self._cadence.span_s(self.settings.lost_after + 0.5)

    def _report(
        self,
        motion: MotionFilter,
        view: View,
        fit: FrameFit | None,
        keyframe: KeyFrame | None = None,
        accepted: bool = False,
        ambiguous: bool = False,
    ) -> OdometryEstimate:
        return OdometryEstimate(
            stamp_ns=view.frame.stamp_ns,
            state=self.state,
            accepted=accepted,
            T_sensor_target=motion.T_sensor_target,
            covariance=motion.pose_covariance,
            omega_target=motion.omega_target,
            omega_sigma=motion.omega_sigma,
            velocity=motion.velocity.copy(),
            stats=fit.stats if fit else RegistrationStats(),
            observability=fit.observability if fit else None,
            scan_ns=self._map.submaps.scan_ns,
            submap=self.submap,
            tracked=self.model is not None,
            path_rad=self._map.submaps.path_rad,
            keyframe=keyframe,
            missing_reference_ratio=fit.missing_reference_ratio if fit else 0.0,
            usable_for_mapping=accepted and view.unoccluded and self.consistent_with_prediction,
            ambiguous=ambiguous,
            rejected='' if accepted else DEGENERATE_FIT if fit and fit.degenerate else NOT_REGISTERED,
        )
