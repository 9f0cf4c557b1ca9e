"""Node ``scanner``: all stages in one process, built on the object that scans offline.

The executor decodes and queues, one worker takes the frames from preprocessing to closures, and another
builds the models, so that no frame waits for one. As between the four processes, a frame is tracked once
the model is there: how many are scanned until then is a matter of time.
"""

import queue
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool

from debris_scanner.frames import DepthFrame
from debris_scanner.model_builder import Generation
from debris_scanner.nodes import qos
from debris_scanner.nodes.closure_publisher import ClosurePublisher
from debris_scanner.nodes.deferred_builder import DeferredBuilder
from debris_scanner.nodes.diagnostics import TOPIC, Problem, read_reports, throughput
from debris_scanner.nodes.graph_stage import CLOSURE_TO_MODEL
from debris_scanner.nodes.idle_end import IdleEnd
from debris_scanner.nodes.ledger import Ledger
from debris_scanner.nodes.managed import ManagedNode
from debris_scanner.nodes.model_publisher import ModelPublisher
from debris_scanner.nodes.odometry_publisher import OdometryPublisher
from debris_scanner.nodes.parameters import SettingsParameters
from debris_scanner.nodes.process import run
from debris_scanner.nodes.scan_output import ScanOutput
from debris_scanner.nodes.scan_services import ScanServices
from debris_scanner.nodes.scan_state import ScanState
from debris_scanner.nodes.sensor_input import LOST_IN_TRANSPORT, SensorInput, input_values
from debris_scanner.nodes.stage import PAUSED_TOPIC
from debris_scanner.nodes.worker import Answer, Worker
from debris_scanner.parameters import flatten
from debris_scanner.results import INTERRUPTED, ScanResult
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.target_frames import target_frame_message

MOST_WAITING = 200  # frames: 20 seconds of a 10 Hz sensor, 250 MB of depth
LIVE = ('isolation', 'odometry', 'closure', 'closure_search', 'verification', 'fusion', 'verdict')
PAUSED, QUEUE_FULL = 'paused', 'queue_full'
DRAIN_S = 10.0  # what waits when the end is asked for gets this long
SWITCH_S = 5e-4  # Python's own 5 ms, a dozen times a frame, would delay odometry while a model is built


