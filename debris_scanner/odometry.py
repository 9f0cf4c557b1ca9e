"""Odometry and tracking: one filter, registered to recent key frames, later to the model.

Scanning: every frame is registered to the last key frames inside the motion filter, and becomes a
key frame when the target has turned far enough. Tracking: the same against the model's surface.
A frame that does not agree is not believed; after several the target counts as lost and is searched
for around the prediction, then everywhere.
"""

import numpy as np

from debris_scanner.attitude_search import attitude_sigma, choose, nearby, search
from debris_scanner.belief import believable, beyond_doubt
from debris_scanner.frame_fit import FrameFit, Reference, fit_frame
from debris_scanner.frames import KeyFrame, TargetFrame
from debris_scanner.geometry import Array, compose, inverse, log_so3, rotation_angle
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.model import Model
from debris_scanner.motion_filter import MotionFilter, MotionSettings
from debris_scanner.normals import NormalSettings
from debris_scanner.odometry_estimate import OdometryEstimate
from debris_scanner.odometry_settings import OdometrySettings
from debris_scanner.reacquisition import find_pose, tracking_surface
from debris_scanner.registration import Agreement
from debris_scanner.timing import StageTimer
from debris_scanner.views import Surface, View

SCANNING, TRACKING, LOST = 'scanning', 'tracking', 'lost'

