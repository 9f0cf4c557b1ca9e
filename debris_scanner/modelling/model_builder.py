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

"""From key frames and closures to a validated model: optimise, refine, fuse, validate."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from debris_scanner.core.frames import KeyFrame, KeyPose, Model, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse, log_so3, rotation_angle, transform
from debris_scanner.core.memory import release_memory
from debris_scanner.core.parameters import parameter
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_MATCH,
    NOT_RIGID,
    UNOBSERVABLE_ROTATION,
    Checks,
    at_least,
    in_words,
)
from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import rollback
from debris_scanner.mapping.closures import Closure
from debris_scanner.mapping.evidence import sensor_evidence
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.pose_graph import Optimised, PoseGraph, PoseGraphSettings
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.mapping.relaxation import smooth
from debris_scanner.modelling.closing import close
from debris_scanner.modelling.frame_store import (
    FrameStore,
    Restorer,
    StoredFrame,
    between,
    followed,
    reassign,
    spread,
    unbroken_ns,
)
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.placement import (
    Answer,
    KnownModel,
    MatchSettings,
    asked_again,
    find_model,
    usual_loss,
)
from debris_scanner.modelling.refinement import (
    integrated,
    interpolated,
    large_parts,
    make_model,
    pose_frames,
    refine_to_model,
    refined_poses,
)
from debris_scanner.modelling.rivals import best_explanation, least_stretch_loss
from debris_scanner.modelling.texture import textured
from debris_scanner.modelling.validation import (
    AFTER_GAP,
    PosedKeyFrames,
    Verdict,
    VerdictSettings,
    judge_poses,
    judge_scan,
)
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.sensor_model import SensorModel, typical_sensor
from debris_scanner.sensing.views import View
from debris_scanner.tracking.cadence import Cadence
from debris_scanner.tracking.motion_filter import MotionSettings

Progress = Callable[[str, int, int], None]  # what, done, of how many
SAME_FACE = np.radians(10.0)  # between views of the same face
A_TURN = 7.0  # rad of travelled rotation: then any closure will do
RETRY_GROWTH = 0.1  # new key frames, as a share, until a refused attempt is repeated
FIRST_MEASURED = 8  # key frames, when the sensor is first measured; then whenever they have doubled
SCANNED = 24  # frames of a scan without a closed loop that are compared
FEWEST_PLACED, MOST_PLACED = 3, 8  # key frames among which a known model is looked for
LOOK_GROWTH = 0.25  # new key frames, as a share, until it is looked for again
JUDGED = 12  # frames of a tracked scan that speak for the known model; half while it goes on
TRACKED_POSES = 60  # of which the motion of a tracked target is measured
MOST_ADDED = 120  # key frames made of tracked frames, at most: two turns of them


@dataclass(frozen=True)
class BuilderSettings:
    """When a model is generated, and how many frames may be kept for it."""

    kept_frames: int = parameter(1000, 'frames whose depth is kept for fusion', '', 10, 10**6)
    growth: float = parameter(
        0.25, 'new key frames, as a share, that call for a better model', '', 0.01, 10.0
    )


@dataclass(frozen=True)
class Generation:
    """Outcome of one attempt: a model with the poses it was made from, or the reason why not."""

    model: Model | None
    reason: str | None
    why: str
    poses: dict[int, Array]  # T_target_sensor of the key frames by stamp, model's target frame
    optimised: Optimised | None
    withdrawn: bool = False  # the known model that was tracked so far is given up
    checks: Checks = ()  # that decided
    offset: DepthOffset = NO_OFFSET  # of the sensor, that model and poses are free from


class ModelBuilder:
    """Last stage of the scanner; not thread-safe, one worker drives it."""

    def __init__(
        self,
        builder: BuilderSettings,
        graph: PoseGraphSettings,
        fusion: FusionSettings,
        verdict: VerdictSettings,
        normals: NormalSettings,
        motion: MotionSettings,
        accepted_loss: float,
        timer: StageTimer | None = None,
    ) -> None:
        self.settings = builder
        self.accepted_loss = accepted_loss  # nats a point, of a frame that odometry takes
        self.known: KnownModel | None = None  # is looked for, and none is built
        self.graph_settings = graph
        self.fusion, self.verdict = fusion, verdict
        self.normals, self.motion = normals, motion
        self.timer = timer or StageTimer()
        self.reset()

    def know(self, model: Model, searched: float) -> None:
        """Look for a model, and build none.

        Args:
            model: in its own frame.
            searched: it may explain views worse than neighbours do by so much, nats a point, to be found.
        """
        self.known = KnownModel(model)
        self._match = MatchSettings(searched, self.verdict.min_turning_loss)

    def reset(self) -> None:
        """Forget the scan."""
        self.graph = PoseGraph(self.graph_settings, self.normals, self.motion.information_scale)
        self.store = FrameStore(self.settings.kept_frames)
        self.T_model_scan: Array | None = None  # set by the first model
        self.answer = Answer('', '')  # of the latest match with the known model
        self.last: Generation | None = None
        self.sensor: SensorModel | None = None  # as measured so far
        self.attitude_noise: float | None = None  # rad, of a frame's registration about each axis
        self._measured_with = FIRST_MEASURED // 2  # key frames
        self._pending = False  # a closure has come since the last attempt
        self._same_face = False  # one of the closures shows the same face again
        self._generated_with = 0  # key frames
        self._cadence = Cadence()
        self._followed_ns = 0  # stamp of the latest frame that moves with the last key frame
        self.lost = 0  # frames that showed a target and were not registered
        self._asked_with = 0  # frames, when it was last asked whether the known model is the right one
        self.withdrawn_ns = -1  # up to this stamp a known model was tracked wrongly

    @property
    def keyframes(self) -> list[KeyPose]:
        """Poses of the key frames so far, in order of time."""
        return self.graph.keyframes.frames

    @property
    def active(self) -> list[KeyPose]:
        """Those whose poses can be compared with the newest one's."""
        return [self.keyframes[k] for k in self.graph.keyframes.active]

    def add_frame(self, frame: TargetFrame, T_target_sensor: Array, tracked: bool) -> None:
        """Add an accepted frame; ``tracked`` poses are in the model's target frame, others in the scan's.

        It moves with the previous key frame. A tracked frame does so only if the target was tracked all the
        time since: then both have the same error after a relocalisation.
        """
        if self._is_withdrawn(tracked):
            return
        reference = self.keyframes[-1] if self.keyframes else None
        self._cadence.add(frame.stamp_ns)
        if reference is not None and tracked:
            last_ns = max(self._followed_ns, reference.stamp_ns)
            if frame.stamp_ns - last_ns > unbroken_ns(self._cadence):
                reference = None
        if reference is None:
            self.store.add(frame, None, T_target_sensor)
            return
        self._followed_ns = frame.stamp_ns
        T = T_target_sensor
        if not tracked and self.T_model_scan is not None:  # computed before the model existed
            T = compose(self.T_model_scan, T)
        self.store.add(frame, reference.stamp_ns, compose(inverse(reference.T_target_sensor), T))

    def add_keyframe(self, keyframe: KeyFrame, tracked: bool) -> None:
        """Add a key frame, before its frame is added."""
        if self._is_withdrawn(tracked):
            return
        if not tracked and self.T_model_scan is not None:  # computed before the model existed
            T = compose(self.T_model_scan, keyframe.T_target_sensor)
            keyframe = dataclasses.replace(keyframe, T_target_sensor=T)
        self.graph.add_keyframe(keyframe)
        if len(self.keyframes) >= 2 * self._measured_with:
            self._measured_with = len(self.keyframes)
            self.measure_sensor()

    def measure_sensor(self) -> SensorModel | None:
        """Measure the sensor on all key frames; None while they tell nothing."""
        self.sensor = sensor_evidence(self.graph.keyframes) or self.sensor
        offset = self.graph.keyframes.views.offset
        if self.sensor is not None and offset.rms > 0:
            focal = self.sensor.range_m / self.sensor.footprint_m
            self.sensor = dataclasses.replace(
                self.sensor, offset_m=offset.rms * self.sensor.range_m, offset_px=offset.length * focal
            )
        return self.sensor

    def add_closure(self, closure: Closure) -> None:
        """Add an accepted closure."""
        if min(closure.from_stamp_ns, closure.to_stamp_ns) <= self.withdrawn_ns:
            return
        self.graph.add_closure(closure)
        self._pending = True
        assert closure.T_from_to is not None
        self._same_face |= rotation_angle(closure.T_from_to[:3, :3]) <= SAME_FACE

    def withdraw(self, stamp_ns: int) -> None:
        """Up to a stamp the known model was tracked wrongly: look for it in what comes after that alone."""
        self.T_model_scan, self.withdrawn_ns = None, stamp_ns
        self._generated_with = self._asked_with = 0
        self.store = FrameStore(self.settings.kept_frames)

    def _is_withdrawn(self, tracked: bool) -> bool:
        """Whether a frame was tracked by a model that has been given up since."""
        return tracked and self.known is not None and self.T_model_scan is None

    @property
    def _placed_by(self) -> list[int]:
        """Key frames, by index, among which the known model is looked for."""
        return [k for k in self.graph.keyframes.active if self.keyframes[k].stamp_ns > self.withdrawn_ns]

    def comparable(self, with_model: bool) -> tuple[list[KeyPose], list[StoredFrame]]:
        """Key frames and frames of one submap: the model's, or without a model the largest."""
        counts = Counter(k.submap for k in self.keyframes)
        if not counts:
            return [], list(self.store.frames)
        chosen = self.keyframes[-1].submap if with_model else counts.most_common(1)[0][0]
        keyframes = [k for k in self.keyframes if k.submap == chosen]
        stamps = {k.stamp_ns for k in keyframes if k.usable_for_mapping or not with_model}
        return keyframes, [f for f in self.store.frames if f.keyframe_ns is None or f.keyframe_ns in stamps]

    @property
    def should_rebuild(self) -> bool:
        """Whether an attempt is worthwhile now: a first closed loop, or enough new key frames."""
        if self.known is not None and self.T_model_scan is not None:
            return len(self.store.frames) >= 2 * max(self._asked_with, JUDGED)
        if self.known is not None:
            wanted = max(FEWEST_PLACED, self._generated_with + 1, self._generated_with * (1 + LOOK_GROWTH))
            return len(self._placed_by) >= wanted
        growth = self.settings.growth if self.T_model_scan is not None else RETRY_GROWTH
        if len(self.keyframes) < self._generated_with * (1 + growth):
            return False
        if self.T_model_scan is not None:
            return True
        if not self._pending:
            return False
        # a face seen from aside closes a loop before all sides have been seen, above all in a tumble
        travelled = self.keyframes[-1].path_rad - self.keyframes[0].path_rad
        return self._same_face or travelled > A_TURN

    def generate(self, final: bool = False, progress: Progress | None = None) -> Generation:
        """One attempt at a model from everything so far.

        Args:
            final: refine every stored frame and fuse those, instead of the key frames alone.
            progress: called during the long steps.
        """
        self._pending = False
        self._generated_with = len(self.keyframes if self.known is None else self._placed_by)
        progress = progress or (lambda *_: None)
        with self.timer.stage('generation'):
            if self.known is not None:
                generation = self._prepared(self._tracked, final, progress)
            elif final and self.T_model_scan is not None:
                generation = self._attempt_with_tracked(progress)
            else:
                generation = self._prepared(self._attempt, final, progress)
        release_memory()
        # during the scan a refused attempt leaves the model as it is; at its end it is the verdict
        refused = generation.model is None and not generation.withdrawn
        if final or not refused or self.last is None or self.last.model is None:
            self.last = generation
        return generation

    def checkpoint(self) -> Callable[[], None]:
        """What puts back the state before an attempt, but that there was one: the next waits for more."""
        views, offset = self.graph.keyframes.views, self.graph.keyframes.views.offset
        put_back = rollback(self, self.graph, self.store, *self.keyframes, *self.store.frames)

        def restore() -> None:
            tried = self._pending, self._generated_with
            put_back()
            self._pending, self._generated_with = tried
            views.offset = offset

        return restore

    def rest(self) -> None:
        """Free what is needed while a model is made, and only then."""
        self.graph.keyframes.views.rest()
        release_memory()

    def _attempt(self, final: bool, progress: Progress) -> Generation:
        with self.timer.stage('relaxation'):
            optimised = self._optimised(final)
        if optimised is None:
            verdict = judge_scan(len(self.store.frames), self._scanned(), self.verdict, self.lost)
            return Generation(None, verdict.reason, verdict.why, {}, None, checks=verdict.checks)
        with self.timer.stage('verdict'):
            verdict = self._judge(optimised, final)
        if verdict.unplaced_ns and self.graph.part(verdict.unplaced_ns):
            return self._attempt(final, progress)  # the others may make a model
        if verdict.reason is not None:
            # closures that made a model are kept: without them no model would come again
            self.graph.refuse(optimised, modelled=self.T_model_scan is not None)
            return Generation(None, verdict.reason, verdict.why, {}, optimised, checks=verdict.checks)
        restore, before = self.checkpoint(), self.keyframes[-1].T_target_sensor
        for keyframe in self.active:
            keyframe.T_target_sensor = optimised.poses[keyframe.stamp_ns]
        self.note_slips(optimised.torn)
        with self.timer.stage('refinement'):
            posed = self._refined_frames(progress) if final else self.graph.keyframes.posed
        with self.timer.stage('fusion'):
            volume = integrated(posed, self.fusion)
            surface = large_parts(volume.surface())
        if surface is None:
            restore()
            return Generation(None, INCONSISTENT_MODEL, 'the fused frames leave no surface', {}, optimised)
        closed = None
        if final:
            with self.timer.stage('closing'):
                closed = close(volume, posed)
            if closed is not None and self.graph.keyframes.has_colour:
                with self.timer.stage('texture'):
                    closed = textured(closed, self.graph.keyframes.posed)
        # the first model sets the origin; it stays while tracked, and is centred again at the end
        origin = None if final or self.T_model_scan is None else np.zeros(3)
        model, shift = make_model(surface, self.graph.keyframes.coloured(), origin, closed)
        self._shift_origin(shift)
        if self.T_model_scan is None:
            self.T_model_scan = compose(self.keyframes[-1].T_target_sensor, inverse(before))
        self.graph.prove_closures()
        poses = {k.stamp_ns: k.T_target_sensor.copy() for k in self.active}
        offset = self.graph.keyframes.views.offset
        return Generation(model, None, verdict.why, poses, optimised, checks=verdict.checks, offset=offset)

    def note_slips(self, stamps_ns: Collection[int]) -> None:
        """Tracking slipped before these key frames: forget the frames since the ones before them."""
        for before, keyframe in pairwise(self.active):
            if keyframe.stamp_ns in stamps_ns:
                keyframe.slipped = True
                self.store.forget_between(before.stamp_ns, keyframe.stamp_ns)

    def _prepared(
        self, attempt: Callable[[bool, Progress], Generation], final: bool, progress: Progress
    ) -> Generation:
        with self.graph.keyframes.views.all_prepared():
            return attempt(final, progress)

    def _attempt_with_tracked(self, progress: Progress) -> Generation:
        """The last attempt, with key frames made of tracked frames, as dense as the scan's own.

        A tracked target gets key frames of new sides alone, far apart in time: no motion ties these to the
        rest, and nobody judges what was tracked between them. If what was tracked contradicts the rest, it is
        left out, unless the target has changed.
        """
        poses = {k.stamp_ns: k.T_target_sensor for k in self.active}
        chosen = between(self.store.frames, self.active, MOST_ADDED)
        own, last = self.graph.keyframes, self.keyframes[-1]
        more = [
            KeyFrame(f.restore(self.normals), f.pose(poses), last.path_rad, submap=last.submap)
            for f, _ in chosen
        ]
        self.graph.use(own.interleaved(more, [linked for _, linked in chosen]))
        reassign(self.store.frames, self.active)
        generation = self._prepared(self._attempt, True, progress)
        if generation.model is None and more and generation.reason != NOT_RIGID:
            self.graph.use(own)  # frames that move with an added key frame have no pose now
            without = self._prepared(self._attempt, True, progress)
            if without.model is not None:
                why = f'{without.why}; what was tracked is left out: {generation.why}'
                generation = dataclasses.replace(without, why=why)
        return generation

    def _tracked(self, final: bool, progress: Progress) -> Generation:
        """The known model, where it lies among the key frames; then whether all frames speak for it."""
        known = self.known
        assert known is not None
        found = self.T_model_scan is not None
        if not found and (refused := self._place(known)):
            return Generation(None, NO_MATCH, refused, {}, None, checks=self.answer.checks)
        if found and not final:
            with self.timer.stage('refinement'):
                self._refine_keyframes(known)
        poses = {k.stamp_ns: k.T_target_sensor.copy() for k in self.active}
        # frames of an earlier submap have no pose in the model's frame
        stored = [f for f in self.store.with_depth if f.keyframe_ns is None or f.keyframe_ns in poses]
        if not final:
            self._asked_with = len(self.store.frames)
            if found and len(stored) > JUDGED and (refused := self._contradicts(known, stored, final)):
                self.withdraw(self.keyframes[-1].stamp_ns)
                return Generation(None, NO_MATCH, refused, {}, None, True, self.answer.checks)
            return Generation(known.model, None, self.answer.why, poses, None, checks=self.answer.checks)
        if len(stored) < FEWEST_PLACED:
            self.answer = self.answer.too_few('frames', len(stored), FEWEST_PLACED)
            refused = self.answer.refused
        else:
            with self.timer.stage('refinement'):
                self._refine_tracked(known, stored, progress)
            with self.timer.stage('verdict'):
                refused = self._contradicts(known, stored, final)
        if refused:
            return Generation(None, NO_MATCH, refused, {}, None, checks=self.answer.checks)
        return Generation(known.model, None, self.answer.why, poses, None, checks=self.answer.checks)

    def _place(self, known: KnownModel) -> str:
        """Look for a known model among some key frames of this submap, and move all there; or say why not."""
        active = self._placed_by
        if len(active) < FEWEST_PLACED:
            self.answer = self.answer.too_few('keyframes', len(active), FEWEST_PLACED)
            return self.answer.refused
        views, frames = self.graph.keyframes.views, self.keyframes
        recent = active[-MOST_PLACED:]
        usual = usual_loss([views[k] for k in recent], [frames[k].T_target_sensor for k in recent])
        chosen = [active[n] for n in spread(len(active), MOST_PLACED)]
        posed = [frames[k].T_target_sensor for k in chosen]
        found = find_model(known, [views[k] for k in chosen], posed, usual, self._match)
        self.answer = Answer(found.why, '', found.checks, found.disagreed)
        if found.T_model_scan is None:
            return found.why
        for keyframe in self.active:
            keyframe.T_target_sensor = compose(found.T_model_scan, keyframe.T_target_sensor)
        self.T_model_scan = found.T_model_scan
        return ''

    def _refine_keyframes(self, known: KnownModel) -> None:
        """Register the key frames to the known model, and make the motion smooth: frames lean on them."""
        members = self.graph.keyframes.active
        registered = [
            refine_to_model(self.graph.keyframes.views[k], self.keyframes[k].T_target_sensor, known.surface)
            for k in members
        ]
        found = [T for T, _ in registered]
        smoothed = smooth(found, [H for _, H in registered], self.graph.motion_prior(found, members))
        for k, T in zip(members, smoothed, strict=True):
            self.keyframes[k].T_target_sensor = T

    def _refine_tracked(self, known: KnownModel, stored: Sequence[StoredFrame], progress: Progress) -> None:
        """Register frames to the known model, and make the motion smooth."""
        poses = {k.stamp_ns: k.T_target_sensor for k in self.active}
        found, information, resolutions = [], [], []
        for n, item in enumerate(stored):
            view = View(item.restore(self.normals))
            T, H = refine_to_model(view, item.pose(poses), known.surface)
            found.append(T)
            information.append(H)
            resolutions.append(view.resolution)
            progress('refine', n + 1, len(stored))
        stamps = [f.stamp_ns for f in stored]
        some = spread(len(stored), TRACKED_POSES)
        linked = followed(stored, [stamps[n] for n in some])[1:]
        points = known.model.points
        motion = MotionPrior(
            [stamps[n] for n in some],
            linked,
            [found[n] for n in some],
            points.mean(axis=0).astype(np.float64),
            float(np.ptp(points, axis=0).max()),
            float(np.median(resolutions)) ** 2 / self.motion.information_scale,
        )
        smoothed = smooth(found, information, motion.resampled(stamps, found))
        self._note_noise(motion, found, smoothed)
        for item, T in zip(stored, smoothed, strict=True):
            item.keyframe_ns, item.T = None, T

    def _contradicts(self, known: KnownModel, stored: Sequence[StoredFrame], final: bool) -> str:
        """Why some frames do not show the known model, or show it elsewhere; empty if they do."""
        poses = {k.stamp_ns: k.T_target_sensor for k in self.active}
        pairs = [
            [(View(f.restore(self.normals)), f.pose(poses)) for f in stored[n : n + 2]]
            for n in spread(len(stored) - 1, JUDGED if final else JUDGED // 2)
        ]
        sensor, disagreed = self._sensor if final else None, self.answer.disagreed
        self.answer = asked_again(known, pairs, self.accepted_loss, disagreed, sensor)
        return self.answer.refused

    def tracked_frames(self, most: int) -> Sequence[tuple[TargetFrame, Array]]:
        """Some frames of a finished scan with a known model, with T_model_sensor (4, 4)."""
        stored = [f for f in self.store.with_depth if f.keyframe_ns is None]
        return Restorer(self.normals).posed([stored[n] for n in spread(len(stored), most)])

    def _optimised(self, final: bool) -> Optimised | None:
        """The relaxed key frames, or a rival of them that explains the views better."""
        in_place = self.T_model_scan is not None
        optimised = self.graph.optimise(in_place, final)
        if optimised is None:
            return None
        views = [self.graph.keyframes.views[k] for k in self.graph.keyframes.active]
        gaps = [k for k, seen in enumerate(followed(self.store.frames, optimised.stamps)) if not seen]
        sensor, bounds = self._sensor(views), (self.accepted_loss, self.verdict)
        with self.timer.stage('rivals'):
            return best_explanation(optimised, self.graph, sensor, gaps, *bounds, in_place)

    def _sensor(self, views: Sequence[View]) -> SensorModel:
        """The sensor as the key frames show it, or as it is assumed to be for these views."""
        return self.measure_sensor() or typical_sensor(views)

    def _judge(self, optimised: Optimised, final: bool) -> Verdict:
        """The verdict on the optimised key frames; those that contradict the others leave the model."""
        keyframes = self.graph.keyframes
        used = [k for k in keyframes.active if keyframes.frames[k].usable_for_mapping]
        frames = [keyframes.frames[k] for k in used]
        piece = [optimised.piece.get(f.stamp_ns, 0) for f in frames]
        joined = [f.original_submap if f.original_submap != f.submap else -1 for f in frames]
        moved = np.column_stack([piece, joined])  # what lies where it was tracked has the least numbers
        found = PosedKeyFrames(
            views=[keyframes.views[k] for k in used],
            poses=[optimised.poses[f.stamp_ns] for f in frames],
            before=[f.T_target_sensor for f in frames],
            # left out are those between which the target was lost, partially occluded, or slipped
            linked=[
                f.linked and not f.slipped and k - 1 in used and here == before
                for k, f, here, before in zip(used, frames, piece, [-1, *piece], strict=False)
            ],
            followed=followed(self.store.frames, [f.stamp_ns for f in frames]),
            placed=np.unique(moved, axis=0, return_inverse=True)[1].tolist(),
        )
        verdict = judge_poses(found, self._sensor(found.views), self.verdict, final)
        if verdict.reason is None and verdict.value('turning_loss') < self.accepted_loss:
            verdict = self._stretched(optimised, verdict)
        for n in verdict.dropped:
            keyframes.frames[used[n]].usable_for_mapping = False
        return verdict

    def _stretched(self, optimised: Optimised, verdict: Verdict) -> Verdict:
        """The verdict, asked once more where frames may slip: might the target have turned more, or less?"""
        sensor = self._sensor([self.graph.keyframes.views[k] for k in self.graph.keyframes.active])
        loss = least_stretch_loss(optimised, self.graph, sensor, self.T_model_scan is not None)
        if np.isinf(loss):
            return verdict
        checks = (*verdict.checks, at_least('stretch_loss', loss, AFTER_GAP * self.verdict.min_turning_loss))
        if checks[-1].passed:
            return dataclasses.replace(verdict, checks=checks)
        note = 'had it turned a tenth more or less in all, the target would look the same'
        return Verdict(UNOBSERVABLE_ROTATION, in_words(checks, note), checks)

    def _scanned(self) -> PosedViews | None:
        """Some frames of a scan without a closed loop, as posed by odometry; None if there are none."""
        keyframes, frames = self.comparable(with_model=False)
        poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
        stored = [f for f in frames if f.depth is not None]
        chosen = np.unique(np.linspace(0, len(stored) - 1, min(len(stored), SCANNED)).astype(int))
        sample = [stored[int(n)] for n in chosen]
        if not sample:
            return None
        views = [View(f.restore(self.normals)) for f in sample]
        return PosedViews(views, [f.pose(poses) for f in sample], self._sensor(views))

    def _refined_frames(self, progress: Progress) -> Sequence[tuple[TargetFrame, Array]]:
        """Frames for the final fusion: every stored frame registered to its key frames, the motion smooth."""
        keyframes = self.graph.keyframes
        restore = Restorer(self.normals, keyframes.views.offset)
        poses = {k.stamp_ns: k.T_target_sensor for k in self.active}
        usable = {k.stamp_ns: k.T_target_sensor for k in self.active if k.usable_for_mapping}
        stored = [f for f in self.store.with_depth if f.keyframe_ns is None or f.keyframe_ns in usable]

        def view_of(item: StoredFrame) -> View:
            k = keyframes.index.get(item.stamp_ns)
            return View(restore(item)) if k is None else keyframes.views[k]

        sensor = self.sensor or typical_sensor([keyframes.views[keyframes.active[0]]])  # as the verdict did
        starts = interpolated(stored, self.active, keyframes.centre)
        registered = refined_poses(stored, starts, view_of, keyframes, sensor, progress)
        motion = self.graph.motion_prior([poses[k.stamp_ns] for k in self.active], keyframes.active)
        stamps = [f.stamp_ns for f in stored]
        found = [poses.get(stamp, T) for stamp, (T, _) in zip(stamps, registered, strict=True)]
        smoothed = smooth(found, [H for _, H in registered], motion.resampled(stamps, found))
        self._note_noise(motion, found, smoothed)
        pose_frames(self.store.frames, dict(zip(stamps, smoothed, strict=True)) | usable)
        chosen = np.linspace(0, len(stored) - 1, min(len(stored), self.fusion.max_frames)).astype(int)
        return restore.posed([stored[n] for n in dict.fromkeys(chosen.tolist())])

    def _note_noise(self, motion: MotionPrior, found: Sequence[Array], smoothed: Sequence[Array]) -> None:
        """How far smoothing moved the attitudes; without a measured motion nothing is known of it."""
        apart = [log_so3(T[:3, :3].T @ S[:3, :3]) for T, S in zip(found, smoothed, strict=True)]
        measured = np.isfinite(motion.angular_sigma)
        self.attitude_noise = float(np.sqrt(np.mean(np.square(apart)))) if measured else None

    def _shift_origin(self, shift: Array) -> None:
        """Move the target frame's origin to ``shift`` (3,)."""
        T_new_old = transform(np.eye(3), -shift)
        self.graph.keyframes.move({}, T_new_old)
        for stored in self.store.frames:
            if stored.keyframe_ns is None:
                stored.T = compose(T_new_old, stored.T)
