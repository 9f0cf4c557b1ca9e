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

"""The graph node's scan: what its worker does, from the first frame to the saved files."""

import time
from collections.abc import Callable
from pathlib import Path

from sensor_msgs.msg import PointCloud2

from debris_scanner.core.memory import Housekeeping
from debris_scanner.core.results import INTERRUPTED
from debris_scanner.modelling.model_builder import Generation
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.worker import Answer, Worker
from debris_scanner.nodes.publishing.estimates import SCANNING_FRAME, Verdict
from debris_scanner.nodes.publishing.model_publisher import ModelPublisher
from debris_scanner.nodes.recovery.catching_up import MissedClouds
from debris_scanner.nodes.recovery.graph_journal import GraphJournal
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.graph_stage import GraphStage
from debris_scanner.nodes.scan.joining import BUSY_PATIENCE_S, NEW, PATIENCE_S, STALE, FrameJoin, ScanIdentity
from debris_scanner.nodes.scan.scan_output import ScanOutput, outcome_text
from debris_scanner.nodes.scan.scan_state import ScanState
from debris_scanner.scanner import make_model_builder
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.settings import Settings

DRAIN_S = 10.0  # what is on its way when the end is asked for gets this long


class GraphScan:
    """Frames, closures, generations and files of one scan after another; all but the flags in the worker.

    Args:
        node: whose parameters and topics these are.
        settings: of the builder.
        ledger: that counts the frames.
        lost: how many verdicts never came here.
    """

    def __init__(
        self, node: StageNode, settings: Settings, statistics: FrameStatistics, lost: Callable[[], int]
    ) -> None:
        self._node = node
        self._lost = lost
        self.output = ScanOutput(node)
        builder = make_model_builder(settings, node.timer)
        self.stage = GraphStage(builder, node.timer, statistics, self._complain)
        self.worker = Worker(self._advance, nice=5)  # frames come before models
        self.join = FrameJoin(lambda verdict: verdict.accepted)
        self.state = ScanState(node)
        self.publisher = ModelPublisher(node)
        self.ended = False
        self._identity = ScanIdentity()
        self._housekeeping = Housekeeping()
        self._taken_ns = 0  # stamp of the last verdict

    @property
    def journal_problem(self) -> str:
        """Why the journal cannot be written."""
        return '' if self.stage.journal is None else self.stage.journal.problem

    def _note(self, text: str) -> None:
        self._node.get_logger().warning(text)

    def _complain(self, text: str) -> None:
        """Of a message: a flood of bad ones must not fill the disk with what is said of them."""
        self._node.get_logger().warning(text, throttle_duration_sec=1.0)

    def resume(self, folder: Path, normals: NormalSettings, take: Callable[[PointCloud2, int], None]) -> bool:
        """Open the journal; whether it tells of a scan, which then goes on.

        Args:
            folder: of the journals.
            normals: how the planes of frames on disk are fitted.
            take: called with the clouds that were sent meanwhile.
        """
        journal = GraphJournal(folder, normals)
        try:
            journal.replay(self.stage)
        except (KeyError, ValueError, TypeError) as error:  # of another release
            self._note(f'the journal in {folder} cannot be read, a new scan begins: {error}')
            journal.restart()
            self.stage.reset()
        self.stage.journal = journal
        if journal.last is None:
            return False
        self._identity.of(journal.last.scan_ns)
        self._taken_ns = journal.last.stamp_ns
        self.ended = journal.ended
        self._note(f'started anew: going on with {self.stage.statistics.used} frames')
        if not self.ended:
            if self.stage.builder.T_model_scan is not None:
                self.worker.post(self._generate)
            MissedClouds(self._node, folder, normals, self._taken_ns, take)
        return True

    def generate_now(self) -> Answer:
        """``~/generate_model``."""
        return outcome_text(self._generate())

    def save_now(self) -> Answer:
        """``~/save_model``."""
        last = self.stage.builder.last
        if last is None:
            last = self.stage.builder.generate()
        return self.output.save(self.stage.result(last, self._lost()))

    def finish_now(self) -> Answer:
        """``~/finish``."""
        return self.finish(None)

    def reset(self) -> None:
        """A new scan: what is still on its way from the old one is passed over."""
        if self._identity.reset():
            self._begin()

    def forget(self) -> None:
        """Take the model back and leave nothing to go on from."""
        self.publisher.clear()
        if self.stage.journal is not None:
            self.stage.journal.restart()

    def _begin(self) -> None:
        self.join.restart()
        self.stage.reset()
        self.output.restart()
        self.publisher.clear()
        self.state.reset()
        self.ended = False
        self._taken_ns = 0

    def take_verdict(self, verdict: Verdict) -> None:
        """The verdict on a frame; its other parts come by themselves."""
        scan = self._identity.of(verdict.scan_ns)
        if scan == NEW and self.stage.recorder.rates:
            self._note('odometry began anew, so the scan does too')
            self._begin()
        if self.ended or scan == STALE or verdict.stamp_ns <= self._taken_ns:
            return
        self._taken_ns = verdict.stamp_ns
        self.join.add_verdict(verdict, time.monotonic())

    def _advance(self) -> None:
        """After every message: whole frames, closures, and a generation where one is due."""
        self._housekeeping.look()
        if self.ended:
            return
        patience_s = BUSY_PATIENCE_S if self.worker.backlog else PATIENCE_S
        for joined in self.join.pop(time.monotonic(), patience_s):
            self.stage.take(joined)
            if joined.verdict.keyframe and not self.stage.generated:
                self.publisher.publish_graph(self.stage.builder.active, SCANNING_FRAME)
        self.stage.settle(patience_s)
        if self.stage.builder.should_rebuild:
            self._generate()

    def _generate(self, final: bool = False) -> Generation:
        if not final:
            self.state.generation_began()
        generation = self.stage.builder.generate(final)
        if self.stage.journal is not None:
            self.stage.journal.generated(self.stage.builder)
        if generation.model is None:
            self.state.generation_ended(published=False)
            self._note(outcome_text(generation)[1])
            return generation
        self.publisher.publish(generation)
        self.stage.published()
        self.state.generation_ended(published=not final)
        self._node.get_logger().info(outcome_text(generation)[1])
        if not final and self.output.folder is not None:  # so that no crash can take it away
            self._node.get_logger().info(self.output.save(self.stage.result(generation, self._lost()))[1])
        return generation

    def save_interrupted(self) -> None:
        """First as things stand, for who stops us may lose patience; then with the last optimisation."""
        last = self.stage.builder.last or Generation(None, INTERRUPTED, '', {}, None)
        self.output.save(self.stage.result(last, self._lost(), INTERRUPTED))
        self._node.get_logger().info(self.finish(INTERRUPTED)[1])

    def _settled(self) -> bool:
        """Whether all that has come has been dealt with."""
        return self.ended or (not self.worker.backlog and not self.join and self.stage.settled)

    def finish(self, interrupted: str | None) -> Answer:
        """Last optimisation over all that came, then write the files."""
        self.worker.work_until(self._settled, DRAIN_S)
        if not self.ended:
            self.ended = True
            last = self._generate(final=True)
        else:
            last = self.stage.builder.last
        assert last is not None
        answer = self.output.save(self.stage.result(last, self._lost(), interrupted))
        if self.stage.journal is not None and answer[0]:
            self.stage.journal.end()
        return answer
