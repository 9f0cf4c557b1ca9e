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

"""A model of what was scanned: key frames relaxed, judged, and fused."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NOT_RIGID,
    UNOBSERVABLE_ROTATION,
    at_least,
    in_words,
)
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.optimiser import Optimised
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.mapping.relaxation import smooth
from debris_scanner.modelling.climbing import moved_far
from debris_scanner.modelling.closing import close
from debris_scanner.modelling.frame_store import Restorer, StoredFrame, between, followed, reassign
from debris_scanner.modelling.generation import Generation, ModelSettings, Progress
from debris_scanner.modelling.refinement import (
    integrated,
    interpolated,
    large_parts,
    make_model,
    pose_frames,
    refined_poses,
)
from debris_scanner.modelling.rivals import (
    best_explanation,
    climb,
    least_stretch_loss,
    slid_back,
)
from debris_scanner.modelling.scan_map import ScanMap
from debris_scanner.modelling.texture import textured
from debris_scanner.modelling.validation import AFTER_GAP, PosedKeyFrames, Verdict, judge_poses, judge_scan
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import View

A_TURN = 7.0  # rad of travelled rotation: then any closure will do
RETRY_GROWTH = 0.1  # new key frames, as a share, until a refused attempt is repeated
SCANNED = 24  # frames of a scan without a closed loop that are compared
MOST_ADDED = 120  # key frames made of tracked frames, at most: two turns of them


class BuildModel:
    """Makes the model of a scan whose loop has closed.

    Args:
        scan: its map.
        settings: of the attempts.
        timer: of the steps.
    """

    def __init__(self, scan: ScanMap, settings: ModelSettings, timer: StageTimer) -> None:
        self.scan, self.settings, self.timer = scan, settings, timer

    @property
    def size(self) -> int:
        """Key frames that an attempt now would have."""
        return len(self.scan.keyframes)

    @property
    def due(self) -> bool:
        """Whether an attempt is worthwhile now: a first closed loop, or enough new key frames."""
        growth = self.settings.builder.growth if self.scan.T_model_scan is not None else RETRY_GROWTH
        if len(self.scan.keyframes) < self.scan.generated_with * (1 + growth):
            return False
        if self.scan.T_model_scan is not None:
            return True
        if not self.scan.pending:
            return False
        # a face seen from aside closes a loop before all sides have been seen, above all in a tumble
        travelled = self.scan.keyframes[-1].path_rad - self.scan.keyframes[0].path_rad
        return self.scan.same_face or travelled > A_TURN

    def attempt(self, final: bool, progress: Progress) -> Generation:
        """One attempt; at the end with key frames made of tracked frames, too."""
        if final and self.scan.T_model_scan is not None:
            return self._attempt_with_tracked(progress)
        return self._prepared(final, progress)

    def _prepared(self, final: bool, progress: Progress) -> Generation:
        with self.scan.views.all_prepared():
            return self._attempt(final, progress)

    def _attempt(self, final: bool, progress: Progress) -> Generation:
        with self.timer.stage('relaxation'):
            optimised = self._optimised(final)
        if optimised is None:
            frames, lost = len(self.scan.store.frames), self.scan.lost
            verdict = judge_scan(frames, self._scanned(), self.settings.verdict, lost)
            if verdict.reason == UNOBSERVABLE_ROTATION and self.scan.graph.keyframes.has_colour:
                verdict = judge_scan(frames, self._scanned(pictured=True), self.settings.verdict, lost)
            return Generation(None, verdict.reason, verdict.why, {}, None, checks=verdict.checks)
        with self.timer.stage('verdict'):
            optimised, verdict = self._judge(optimised, final)
        if verdict.unplaced_ns and self.scan.graph.part(verdict.unplaced_ns):
            return self._attempt(final, progress)  # the others may make a model
        if verdict.reason is not None:
            # closures that made a model are kept: without them no model would come again
            self.scan.graph.refuse(optimised, modelled=self.scan.T_model_scan is not None)
            return Generation(None, verdict.reason, verdict.why, {}, optimised, checks=verdict.checks)
        restore, before = self.scan.checkpoint(), self.scan.keyframes[-1].T_target_sensor
        for keyframe in self.scan.active:
            keyframe.T_target_sensor = optimised.poses[keyframe.stamp_ns]
        self.scan.note_slips(optimised.torn)
        with self.timer.stage('refinement'):
            posed = self._refined_frames(progress) if final else self.scan.graph.keyframes.posed
        with self.timer.stage('fusion'):
            volume = integrated(posed, self.settings.fusion)
            surface = large_parts(volume.surface())
        if surface is None:
            restore()
            return Generation(None, INCONSISTENT_MODEL, 'the fused frames leave no surface', {}, optimised)
        closed = None
        if final:
            with self.timer.stage('closing'):
                closed = close(volume, posed)
            if closed is not None and self.scan.graph.keyframes.has_colour:
                with self.timer.stage('texture'):
                    closed = textured(closed, self.scan.graph.keyframes.posed)
        # the first model sets the origin; it stays while tracked, and is centred again at the end
        origin = None if final or self.scan.T_model_scan is None else np.zeros(3)
        model, shift = make_model(surface, self.scan.graph.keyframes.coloured(), origin, closed)
        self.scan.shift_origin(shift)
        if self.scan.T_model_scan is None:
            self.scan.T_model_scan = compose(self.scan.keyframes[-1].T_target_sensor, inverse(before))
        self.scan.graph.prove_closures()
        poses = {k.stamp_ns: k.T_target_sensor.copy() for k in self.scan.active}
        offset = self.scan.views.offset
        return Generation(model, None, verdict.why, poses, optimised, checks=verdict.checks, offset=offset)

    def _attempt_with_tracked(self, progress: Progress) -> Generation:
        """The last attempt, with key frames made of tracked frames, as dense as the scan's own.

        A tracked target gets key frames of new sides alone, far apart in time: no motion ties these to the
        rest, and nobody judges what was tracked between them. If what was tracked contradicts the rest, it is
        left out, unless the target has changed.
        """
        poses = {k.stamp_ns: k.T_target_sensor for k in self.scan.active}
        chosen = between(self.scan.store.frames, self.scan.active, MOST_ADDED)
        own, last = self.scan.graph.keyframes, self.scan.keyframes[-1]
        more = [
            KeyFrame(f.restore(self.settings.normals), f.pose(poses), last.path_rad, submap=last.submap)
            for f, _ in chosen
        ]
        self.scan.graph.use(own.interleaved(more, [linked for _, linked in chosen]))
        reassign(self.scan.store.frames, self.scan.active)
        generation = self._prepared(True, progress)
        if generation.model is None and more and generation.reason != NOT_RIGID:
            self.scan.graph.use(own)  # frames that move with an added key frame have no pose now
            without = self._prepared(True, progress)
            if without.model is not None:
                why = f'{without.why}; what was tracked is left out: {generation.why}'
                generation = dataclasses.replace(without, why=why)
        return generation

    def _optimised(self, final: bool) -> Optimised | None:
        """The relaxed key frames, or a rival of them that explains the views better."""
        in_place = self.scan.T_model_scan is not None
        optimised = self.scan.graph.optimise(in_place, final)
        if optimised is None:
            return None
        views = [self.scan.views[k] for k in self.scan.members]
        gaps = [k for k, seen in enumerate(followed(self.scan.store.frames, optimised.stamps)) if not seen]
        sensor, bounds = self.scan.sensor_for(views), (self.settings.accepted_loss, self.settings.verdict)
        with self.timer.stage('rivals'):
            return best_explanation(optimised, self.scan.graph, sensor, gaps, *bounds, in_place)

    def _judge(self, optimised: Optimised, final: bool) -> tuple[Optimised, Verdict]:
        """The verdict on the optimised key frames; those that contradict the others leave the model.

        Those of a nearly round target are returned, and judged, where they agree best.
        """
        in_place, accepted_loss = self.scan.T_model_scan is not None, self.settings.accepted_loss
        graph, sensor = self.scan.graph, self.scan.sensor_for([self.scan.views[k] for k in self.scan.members])
        best, (verdict, used) = optimised, self._verdict(optimised, final)
        while verdict.slid is not None:
            slid, move = verdict.slid
            stamps = {graph.keyframes.frames[used[n]].stamp_ns for n in slid}
            if (found := slid_back(best, graph, sensor, stamps, move, in_place)) is None:
                break
            best, (verdict, used) = found, self._verdict(found, final)
        # where a turn costs all views next to nothing, none of them says where the others lie
        least_loss = AFTER_GAP * self.settings.verdict.min_turning_loss
        if least_loss <= verdict.value('turning_loss') < accepted_loss:
            climbed = climb(best, graph, sensor, accepted_loss, in_place)
            if climbed is not best:
                best, (verdict, used) = climbed, self._verdict(climbed, final)
        nearly_round = verdict.value('turning_loss') < accepted_loss
        if verdict.reason is None:
            # led elsewhere, and as nearly round there, too: the place depends on where the scan began
            led_elsewhere = nearly_round and moved_far(optimised.relaxed.poses, best.relaxed.poses)
            loss = 0.0
            if not led_elsewhere:
                loss = least_stretch_loss(best, graph, sensor, accepted_loss, in_place)
            verdict = self._stretched(verdict, loss)
        for n in verdict.dropped:
            self.scan.graph.keyframes.frames[used[n]].usable_for_mapping = False
        return best, verdict

    def _verdict(self, optimised: Optimised, final: bool) -> tuple[Verdict, list[int]]:
        """The verdict on the usable ones of the optimised key frames, and their indices."""
        keyframes = self.scan.graph.keyframes
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
            followed=followed(self.scan.store.frames, [f.stamp_ns for f in frames]),
            placed=np.unique(moved, axis=0, return_inverse=True)[1].tolist(),
        )
        return judge_poses(found, self.scan.sensor_for(found.views), self.settings.verdict, final), used

    def _stretched(self, verdict: Verdict, loss: float) -> Verdict:
        """The verdict, asked once more where frames may slip: might the target have turned more, or less?"""
        if np.isinf(loss):
            return verdict
        least = AFTER_GAP * self.settings.verdict.min_turning_loss
        checks = (*verdict.checks, at_least('stretch_loss', loss, least))
        if checks[-1].passed:
            return dataclasses.replace(verdict, checks=checks)
        note = 'had it turned a tenth more or less in all, the target would look the same'
        return Verdict(UNOBSERVABLE_ROTATION, in_words(checks, note), checks)

    def _scanned(self, pictured: bool = False) -> PosedViews | None:
        """Some frames of a scan without a closed loop, as posed by odometry; None if there are none.

        Args:
            pictured: key frames alone, which keep their pictures.
        """
        keyframes, frames = self.scan.comparable(with_model=False)
        poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
        stored = [f for f in frames if f.depth is not None]
        prepared = self.scan.graph.keyframes
        if pictured:
            stored = [f for f in frames if f.stamp_ns in prepared.index]
        chosen = np.unique(np.linspace(0, len(stored) - 1, min(len(stored), SCANNED)).astype(int))
        sample = [stored[int(n)] for n in chosen]
        if not sample:
            return None
        views = [
            prepared.views[prepared.index[f.stamp_ns]] if pictured else View(f.restore(self.settings.normals))
            for f in sample
        ]
        return PosedViews(views, [f.pose(poses) for f in sample], self.scan.sensor_for(views))

    def _refined_frames(self, progress: Progress) -> Sequence[tuple[TargetFrame, Array]]:
        """Frames for the final fusion: every stored frame registered to its key frames, the motion smooth."""
        keyframes = self.scan.graph.keyframes
        restore = Restorer(self.settings.normals, keyframes.views.offset)
        poses = {k.stamp_ns: k.T_target_sensor for k in self.scan.active}
        usable = {k.stamp_ns: k.T_target_sensor for k in self.scan.active if k.usable_for_mapping}
        stored = [f for f in self.scan.store.with_depth if f.keyframe_ns is None or f.keyframe_ns in usable]

        def view_of(item: StoredFrame) -> View:
            k = keyframes.index.get(item.stamp_ns)
            return View(restore(item)) if k is None else keyframes.views[k]

        # as the verdict did
        sensor = self.scan.sensor or typical_sensor([keyframes.views[keyframes.active[0]]])
        starts = interpolated(stored, self.scan.active, keyframes.centre)
        registered = refined_poses(stored, starts, view_of, keyframes, sensor, progress)
        motion = self.scan.graph.motion_prior([poses[k.stamp_ns] for k in self.scan.active], keyframes.active)
        stamps = [f.stamp_ns for f in stored]
        found = [poses.get(stamp, T) for stamp, (T, _) in zip(stamps, registered, strict=True)]
        smoothed = smooth(found, [H for _, H in registered], motion.resampled(stamps, found))
        self.scan.note_noise(motion, found, smoothed)
        pose_frames(self.scan.store.frames, dict(zip(stamps, smoothed, strict=True)) | usable)
        most = min(len(stored), self.settings.fusion.max_frames)
        chosen = np.linspace(0, len(stored) - 1, most).astype(int)
        return restore.posed([stored[n] for n in dict.fromkeys(chosen.tolist())])
