"""Odometry and tracking: one filter, registered to recent key frames, later to the model.

Scanning: every frame is registered to the last key frames inside the motion filter, and becomes a
key frame when the target has turned far enough. Tracking: the same against the model's surface.
A frame that does not agree is not believed; after several the target counts as lost and is searched
for around the prediction, then everywhere.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.frames import KeyFrame, TargetFrame
from debris_scanner.geometry import Array, apply, compose, inverse, log_so3, rotation_angle
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.model import Model
from debris_scanner.motion_filter import ATTITUDE, CENTRE, SIZE, MotionFilter, MotionSettings
from debris_scanner.observability import rotation_observability
from debris_scanner.parameters import parameter
from debris_scanner.reacquisition import find_pose, tracking_surface
from debris_scanner.registration import Agreement, Surface, View, linearise, linearise_pair
from debris_scanner.timing import StageTimer

SCANNING, TRACKING, LOST = 'scanning', 'tracking', 'lost'

GATES = (0.03, 0.02, 0.012, 0.012, 0.008, 0.008)  # m, shrinking over the iterations
SEARCH_GATES = (0.04, 0.03, 0.03, 0.02, 0.02, 0.012, 0.012, 0.008, 0.008)


@dataclass(frozen=True)
class OdometrySettings:
    """Key frames, references, and when a frame is believed."""

    keyframe_angle_deg: float = parameter(6.0, 'turn of the target between key frames', 'deg', 0.5, 45.0)
    recent_keyframes: int = parameter(4, 'key frames a frame is registered to', '', 1, 20)
    tracked_keyframes: int = parameter(
        2, 'key frames most alike that a frame is registered to beside the model', '', 0, 20
    )
    min_share: float = parameter(
        0.4, 'a search needs this share of the surface points that its key frames show', '', 0.0, 1.0
    )
    gate_sigma: float = parameter(
        4.0,
        'before there is a model, a search may find attitudes this far from the prediction',
        'sigma',
        0.1,
        100.0,
    )
    max_uncertainty_deg: float = parameter(
        30.0, 'and none at all once the prediction is this uncertain, 1 sigma', 'deg', 1.0, 180.0
    )
    search_period: float = parameter(
        0.5, 'while lost, time between searches of all attitudes', 's', 0.0, 60.0
    )
    reference_angle_deg: float = parameter(
        40.0, 'key frames seen from further away are no reference', 'deg', 5.0, 90.0
    )
    min_points: int = parameter(150, 'fewer sampled surface points are no frame', '', 20, 10**5)
    min_overlap: float = parameter(0.6, 'share of the points that must match', '', 0.0, 1.0)
    max_rms: float = parameter(0.0026, 'largest residual of the matched points', 'm', 1e-5, 0.1)
    max_free_space: float = parameter(0.10, 'largest share of points in seen free space', '', 0.0, 1.0)
    max_outside: float = parameter(0.25, 'largest share of points beside the silhouette', '', 0.0, 1.0)
    lost_after: int = parameter(3, 'disbelieved frames in a row until the target is lost', '', 1, 1000)
    max_gap: float = parameter(0.35, 'a longer gap is searched, not just predicted', 's', 0.01, 60.0)


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
    agreement: Agreement
    observability: float | None  # None where nothing was registered
    keyframe: KeyFrame | None = None  # set when this frame became one


@dataclass
class _Fit:
    filter: MotionFilter
    agreement: Agreement
    observability: float
    overlap: float

    @property
    def score(self) -> float:
        a = self.agreement
        return self.overlap - 2 * a.free_space - 0.5 * a.outside - 100 * max(0.0, a.rms - 0.0018)


Reference = tuple[Surface, Array]  # a view or the model, with its pose in the target frame


class Odometry:
    """Pose, rates and key frames of the target, frame by frame."""

    def __init__(
        self, settings: OdometrySettings, motion: MotionSettings, timer: StageTimer | None = None
    ) -> None:
        self.settings = settings
        self.motion = motion
        self.timer = timer or StageTimer()
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next frame is the first key frame of a new scan."""
        self.state = SCANNING
        self.keyframes = KeyFrameSet()
        self.filter: MotionFilter | None = None
        self.model: Model | None = None
        self._surface: Surface | None = None
        self._stamp_ns = 0
        self._searched_ns = 0
        self._disbelieved = 0
        self._path = 0.0

    def process(self, frame: TargetFrame) -> OdometryEstimate:
        """Filter one target frame; stamps must increase."""
        with self.timer.stage('view'):
            view = View(frame)
        if self.filter is None:
            return self._start(view)
        dt = (frame.stamp_ns - self._stamp_ns) * 1e-9
        predicted = self.filter.copy()
        predicted.predict(dt)
        with self.timer.stage('tracking' if self.model else 'registration'):
            fit, believed = self._estimate(predicted, view, dt)
        if not believed:
            self._disbelieved += 1
            if self._disbelieved >= self.settings.lost_after:
                self.state = LOST
            return self._report(predicted, frame, None, fit)
        assert fit is not None
        self._disbelieved = 0
        self._stamp_ns = frame.stamp_ns
        self.filter = fit.filter
        self.state = TRACKING if self.model else SCANNING
        return self._report(fit.filter, frame, self._keyframe(view), fit, believed=True)

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

    def _start(self, view: View) -> OdometryEstimate:
        behind = np.array([0.0, 0.0, self.motion.centre_depth])
        self.filter = MotionFilter(view.centroid + behind, self.motion)
        self._stamp_ns = view.frame.stamp_ns
        keyframe = self._add_keyframe(view)
        return self._report(self.filter, view.frame, keyframe, None, believed=True)

    def _estimate(self, predicted: MotionFilter, view: View, dt: float) -> tuple[_Fit | None, bool]:
        if len(view.points) < self.settings.min_points:
            return None, False
        fit = None
        if dt < self.settings.max_gap:
            references = self._references(predicted)
            if references:
                fit = self._fit(predicted, view, references, GATES)
                if self._believable(fit):
                    return fit, True
        found = self._search_nearby(predicted, view)
        overdue = (view.frame.stamp_ns - self._searched_ns) * 1e-9 >= self.settings.search_period
        if found is None and self._disbelieved + 1 >= self.settings.lost_after and overdue:
            self._searched_ns = view.frame.stamp_ns
            found = self._search_everywhere(predicted, view)
        return (found, True) if found is not None else (fit, False)

    def _references(self, motion: MotionFilter) -> list[Reference]:
        s = self.settings
        angles = self.keyframes.view_angles(inverse(motion.T_sensor_target), motion.pivot)
        alike = [int(k) for k in np.argsort(angles) if angles[k] < np.radians(s.reference_angle_deg)]
        if self._surface is not None:
            chosen = alike[: s.tracked_keyframes]  # they also know sides that the model lacks
        else:
            chosen = [k for k in alike if k >= len(self.keyframes) - s.recent_keyframes]
            chosen = chosen or alike[: s.recent_keyframes]  # seen again after a gap
        references: list[Reference] = [
            (self.keyframes.views[k], self.keyframes.frames[k].T_target_sensor) for k in chosen
        ]
        return references if self._surface is None else [*references, (self._surface, np.eye(4))]

    def _fit(
        self, prior: MotionFilter, view: View, references: list[Reference], gates: tuple[float, ...]
    ) -> _Fit:
        """Iterated filter update with the registration to all references as its measurement."""
        motion = prior.copy()
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
        return self._judge(motion, view, references, gates[-1])

    @staticmethod
    def _judge(motion: MotionFilter, view: View, references: list[Reference], gate: float) -> _Fit:
        T_target_view = inverse(motion.T_sensor_target)
        best: _Fit | None = None
        for surface, pose in references:
            if isinstance(surface, View):
                lin = linearise(view, T_target_view, surface, pose, gate)
                overlap = lin.agreement.overlap
            else:
                lin = linearise(surface, pose, view, T_target_view, gate)
                overlap = lin.agreement.explained
            if best is None or overlap > best.overlap:
                seen = rotation_observability(lin.H, lin.agreement.matched, view, T_target_view)
                best = _Fit(motion, lin.agreement, seen, overlap)
        assert best is not None
        return best

    def _believable(self, fit: _Fit, strict: bool = False) -> bool:
        a = fit.agreement
        if strict:  # found by search, so the prediction does not vouch for it
            return fit.overlap > 0.78 and a.rms < 0.0019 and a.free_space < 0.035 and a.outside < 0.06
        s = self.settings
        return (
            fit.overlap > s.min_overlap
            and a.rms < s.max_rms
            and a.free_space < s.max_free_space
            and a.outside < s.max_outside
        )

    def _search_nearby(self, predicted: MotionFilter, view: View) -> _Fit | None:
        """Several starts along the uncertain directions of the predicted attitude."""
        variance, axes = np.linalg.eigh(predicted.P[ATTITUDE, ATTITUDE])
        sigma = np.sqrt(np.maximum(variance, 0.0))
        starts = [np.zeros(3)]
        for k in range(3):
            for m in (-2, -1, 1, 2):
                if abs(m) * sigma[k] > np.radians(3):
                    starts.append(np.clip(m * sigma[k], -0.7, 0.7) * axes[:, k])
        return self._best_start(predicted, view, starts)

    def _search_everywhere(self, predicted: MotionFilter, view: View) -> _Fit | None:
        """Against the model from nothing."""
        if self._surface is None:
            return None
        starts = [log_so3(T[:3, :3] @ predicted.R.T) for T in find_pose(self._surface, view)]
        return self._best_start(predicted, view, starts)

    def _continues(self, found: _Fit, predicted: MotionFilter) -> bool:
        """Whether an attitude found by search is the predicted one, as far as that is known.

        Without a model only continuity tells a face from its like on the other side of the target.
        """
        P = predicted.P[ATTITUDE, ATTITUDE]
        turn = log_so3(found.filter.R @ predicted.R.T)
        informative = np.sqrt(np.linalg.eigvalsh(P)[-1]) < np.radians(self.settings.max_uncertainty_deg)
        return bool(informative and turn @ np.linalg.solve(P, turn) < self.settings.gate_sigma**2)

    def _best_start(self, predicted: MotionFilter, view: View, starts: list[Array]) -> _Fit | None:
        fits: list[_Fit] = []
        for turn in starts:
            motion = predicted.copy()
            motion.correct(np.concatenate([turn, np.zeros(SIZE - 3)]))
            references = self._references(motion)
            if not references or len(view.points) < self.settings.min_share * _points_shown(references):
                continue  # a sliver of the target fits anywhere
            shift = self._recentre(motion, view, references[-1])
            motion.correct(np.concatenate([np.zeros(3), shift, np.zeros(15)]))
            motion.P = motion.P + np.diag(np.repeat([0.1**2, 0.02**2, 0, 0, 0, 0, 0], 3))
            fits.append(self._fit(motion, view, references, SEARCH_GATES))
        if not fits:
            return None
        best = max(fits, key=lambda f: f.score)
        if not self._believable(best, strict=True):
            return None
        if self._surface is None and not self._continues(best, predicted):
            return None
        rivals = [f.score for f in fits if rotation_angle(f.filter.R @ best.filter.R.T) > np.radians(8)]
        return best if not rivals or best.score - max(rivals) > 0.06 else None

    @staticmethod
    def _recentre(motion: MotionFilter, view: View, reference: Reference) -> Array:
        """Shift (3,) that puts the reference's visible centroid onto the view's."""
        surface, pose = reference
        T_sensor_reference = motion.T_sensor_target @ pose
        points, normals = surface.points, surface.normals
        if not isinstance(surface, View):
            facing = normals @ T_sensor_reference[2, :3] < 0
            points = points[facing] if facing.any() else points
        return view.centroid - apply(T_sensor_reference, points.mean(axis=0).astype(np.float64))

    def _keyframe(self, view: View) -> KeyFrame | None:
        """Make the frame a key frame if it shows the target turned far enough."""
        assert self.filter is not None
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
        frame: TargetFrame,
        keyframe: KeyFrame | None,
        fit: _Fit | None,
        believed: bool = False,
    ) -> OdometryEstimate:
        return OdometryEstimate(
            stamp_ns=frame.stamp_ns,
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
        )


def _points_shown(references: list[Reference]) -> float:
    """How many surface points the key frames among the references show, on average."""
    counts = [len(surface.points) for surface, _ in references if isinstance(surface, View)]
    return float(np.mean(counts)) if counts else 0.0


def _measure(
    view: View, T_target_view: Array, surface: Surface, pose: Array, gate: float
) -> tuple[Array, Array]:
    """Normal equations for a twist of the view, against another view or the model."""
    if isinstance(surface, View):
        lin = linearise_pair(view, T_target_view, surface, pose, gate)
        return lin.H, lin.g
    lin = linearise(surface, pose, view, T_target_view, gate)
    return lin.H, -lin.g
