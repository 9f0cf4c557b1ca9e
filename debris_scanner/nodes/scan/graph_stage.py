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

"""The graph node's work, done in its worker: frames and closures in, generations and results out."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.core.results import ClosureRecord, ScanResult
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import Generation, ModelBuilder
from debris_scanner.nodes.publishing.closure_publisher import read_candidates
from debris_scanner.nodes.publishing.estimates import Verdict
from debris_scanner.nodes.recovery.graph_journal import GraphJournal
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.joining import PATIENCE_S, JoinedFrame, make_keyframe
from debris_scanner.recorder import ScanRecorder
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import ClosureTransform, StampedOdometry, read_closure

CLOSURE_TO_MODEL = 'closure_to_model'
MOST_CANDIDATES = 200_000  # hypotheses that are remembered: those of 600 key frames


@dataclass
class _Pending:
    """A closure that waits for its key frames and its numbers."""

    transform: ClosureTransform
    since_s: float


class GraphStage:
    """Key frames, believed frames and closures of one scan; not thread-safe.

    Args:
        builder: of the models; it is reset.
        timer: of the stages.
        ledger: that counts the frames.
        log: called with what users should read.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        timer: StageTimer,
        statistics: FrameStatistics,
        log: Callable[[str], None],
    ) -> None:
        self.builder = builder
        self.timer = timer
        self.statistics = statistics
        self._log = log
        self.journal: GraphJournal | None = None
        self.reset()

    def reset(self) -> None:
        """Begin a new scan."""
        self.builder.reset()
        self.recorder = ScanRecorder()
        self.statistics.reset()
        self._candidates: dict[tuple[int, int], ClosureRecord] = {}
        self._pending: list[_Pending] = []
        self._closed_s: float | None = None
        if self.journal is not None:
            self.journal.restart()

    @property
    def generated(self) -> bool:
        """Whether there is a model."""
        return self.builder.last is not None and self.builder.last.model is not None

    def take(self, joined: JoinedFrame) -> None:
        """A frame with its verdict."""
        verdict = joined.verdict
        try:
            if joined.odometry is None or (verdict.accepted and joined.cloud is None):
                raise MalformedMessage(f'frame {verdict.stamp_ns} came without its pose or cloud')
            estimate = joined.estimate()
            frame = joined.target() if verdict.accepted else None
        except MalformedMessage as error:
            self.statistics.incomplete += 1
            self.statistics.first_ns = self.statistics.first_ns or verdict.stamp_ns
            self._log(str(error))
            return
        self.add(verdict, estimate, frame)
        if self.journal is not None:
            stored = frame is not None and self.builder.store.frames[-1].depth is not None
            self.journal.frame(verdict, estimate, frame, with_depth=stored or verdict.keyframe)

    def add(self, verdict: Verdict, estimate: StampedOdometry, frame: TargetFrame | None) -> None:
        """The same once its messages are read; a frame that was not believed is None."""
        self.statistics.first_ns = self.statistics.first_ns or verdict.stamp_ns
        self.recorder.add_estimate(
            verdict.stamp_ns,
            estimate.T_sensor_target,
            estimate.twist[:3],
            estimate.twist_covariance.diagonal()[:3] ** 0.5,
            verdict.accepted,
            self.builder.T_model_scan if verdict.tracked else None,
            verdict.submap,
        )
        if frame is None:
            self.statistics.not_registered += 1
            return
        if verdict.keyframe:
            self.builder.add_keyframe(make_keyframe(verdict, estimate, frame), verdict.tracked)
        if verdict.usable_for_mapping:
            self.builder.add_frame(frame, inverse(estimate.T_sensor_target), verdict.tracked)
        self.statistics.used += 1

    def add_candidates(self, msg: DiagnosticArray) -> None:
        """Hypotheses, accepted or not, for summary.json."""
        try:
            records = read_candidates(msg)
        except MalformedMessage as error:
            self._log(str(error))
            return
        named = {(r.from_stamp_ns, r.to_stamp_ns): r for r in records}
        room = MOST_CANDIDATES - len(self._candidates)
        new = [r for pair, r in named.items() if pair not in self._candidates][:room]
        if new:  # a stage that was restarted may say things twice
            self.note_candidates(new)
            if self.journal is not None:
                self.journal.candidates(new)

    def note_candidates(self, records: list[ClosureRecord]) -> None:
        """The same once the message is read."""
        self.recorder.closures += records
        self._candidates |= {(r.from_stamp_ns, r.to_stamp_ns): r for r in records}

    def add_closure(self, msg: TransformStamped) -> None:
        """An accepted closure; its key frames and numbers may still be on their way."""
        try:
            self._pending.append(_Pending(read_closure(msg), time.monotonic()))
        except MalformedMessage as error:
            self._log(str(error))

    def settle(self, patience_s: float = PATIENCE_S) -> None:
        """Give the builder those closures of which everything has come; drop those that wait too long."""
        waiting = []
        known = self.builder.graph.keyframes.index
        for pending in self._pending:
            c = pending.transform
            patient = time.monotonic() - pending.since_s < patience_s
            record = self._candidates.get((c.from_stamp_ns, c.to_stamp_ns))
            if c.from_stamp_ns in known and c.to_stamp_ns in known and (record or not patient):
                probability, why = (record.probability, record.why) if record else (1.0, 'from another node')
                closure = Closure(c.from_stamp_ns, c.to_stamp_ns, probability, True, why, c.T_from_to)
                self.builder.add_closure(closure)
                if self.journal is not None:
                    self.journal.closure(closure)
                if not self.generated:
                    self._closed_s = self._closed_s or pending.since_s
            elif patient:
                waiting.append(pending)
            else:
                self._log(f'closure {c.from_stamp_ns} - {c.to_stamp_ns} names an unknown key frame')
        self._pending = waiting

    @property
    def settled(self) -> bool:
        """Whether no closure waits."""
        return not self._pending

    def published(self) -> None:
        """A model has gone out: how long after the closure that called for the first one?"""
        if self._closed_s is not None:
            self.timer.add(CLOSURE_TO_MODEL, time.monotonic() - self._closed_s)
            self._closed_s = None

    def result(self, generation: Generation, lost_here: int, interrupted: str | None = None) -> ScanResult:
        """The scan's result as a generation left it.

        Args:
            generation: the latest.
            lost_here: verdicts that this node never got.
            interrupted: reason to give where a cut-off scan has no model.
        """
        rejected = self.statistics.rejected(lost_here)
        return self.recorder.result(
            self.builder,
            generation,
            self.statistics.used + sum(rejected.values()),
            rejected,
            self.statistics.timing(self.timer),
            interrupted,
        )
