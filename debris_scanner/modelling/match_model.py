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

"""A model given beforehand: where it lies among the key frames, and whether all frames speak for it."""

from collections.abc import Sequence

import numpy as np

from debris_scanner.core.geometry import Array, compose
from debris_scanner.core.results import NO_MATCH, in_words
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import smooth
from debris_scanner.modelling.frame_store import StoredFrame, followed, spread
from debris_scanner.modelling.generation import Generation, ModelSettings, Progress
from debris_scanner.modelling.painted import Paint
from debris_scanner.modelling.placement import (
    Answer,
    KnownModel,
    MatchSettings,
    asked_again,
    find_model,
    usual_loss,
)
from debris_scanner.modelling.scan_map import ScanMap
from debris_scanner.sensing.views import View

FEWEST_PLACED, MOST_PLACED = 3, 8  # key frames among which a known model is looked for
LOOK_GROWTH = 0.25  # new key frames, as a share, until it is looked for again
JUDGED = 12  # frames of a tracked scan that speak for the known model; half while it goes on
TRACKED_POSES = 60  # of which the motion of a tracked target is measured


class MatchModel:
    """Looks for a known model, and asks again whether it is the right one.

    Args:
        scan: the map of the scan.
        settings: of the attempts.
        timer: of the steps.
        known: the model.
        searched: it may explain views worse than neighbours do by so much, nats a point, to be found.
    """

    def __init__(
        self, scan: ScanMap, settings: ModelSettings, timer: StageTimer, known: KnownModel, searched: float
    ) -> None:
        self.scan, self.settings, self.timer, self.known = scan, settings, timer, known
        self._paint = Paint(known)
        self._match = MatchSettings(searched, settings.verdict.min_turning_loss)
        self._asked_with = 0  # frames, when it was last asked whether the known model is the right one

    @property
    def size(self) -> int:
        """Key frames that an attempt now would have."""
        return len(self._placed_by)

    @property
    def due(self) -> bool:
        """Whether an attempt is worthwhile now: enough new key frames, or, once it is found, frames."""
        if self.scan.T_model_scan is not None:
            return len(self.scan.store.frames) >= 2 * max(self._asked_with, JUDGED)
        before = self.scan.generated_with
        return self.size >= max(FEWEST_PLACED, before + 1, before * (1 + LOOK_GROWTH))

    def attempt(self, final: bool, progress: Progress) -> Generation:
        """One attempt."""
        with self.scan.views.all_prepared():
            return self._tracked(final, progress)

    @property
    def _placed_by(self) -> list[int]:
        """Key frames, by index, among which the known model is looked for."""
        since_ns, frames = self.scan.withdrawn_ns, self.scan.keyframes
        return [k for k in self.scan.members if frames[k].stamp_ns > since_ns]

    def _tracked(self, final: bool, progress: Progress) -> Generation:
        """The known model, where it lies among the key frames; then whether all frames speak for it."""
        found = self.scan.T_model_scan is not None
        if not found and not self._place():
            return self._outcome()
        if found and not final:
            with self.timer.stage('refinement'):
                self._refine_keyframes()
        poses = {k.stamp_ns: k.T_target_sensor.copy() for k in self.scan.active}
        # frames of an earlier submap have no pose in the model's frame
        stored = [f for f in self.scan.store.with_depth if f.keyframe_ns is None or f.keyframe_ns in poses]
        if not final:
            self._asked_with = len(self.scan.store.frames)
            if found and len(stored) > JUDGED and not self._agrees(stored, final):
                self.scan.withdraw(self.scan.keyframes[-1].stamp_ns)
                return self._outcome(withdrawn=True)
        elif len(stored) < FEWEST_PLACED:
            self.scan.answer = self.scan.answer.too_few('frames', len(stored), FEWEST_PLACED)
        else:
            with self.timer.stage('refinement'):
                self._refine_tracked(stored, progress)
            with self.timer.stage('verdict'):
                self._agrees(stored, final)
        return self._outcome(poses)

    def _outcome(self, poses: dict[int, Array] | None = None, withdrawn: bool = False) -> Generation:
        """The model with its key frames' poses, unless the latest answer refuses it."""
        answer = self.scan.answer
        if poses is None or answer.refused:
            why = answer.refused or answer.why
            return Generation(None, NO_MATCH, why, {}, None, withdrawn, checks=answer.checks)
        return Generation(self.known.model, None, answer.why, poses, None, checks=answer.checks)

    def _place(self) -> bool:
        """Look for the model among some key frames of this submap, and move all there."""
        active = self._placed_by
        if len(active) < FEWEST_PLACED:
            self.scan.answer = self.scan.answer.too_few('keyframes', len(active), FEWEST_PLACED)
            return False
        views, frames = self.scan.views, self.scan.keyframes
        recent = active[-MOST_PLACED:]
        usual = usual_loss([views[k] for k in recent], [frames[k].T_target_sensor for k in recent])
        chosen = [active[n] for n in spread(len(active), MOST_PLACED)]
        posed = [frames[k].T_target_sensor for k in chosen]
        shown = [views[k] for k in chosen]
        found = find_model(self.known, shown, posed, usual, self._match)
        placed, answer = found.T_model_scan, Answer(found.why, '', found.checks, found.disagreed)
        if placed is not None:
            placed, checks = self._paint.placed(shown, posed, placed, self._match.min_lead)
            checks = found.checks + checks
            answer = answer._replace(why=in_words(checks), checks=checks)
        self.scan.answer = answer
        if placed is None:
            return False
        for keyframe in self.scan.active:
            keyframe.T_target_sensor = compose(placed, keyframe.T_target_sensor)
        self.scan.T_model_scan = placed
        return True

    def _refine_keyframes(self) -> None:
        """Register the key frames to the model, and make the motion smooth: frames lean on them."""
        members, views, frames = self.scan.members, self.scan.views, self.scan.keyframes
        registered = [self._paint.refined(views[k], frames[k].T_target_sensor) for k in members]
        found = [T for T, _ in registered]
        smoothed = smooth(found, [H for _, H in registered], self.scan.graph.motion_prior(found, members))
        for k, T in zip(members, smoothed, strict=True):
            frames[k].T_target_sensor = T

    def _refine_tracked(self, stored: Sequence[StoredFrame], progress: Progress) -> None:
        """Register frames to the model, and make the motion smooth."""
        poses = {k.stamp_ns: k.T_target_sensor for k in self.scan.active}
        found, information, resolutions = [], [], []
        for n, item in enumerate(stored):
            view = View(item.restore(self.settings.normals))
            T, H = self._paint.refined(view, item.pose(poses))
            found.append(T)
            information.append(H)
            resolutions.append(view.resolution)
            progress('refine', n + 1, len(stored))
        stamps = [f.stamp_ns for f in stored]
        some = spread(len(stored), TRACKED_POSES)
        linked = followed(stored, [stamps[n] for n in some])[1:]
        points = self.known.model.points
        motion = MotionPrior(
            [stamps[n] for n in some],
            linked,
            [found[n] for n in some],
            points.mean(axis=0).astype(np.float64),
            float(np.ptp(points, axis=0).max()),
            float(np.median(resolutions)) ** 2 / self.settings.motion.information_scale,
        )
        smoothed = smooth(found, information, motion.resampled(stamps, found))
        self.scan.note_noise(motion, found, smoothed)
        for item, T in zip(stored, smoothed, strict=True):
            item.keyframe_ns, item.T = None, T

    def _agrees(self, stored: Sequence[StoredFrame], final: bool) -> bool:
        """Whether some frames show the model, and not elsewhere."""
        poses = {k.stamp_ns: k.T_target_sensor for k in self.scan.active}
        pairs = [
            [(View(f.restore(self.settings.normals)), f.pose(poses)) for f in stored[n : n + 2]]
            for n in spread(len(stored) - 1, JUDGED if final else JUDGED // 2)
        ]
        sensor, disagreed = self.scan.sensor_for if final else None, self.scan.answer.disagreed
        self.scan.answer = asked_again(self.known, pairs, self.settings.accepted_loss, disagreed, sensor)
        return not self.scan.answer.refused