class ScannerNode(ManagedNode):
    """The sensor in; every topic of the four separate nodes out."""

    def __init__(self) -> None:
        super().__init__('scanner')

    def setup(self) -> None:
        """Everything beside parameters of the lifecycle; takes messages once the node is active."""
        groups = {name.split('.')[0] for name in flatten(Settings())}
        self.settings = SettingsParameters(
            self, groups, LIVE, lambda new: self.frames.post(lambda: self._apply(new))
        )
        self.output = ScanOutput(self)
        self.scanner = Scanner(self.settings.value, timer=self.timer)
        self.ledger = Ledger()
        self.frames = Worker(lambda: None)
        self.worker = Worker(self._advance)
        self.builder = self.scanner.builder  # the worker's
        self.scanner.builder = DeferredBuilder(self.builder, self.worker)
        self._models: queue.SimpleQueue[tuple[int, Generation]] = queue.SimpleQueue()
        self._scan = self._scan_built = 0  # number of the scan, as either worker has it
        self._closed_s: float | None = None
        sys.setswitchinterval(SWITCH_S)
        self.paused = False
        self._ended = False
        self._frames_per_second = throughput(self.diagnostics.counts, 'received')
        warm_up()
        self.state = ScanState(self)
        self._target = self.create_publisher(PointCloud2, 'target_points', qos.cloud_publisher())
        self._odometry = OdometryPublisher(self)
        self._closures = ClosurePublisher(self)
        self.publisher = ModelPublisher(self)
        self.scan_services = ScanServices(self, self.worker, self)
        self.create_subscription(Bool, PAUSED_TOPIC, self._on_paused, qos.latched())
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.input = SensorInput(self, self._queue)
        self.idle_end = IdleEnd(self, lambda: self.diagnostics.counts['received'], self._finish_unasked)
        for worker in (self.frames, self.worker):
            self.create_timer(0.2, worker.check)
            worker.start()

    # in the executor's thread ----------------------------------------------------------------------

    def diagnostic_values(self) -> dict[str, Any]:
        """State and size of the scan."""
        last = self.builder.last
        return {
            'state': self.state.value,
            'frames_per_second': self._frames_per_second(),
            'keyframes': len(self.builder.keyframes),
            'best_probability': float(self.scanner.detector.best_probability),
            'model': int(last is not None and last.model is not None),
            'finished': int(self._ended),
            'backlog': self.frames.backlog,
        } | input_values(self.input)

    def problem(self) -> Problem | None:
        """Silence of the sensor."""
        return None if self.paused else self.input.problem()

    def reset_stage(self) -> None:
        """A new scan, once the frames that wait have been dealt with."""
        super().reset_stage()
        self.input.reset()
        self.frames.post(self._begin)

    def close_stage(self) -> None:
        """Save what was gathered; without a model the scan counts as interrupted."""
        self.frames.stop()
        if not self._ended:
            self.worker.post(self._save_interrupted)
        self.worker.stop()
        self.diagnostics.publish()
        self.frames.check()
        self.worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.publisher.clear()

    def _finish_unasked(self) -> None:
        self.worker.post(lambda: self.get_logger().info(self._finish(None)[1]))
        self.worker.post(self.idle_end.done)

    def _queue(self, frame: DepthFrame, frame_id: str) -> None:
        reason = PAUSED if self.paused else QUEUE_FULL if self.frames.backlog > MOST_WAITING else None
        if reason is None:
            self.frames.post(lambda: self._process(frame, frame_id))
        else:
            self.diagnostics.rejected[reason] += 1

    def _on_paused(self, msg: Bool) -> None:
        self.paused = msg.data

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self.ledger.report(report)

    # in the frames' thread -------------------------------------------------------------------------

    def _process(self, frame: DepthFrame, frame_id: str) -> None:
        if self._ended:
            return
        self._adopt()
        tracked = self.scanner.odometry.model is not None
        step = self.scanner.process(frame)
        if step.target is None or step.estimate is None:
            return
        target_points = target_frame_message(step.target, frame_id)
        self._odometry.publish(step.estimate, self.scanner.odometry, tracked, target_points)
        self.ledger.odometry_published(step.estimate.stamp_ns, time.time_ns())
        self._target.publish(target_points)
        self.ledger.first_ns = self.ledger.first_ns or step.estimate.stamp_ns
        self.state.odometry(step.estimate.state, tracked)
        self._closures.publish(step.closures)
        if any(c.accepted for c in step.closures) and self._closed_s is None:
            self._closed_s = time.monotonic()

    def _adopt(self) -> None:
        """Track the models that have come, unless they are of a scan before."""
        while not self._models.empty():
            scan, generation = self._models.get()
            if scan == self._scan and generation.model is not None:
                with self.timer.stage('adopt'):
                    self.scanner.odometry.adopt_model(generation.model, generation.poses)

    def _begin(self) -> None:
        """A new scan, for the frames at once, for the builder after what it was given."""
        self._scan += 1
        self.scanner.reset()
        self.ledger.reset()
        self._odometry.reset()
        self._closed_s = None
        self._ended = False
        self.worker.post(self._begin_building)

    def _apply(self, settings: Settings) -> None:
        scanner = self.scanner
        scanner.preprocessor.configure(settings.isolation)
        scanner.odometry.settings = settings.odometry
        scanner.detector.settings, scanner.detector.search = settings.closure, settings.closure_search
        scanner.detector.verification = settings.verification
        self.builder.fusion, self.builder.verdict = settings.fusion, settings.verdict

    # in the worker's thread ------------------------------------------------------------------------

    def generate_now(self) -> Answer:
        """``~/generate_model``."""
        generation = self._generate()
        if generation.model is None:
            return False, f'no model: {generation.reason}: {generation.why}'
        return True, f'a model of {len(generation.model.points)} points: {generation.why}'

    def save_now(self) -> Answer:
        """``~/save_model``."""
        last = self.builder.last or self.builder.generate()
        return self.output.save(self._result(last))

    def finish_now(self) -> Answer:
        """``~/finish``."""
        return self._finish(None)

    def _advance(self) -> None:
        """After everything that came: a generation where one is due."""
        if not self._ended and self.builder.due:
            self._generate()

    def _generate(self) -> Generation:
        self.state.generation_began()
        generation = self.builder.generate()
        self._publish_model(generation)
        return generation

    def _publish_model(self, generation: Generation) -> None:
        self.state.generation_ended(published=generation.model is not None)
        if generation.model is None:
            self.get_logger().warning(f'no model: {generation.reason}: {generation.why}')
            return
        self._models.put((self._scan_built, generation))
        self.publisher.publish(generation)
        if self._closed_s is not None:
            self.timer.add(CLOSURE_TO_MODEL, time.monotonic() - self._closed_s)
            self._closed_s = None
        self.get_logger().info(f'model of {len(generation.model.points)} points: {generation.why}')
        if not self._ended and self.output.folder is not None:  # so that no crash can take it away
            self.get_logger().info(self.output.save(self._result(generation))[1])

    def _begin_building(self) -> None:
        self._scan_built += 1
        self.output.restart()
        self.publisher.clear()
        self.state.reset()

    def _save_interrupted(self) -> None:
        """First as things stand, for who stops us may lose patience; then with the last optimisation."""
        last = self.builder.last or Generation(None, INTERRUPTED, '', {}, None)
        self.output.save(self._result(last, INTERRUPTED))
        self.get_logger().info(self._finish(INTERRUPTED)[1])

    def _drain(self) -> None:
        """Let the frames that wait come through."""
        seen = threading.Event()
        self.frames.post(seen.set)
        self.worker.work_until(lambda: seen.is_set() and not self.worker.backlog, DRAIN_S)

    def _finish(self, interrupted: str | None) -> Answer:
        if interrupted is None:
            self._drain()
        if not self._ended:
            self._ended = True
            generation = self.builder.generate(final=True)
            if generation.model is not None:
                self.publisher.publish(generation)
        last = self.builder.last
        assert last is not None
        return self.output.save(self._result(last, interrupted))

    def _result(self, generation: Generation, interrupted: str | None = None) -> ScanResult:
        """The scanner's result with what was dropped before it, and how late its odometry was."""
        result = self.scanner.result(generation, interrupted)
        dropped = dict(self.diagnostics.rejected)
        known = result.frames_read + sum(dropped.values()) + self.input.lost
        lost = self.input.lost + max(0, self.ledger.sent - known)
        if lost:
            dropped[LOST_IN_TRANSPORT] = lost
        result.frames_rejected = result.frames_rejected | dropped
        result.frames_read += sum(dropped.values())
        result.timing = self.ledger.timing(self.timer)
        return result


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner scanner``."""
    return run(ScannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