APPEARING = 1.05  # a frame with more points than this times the last one's shows a target still appearing
PARTIAL_VIEWS = 4  # the latest of them bridge the time until the whole side is seen again
PATIENCE = 2  # searches everywhere that found nothing near the prediction, until it is given up

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
        self.state = SCANNING
        self.keyframes = KeyFrameSet(self.normals)
        self.filter: MotionFilter | None = None
        self.model: Model | None = None
        self._surface: Surface | None = None
        self._stamp_ns = 0
        self._searched_ns, self._searches = 0, 0
        self._disbelieved = 0
        self._partial: list[Reference] = []
        self._path = 0.0
        self._ambiguous = False
        self._points = 0  # of the last frame
        self.hopeless = False  # in sight, but nothing tells any more how it has turned: begin a new scan

    def process(self, frame: TargetFrame) -> OdometryEstimate:
        """Filter one target frame; stamps must increase."""
        with self.timer.stage('view'):
            view = View(frame)
        if self.filter is None:
            return self._start(view)
        dt = (frame.stamp_ns - self._stamp_ns) * 1e-9
        predicted = self.filter.copy()
        predicted.predict(dt)
        self._ambiguous = self.hopeless = False
        with self.timer.stage('tracking' if self.model else 'registration'):
            fit, believed = self._estimate(predicted, view, dt)
        if not believed:
            self._disbelieved += 1
            if self._disbelieved >= self.settings.lost_after:
                self.state = LOST
                self.hopeless = self._nothing_tells(predicted, view)
            self._points = len(view.points)
            return self._report(predicted, view, None, fit)
        assert fit is not None
        self._disbelieved = self._searches = 0
        self._stamp_ns = frame.stamp_ns
        self.filter = fit.filter
        if dt < self.settings.max_gap:
            self.filter.adapt(dt)
        self.state = TRACKING if self.model else SCANNING
        view.whole = fit.missing < self.settings.max_keyframe_missing
        keyframe = self._keyframe(view) if view.whole else None
        if not view.whole:
            self._partial = [*self._partial[1 - PARTIAL_VIEWS :], (view, inverse(fit.filter.T_sensor_target))]
        return self._report(fit.filter, view, keyframe, fit, believed=True)

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
        self.model = model
        self._surface = tracking_surface(model)
        self.state = TRACKING if self.state != LOST else LOST

    def resume(self, keyframes: list[KeyFrame], motion: MotionFilter, stamp_ns: int) -> None:
        """Go on, after a reset, where another process stopped: its key frames, and its filter at a stamp."""
        for keyframe in keyframes:
            self.keyframes.add(keyframe)
        self.filter, self._stamp_ns, self._path = motion, stamp_ns, keyframes[-1].path_rad

    def _start(self, view: View) -> OdometryEstimate:
        behind = np.array([0.0, 0.0, self.motion.centre_depth])
        self.filter = MotionFilter(view.centroid + behind, self.motion)
        self._stamp_ns = view.frame.stamp_ns
        keyframe = self._add_keyframe(view)
        return self._report(self.filter, view, keyframe, None, believed=True)

    def _estimate(self, predicted: MotionFilter, view: View, dt: float) -> tuple[FrameFit | None, bool]:
        if not self._enough(view):
            return None, False
        fit = None
        if dt < self.settings.max_gap:
            references = self._references(predicted)
            if references:
                fit = fit_frame(predicted, view, references, GATES)
                if fit.missing > self.settings.max_keyframe_missing:
                    # something hides a part: its shadow's edge would pass for the target's
                    view.whole = False
                    fit = fit_frame(predicted, view, references, GATES)
                if believable(fit, self.settings):
                    return fit, True
        found = self._search(predicted, view, nearby(predicted))
        overdue = (view.frame.stamp_ns - self._searched_ns) * 1e-9 >= self.settings.search_period
        lost = self._disbelieved + 1 >= self.settings.lost_after
        if found is None and self._surface is not None and lost and overdue:
            self._searched_ns = view.frame.stamp_ns
            turns = [log_so3(T[:3, :3] @ predicted.R.T) for T in find_pose(self._surface, view)]
            found = self._search(predicted, view, turns, anywhere=self._searches >= PATIENCE)
            self._searches += 1
        return (found, True) if found is not None else (fit, False)

    def _nothing_tells(self, predicted: MotionFilter, view: View) -> bool:
        """The target is in sight as a whole, but no model and no prediction tells how it has turned."""
        lost_track = attitude_sigma(predicted) > np.radians(self.settings.max_uncertainty_deg)
        still_appearing = len(view.points) >= APPEARING * self._points
        return self.model is None and lost_track and self._enough(view) and not still_appearing

    def _enough(self, view: View) -> bool:
        return len(view.points) >= self.settings.min_points

    def _references(self, motion: MotionFilter) -> list[Reference]:
        s = self.settings
        angles = self.keyframes.view_angles(inverse(motion.T_sensor_target), motion.pivot)
        alike = [int(k) for k in np.argsort(angles) if angles[k] < np.radians(s.reference_angle_deg)]
        partial: list[Reference] = []
        if self._surface is not None:
            chosen = alike[: s.tracked_keyframes]  # they also know sides that the model lacks
        else:
            chosen = [k for k in alike if k >= len(self.keyframes) - s.recent_keyframes]
            chosen = chosen or alike[: s.recent_keyframes]  # seen again after a gap
            partial = self._partial if len(chosen) < s.recent_keyframes else []
        references: list[Reference] = [
            (self.keyframes.views[k], self.keyframes.frames[k].T_target_sensor) for k in chosen
        ]
        return [*references, *partial] if self._surface is None else [*references, (self._surface, np.eye(4))]

    def _search(
        self, predicted: MotionFilter, view: View, starts: list[Array], anywhere: bool = False
    ) -> FrameFit | None:
        """The start that leads to an agreement beyond doubt, if there is one."""
        fits = search(predicted, view, starts, self._references, self.settings.min_share)
        s = self.settings
        found, ambiguous = choose(fits, predicted, s.gate_sigma, np.radians(s.max_uncertainty_deg), anywhere)
        if found is None or not beyond_doubt(found, s):
            return None
        self._ambiguous = ambiguous
        return found

    def _keyframe(self, view: View) -> KeyFrame | None:
        """Make the frame a key frame if it shows the target turned far enough, and there is room for one."""
        assert self.filter is not None
        if self.settings.full(len(self.keyframes)):
            return None
        step = np.radians(self.settings.keyframe_angle_deg)
        T_target_sensor = inverse(self.filter.T_sensor_target)
        last = self.keyframes.frames[-1]
        turned = rotation_angle(T_target_sensor[:3, :3] @ last.T_target_sensor[:3, :3].T)
        if self.model is None:
            if turned <= step:
                return None
            self._path += turned
        elif self.keyframes.view_angles(T_target_sensor, self.filter.pivot).min() <= step:
            return None  # the model knows this side already
        return self._add_keyframe(view)

    def _add_keyframe(self, view: View) -> KeyFrame:
        assert self.filter is not None
        keyframe = KeyFrame(
            view.frame, inverse(self.filter.T_sensor_target), self._path, self.filter.pose_covariance
        )
        self.keyframes.add(keyframe, view)
        return keyframe

    def _report(
        self,
        motion: MotionFilter,
        view: View,
        keyframe: KeyFrame | None,
        fit: FrameFit | None,
        believed: bool = False,
    ) -> OdometryEstimate:
        return OdometryEstimate(
            stamp_ns=view.frame.stamp_ns,
            state=self.state,
            accepted=believed,
            T_sensor_target=motion.T_sensor_target,
            covariance=motion.pose_covariance,
            omega_target=motion.omega_target,
            omega_sigma=motion.omega_sigma,
            velocity=motion.velocity.copy(),
            agreement=fit.agreement if fit else Agreement(),
            observability=fit.observability if fit else None,
            keyframe=keyframe,
            ambiguous=believed and self._ambiguous,
            whole=view.whole,
            missing=fit.missing if fit else 0.0,
        )
