"""Node ``graph``: keeps frames and closures, generates the model, publishes it and saves the scan.

The executor only queues what comes; one worker does the work, so a generation of seconds stops nothing.
"""

import sys
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.model_builder import Generation
from debris_scanner.nodes import qos
from debris_scanner.nodes.catching_up import MissedClouds, forget_journals, journal_folder
from debris_scanner.nodes.diagnostics import TOPIC, WARN, Problem, read_reports
from debris_scanner.nodes.estimates import SCANNING_FRAME, Verdict, read_verdict
from debris_scanner.nodes.graph_journal import GraphJournal
from debris_scanner.nodes.graph_stage import GraphStage
from debris_scanner.nodes.idle_end import IdleEnd
from debris_scanner.nodes.joining import FrameJoin
from debris_scanner.nodes.ledger import Ledger
from debris_scanner.nodes.managed import ManagedNode
from debris_scanner.nodes.model_publisher import ModelPublisher
from debris_scanner.nodes.parameters import SettingsParameters
from debris_scanner.nodes.process import run
from debris_scanner.nodes.scan_identity import NEW, STALE, ScanIdentity
from debris_scanner.nodes.scan_output import ScanOutput
from debris_scanner.nodes.scan_services import ScanServices
from debris_scanner.nodes.scan_state import ScanState
from debris_scanner.nodes.worker import Answer, Worker
from debris_scanner.results import INTERRUPTED
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import read_stamp

SETTINGS = ('builder', 'pose_graph', 'fusion', 'verdict', 'normals', 'motion')
LIVE = ('fusion', 'verdict')
MOST_WAITING = 900  # messages, some 300 frames
DRAIN_S = 10.0  # what is on its way when the end is asked for gets this long


class GraphNode(ManagedNode):
    """Everything the other nodes publish in; ``model``, ``model_mesh``, ``keyframe_poses``, ``state`` out."""

    def __init__(self) -> None:
        super().__init__('graph')

    def setup(self) -> None:
        """Everything beside parameters of the lifecycle; takes messages once the node is active."""
        self.settings = SettingsParameters(self, SETTINGS, live=LIVE, apply=self._apply)
        self.output = ScanOutput(self)
        self.ledger = Ledger()
        self.stage = GraphStage(self.settings.value, self.timer, self.ledger, self._note)
        self.worker = Worker(self._advance)
        self._taken_ns = 0  # stamp of the last verdict
        self._join = FrameJoin(lambda verdict: verdict.accepted)
        self._identity = ScanIdentity()
        self._ended = False
        warm_up()
        self._folder = journal_folder(self)
        self.state = ScanState(self)
        self.publisher = ModelPublisher(self)
        self.diagnostics.expect_subscribers(model=self.publisher.model, keyframe_poses=self.publisher.poses)
        self.scan_services = ScanServices(self, self.worker, self, lambda: forget_journals(self._folder))
        # what was said while this node was away is said again to it
        heard = qos.kept() if self._folder is not None and self._resume(self._folder) else qos.waiting()
        self._verdicts = self.receive(DiagnosticArray, 'odometry_status', self._on_verdict, heard)
        self._frames = self.receive(PointCloud2, 'target_points', self._on_cloud, qos.waiting())
        self.receive(PointCloud2, 'keyframe_points', self._on_cloud, qos.waiting())
        self.receive(OdometryMessage, 'odometry', self._on_odometry, heard)
        self.receive(DiagnosticArray, 'closure_candidates', self._on_candidates, heard)
        self.receive(TransformStamped, 'closures', self._on_closure, heard)
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.idle_end = IdleEnd(self, self._frames_received, self._finish_unasked)
        self.create_timer(0.2, self.worker.check)
        self.worker.start()

    # in the executor's thread ----------------------------------------------------------------------

    def diagnostic_values(self) -> dict[str, Any]:
        """State and size of the scan."""
        return {
            'state': self.state.value,
            'keyframes': len(self.stage.builder.keyframes),
            'frames': self.ledger.used,
            'model': int(self.stage.generated),
            'finished': int(self._ended),
            'backlog': self.worker.backlog,
            'count.lost': self._verdicts.lost + self._frames.lost,
        }

    def problem(self) -> Problem | None:
        """A generation that was refused."""
        last = self.stage.builder.last
        return (WARN, f'{last.reason}: {last.why}') if last is not None and last.reason else None

    def reset_stage(self) -> None:
        """A new scan: what is still on its way from the old one is passed over."""
        super().reset_stage()
        self.worker.post(lambda: self._identity.reset() and self._begin())

    def close_stage(self) -> None:
        """Save what was gathered; without a model the scan counts as interrupted."""
        if not self._ended:
            self.worker.post(self._save_interrupted)
        self.worker.stop()
        self.diagnostics.publish()
        self.worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.publisher.clear()
        if self.stage.journal is not None:
            self.stage.journal.restart()

    def _frames_received(self) -> int:
        report = self.ledger.reports.get('preprocess')
        return 0 if report is None else report.counts.get('received', 0)

    def _finish_unasked(self) -> None:
        self.worker.post(lambda: self._note(self._finish(None)[1]))
        self.worker.post(self.idle_end.done)

    def _on_verdict(self, msg: DiagnosticArray, _published_ns: int) -> None:
        try:
            verdict = read_verdict(msg)
        except MalformedMessage as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        self.state.odometry(verdict.state, verdict.tracked)
        self.worker.post(lambda: self._take_verdict(verdict))

    def _on_cloud(self, msg: PointCloud2, _published_ns: int) -> None:
        # when generations take longer than they should, memory must not pay for it
        if not self._ended and self.worker.backlog < MOST_WAITING:
            self.worker.post(lambda: self._join.add_cloud(msg))

    def _on_odometry(self, msg: OdometryMessage, published_ns: int) -> None:
        self.ledger.odometry_published(read_stamp(msg.header.stamp), published_ns)
        if not self._ended:
            self.worker.post(lambda: self._join.add_odometry(msg))

    def _on_candidates(self, msg: DiagnosticArray, _published_ns: int) -> None:
        self.worker.post(lambda: self.stage.add_candidates(msg))

    def _on_closure(self, msg: TransformStamped, _published_ns: int) -> None:
        self.worker.post(lambda: self.stage.add_closure(msg))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self.ledger.report(report)

    def _apply(self, settings: Settings) -> None:
        self.stage.builder.fusion, self.stage.builder.verdict = settings.fusion, settings.verdict

    def _note(self, text: str) -> None:
        self.get_logger().warning(text)

    def _resume(self, folder: Path) -> bool:
        """Open the journal; whether it tells of a scan, which then goes on."""
        journal = GraphJournal(folder, self.settings.value.normals)
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
        self._ended = journal.ended
        self._note(f'started anew: going on with {self.ledger.used} frames')
        if not self._ended:
            if self.stage.builder.T_model_scan is not None:
                self.worker.post(self._generate)
            MissedClouds(self, folder, self.settings.value.normals, self._taken_ns, self._on_cloud)
        return True

    # in the worker's thread ------------------------------------------------------------------------

    def generate_now(self) -> Answer:
        """``~/generate_model``."""
        generation = self._generate()
        if generation.model is None:
            return False, f'no model: {generation.reason}: {generation.why}'
        return True, f'a model of {len(generation.model.points)} points: {generation.why}'

    def save_now(self) -> Answer:
        """``~/save_model``."""
        last = self.stage.builder.last
        if last is None:
            last = self.stage.builder.generate()
        return self.output.save(self.stage.result(last, self._verdicts.lost))

    def finish_now(self) -> Answer:
        """``~/finish``."""
        return self._finish(None)

    def _begin(self) -> None:
        self._join.restart()
        self.stage.reset()
        self.output.restart()
        self.publisher.clear()
        self.state.reset()
        self._ended = False
        self._taken_ns = 0

    def _take_verdict(self, verdict: Verdict) -> None:
        scan = self._identity.of(verdict.scan_ns)
        if scan == NEW and self.stage.recorder.rates:
            self._note('odometry began anew, so the scan does too')
            self._begin()
        if self._ended or scan == STALE or verdict.stamp_ns <= self._taken_ns:
            return
        self._taken_ns = verdict.stamp_ns
        self._join.add_verdict(verdict, time.monotonic())

    def _advance(self) -> None:
        """After every message: whole frames, closures, and a generation where one is due."""
        if self._ended:
            return
        for joined in self._join.pop(time.monotonic()):
            self.stage.take(joined)
            if joined.verdict.keyframe and not self.stage.generated:
                self.publisher.publish_graph(self.stage.builder.keyframes, SCANNING_FRAME)
        self.stage.settle()
        if self.stage.builder.due:
            self._generate()

    def _generate(self, final: bool = False) -> Generation:
        if not final:
            self.state.generation_began()
        generation = self.stage.builder.generate(final)
        if self.stage.journal is not None:
            self.stage.journal.generated(self.stage)
        if generation.model is None:
            self.state.generation_ended(published=False)
            self._note(f'no model: {generation.reason}: {generation.why}')
            return generation
        self.publisher.publish(generation)
        self.stage.published()
        self.state.generation_ended(published=not final)
        self.get_logger().info(f'model of {len(generation.model.points)} points: {generation.why}')
        if not final and self.output.folder is not None:  # so that no crash can take it away
            self.get_logger().info(self.output.save(self.stage.result(generation, self._verdicts.lost))[1])
        return generation

    def _save_interrupted(self) -> None:
        """First as things stand, for who stops us may lose patience; then with the last optimisation."""
        last = self.stage.builder.last or Generation(None, INTERRUPTED, '', {}, None)
        self.output.save(self.stage.result(last, self._verdicts.lost, INTERRUPTED))
        self.get_logger().info(self._finish(INTERRUPTED)[1])

    def _settled(self) -> bool:
        """Whether all that has come has been dealt with."""
        return self._ended or (not self.worker.backlog and not self._join and self.stage.settled)

    def _finish(self, interrupted: str | None) -> Answer:
        self.worker.work_until(self._settled, DRAIN_S)
        if not self._ended:
            self._ended = True
            last = self._generate(final=True)
        else:
            last = self.stage.builder.last
        assert last is not None
        answer = self.output.save(self.stage.result(last, self._verdicts.lost, interrupted))
        if self.stage.journal is not None and answer[0]:
            self.stage.journal.end()
        return answer


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner graph``."""
    return run(GraphNode, args)


if __name__ == '__main__':
    sys.exit(main())
