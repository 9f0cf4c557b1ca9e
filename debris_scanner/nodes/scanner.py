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

"""Node ``scanner``: all stages in one process, built on the same front end and back end as the offline scan.

The executor decodes frames, as many as the front end keeps up with, one worker runs the front end, and
another the back end, so that no frame waits for a model. As with four processes, frames are registered to
key frames until the model is ready; how many depends on timing.
"""

import math
import queue
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.parameters import flatten
from debris_scanner.io.outcome import LOST_IN_TRANSPORT
from debris_scanner.modelling.generation import Generation
from debris_scanner.nodes.inputs.sensor_input import SensorInput, input_values
from debris_scanner.nodes.inputs.sensor_odometry import follow_sensor
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import (
    TOPIC,
    WARN,
    Problem,
    read_reports,
    throughput,
    together,
)
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters, declare_settings
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import PAUSED_TOPIC, StageNode
from debris_scanner.nodes.lifecycle.worker import Worker
from debris_scanner.nodes.publishing.closure_publisher import ClosurePublisher
from debris_scanner.nodes.publishing.odometry_publisher import OdometryPublisher
from debris_scanner.nodes.recovery.catching_up import declare_journal, forget_journals, journal_folder
from debris_scanner.nodes.recovery.scanner_journal import ScannerJournal
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.idle_end import IdleEnd
from debris_scanner.nodes.scan.scan_thread import ScanThread
from debris_scanner.nodes.scan.services import ScanServices
from debris_scanner.recorder import FrameCounts
from debris_scanner.scanner import FrontEnd, Step
from debris_scanner.sensing.hints import given, joined
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.models import TIMELESS_NS, model_id, model_message
from msg_adapters.target_frames import target_frame_message

LIVE = ('isolation', 'odometry', 'closure', 'closure_search', 'verification', 'fusion', 'verdict')
PAUSED = 'paused'
GROUPS = {name.split('.')[0] for name in flatten(Settings())}
SWITCH_S = 5e-4  # Python's default of 5 ms, a dozen times a frame, delays odometry while a model is built


class _ModelHandOver(ScanThread):
    """The back end's thread; hands its models to the frames' thread, which tracks them.

    ``scan`` counts the scans: after a reset the frames' thread is in the new one while the back end still
    processes the old one.
    """

    def __init__(self, node: StageNode, *args: Any, **kwargs: Any) -> None:
        self.models: queue.SimpleQueue[tuple[int, Generation]] = queue.SimpleQueue()
        self.scan = 0
        super().__init__(node, *args, **kwargs)

    def scan_began(self) -> None:
        """Count a new scan; later models belong to it."""
        self.scan += 1
        super().scan_began()

    def model_built(self, generation: Generation, final: bool) -> None:
        """Hand the model over for tracking, and publish it."""
        if not final:
            self.models.put((self.scan, generation))
        super().model_built(generation, final)

    def model_withdrawn(self, generation: Generation) -> None:
        """Have the model dropped, and clear it."""
        self.models.put((self.scan, generation))
        super().model_withdrawn(generation)


class ScannerNode(ManagedNode):
    """The sensor in; every topic of the four separate nodes out."""

    def __init__(self) -> None:
        super().__init__('scanner')

    def declare_parameters_of_stage(self) -> None:
        """The settings and parameters of all that :meth:`setup` makes."""
        declare_settings(self, GROUPS, LIVE)
        declare_journal(self)
        ScanThread.declare(self)
        OdometryPublisher.declare(self)
        SensorInput.declare(self)
        IdleEnd.declare(self)

    def setup(self) -> None:
        """Make all but the lifecycle's own parameters; messages are processed once the node is active."""
        self.settings = SettingsParameters(
            self, GROUPS, LIVE, lambda new: self.frames.post(lambda: self._apply(new))
        )
        self.front_end = FrontEnd(self.settings.value, self.timer, faults=self.faults)
        self.statistics = FrameStatistics()
        self.frames = Worker(lambda: None, faults=self.faults)
        sys.setswitchinterval(SWITCH_S)
        self.paused = False
        self._scan = 0  # number of the scan that the front end is in
        self._handled = 0  # frames that it has seen
        self._frames_per_second = throughput(self.diagnostics.counts, 'received')
        warm_up()
        self._target = self.create_publisher(PointCloud2, 'target_points', qos.cloud_publisher())
        self._closures = ClosurePublisher(self)
        self.scan = _ModelHandOver(self, self.settings.value, self._counts, lambda: None, self._drained)
        self.back_end = self.scan.back_end
        follow_sensor(self, self.back_end.sensor_path)
        mean_motion = self.settings.value.motion.mean_motion
        self._odometry = OdometryPublisher(self, self.back_end.sensor_path, mean_motion)
        folder = journal_folder(self)
        self.journal = None if folder is None else self._open_journal(folder)
        self.scan_services = ScanServices(self, self.scan, lambda: forget_journals(folder))
        self.create_subscription(Bool, PAUSED_TOPIC, self._on_paused, qos.latched())
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        # the later stages are of this process: a frame that takes long is not one that was killed
        self.input = SensorInput(self, self._queue, patience_s=math.inf)
        self._answers: deque[int] = deque()  # stamps of frames that the worker has done with
        self._answered = self.create_guard_condition(self._on_answers)
        self.idle_end = IdleEnd(
            self,
            lambda: self.diagnostics.counts['received'],
            lambda: self.scan.finish_automatically(self.idle_end.done),
            self.back_end.state.silent,
        )
        self.create_timer(0.2, self.frames.check)
        self.frames.start()
        self.scan.worker.start()

    def _open_journal(self, folder: Path) -> ScannerJournal:
        """Open the journal; if it holds a scan, continue that scan."""
        journal = ScannerJournal(folder, self.front_end, self.back_end, self.settings.value.normals)
        try:
            resumed = journal.resume()
        except (KeyError, ValueError, TypeError) as error:  # written by another release
            self.get_logger().warning(f'the journal in {folder} cannot be read, a new scan begins: {error}')
            self.front_end.reset()
            journal.forget()
            resumed = False
        if resumed:
            frames, state = self.back_end.recorder.used, self.front_end.odometry.state
            self.get_logger().warning(f'restarted: continuing with {frames} frames, {state}')
            self._handled = self.back_end.recorder.taken
            if self.back_end.resumed_model:
                self.scan.worker.post(self.back_end.generate)
        return journal

    # in the executor's thread ----------------------------------------------------------------------

    def diagnostic_values(self) -> dict[str, Any]:
        """State and size of the scan."""
        values = {
            'state': self.back_end.state.value,
            'frames_per_second': self._frames_per_second(),
            'keyframes': len(self.back_end.builder.keyframes),
            'best_probability': float(self.front_end.detector.best_probability),
            'model': int(self.back_end.builder.has_model),
            'finished': int(self.back_end.ended),
            'phase': self.back_end.state.phase,
            'backlog': self.frames.backlog,
        }
        return values | self.scan.measured_values() | input_values(self.input) | self._odometry.progress

    def problem(self) -> Problem | None:
        """A silent sensor, an odd input, a journal that cannot be written, a full scan, or background."""
        silence = None if self.paused else self.input.problem()
        journal = '' if self.journal is None else self.journal.problem
        preprocessor = self.front_end.preprocessor
        warning = journal or self.front_end.odometry.full or preprocessor.background_warning
        odd = self.input.oddity(self.hints, self.front_end.rejected.total())
        return together(silence, odd, (WARN, warning), (WARN, preprocessor.unit_warning))

    @property
    def hints(self) -> tuple[str, ...]:
        """What is odd about the input, if most of its frames are of no use."""
        return given(self.input.hint, *self.front_end.hints)

    def reset_stage(self) -> None:
        """Start a new scan, once the queued frames have been processed."""
        super().reset_stage()
        self.input.reset()
        self.frames.post(self._begin)

    def close_stage(self) -> None:
        """Save the scan; without a model it counts as interrupted."""
        self.frames.stop()
        self.scan.close()
        self.diagnostics.publish()
        for worker in (self.frames, self.scan.worker):
            worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.scan.forget()
        if self.journal is not None:
            self.journal.forget()

    def _queue(self, frame: DepthFrame, frame_id: str) -> bool:
        if self.paused:
            self.diagnostics.rejected[PAUSED] += 1
            return False
        self.frames.post(lambda: self._serve(frame, frame_id))
        return True

    def _on_answers(self) -> None:
        while self._answers:
            self.input.answered(self._answers.popleft())

    def _on_paused(self, msg: Bool) -> None:
        self.paused = msg.data

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self.statistics.report(report)

    # in the frames' thread -------------------------------------------------------------------------

    def _serve(self, frame: DepthFrame, frame_id: str) -> None:
        try:
            self._process(frame, frame_id)
        finally:
            self._answers.append(frame.stamp_ns)
            self._answered.trigger()

    def _process(self, frame: DepthFrame, frame_id: str) -> None:
        if self.back_end.ended and self.scan.scan == self._scan:
            return
        self._adopt()
        self.back_end.sensor_path.sees(frame_id)
        step = self.front_end.process(frame)
        self._handled += 1
        if step.target is None or step.estimate is None:
            self.input.tell_rejected(step.why)
            return
        with self.faults.contained('what is published of a frame'):
            self._publish(step, frame_id)
        with self.faults.contained('the journal of a frame'):
            if self.journal is not None:
                self.journal.frame(step.estimate)
        self.scan.worker.post(lambda: self._hand_over(step))

    def _publish(self, step: Step, frame_id: str) -> None:
        assert step.target is not None
        assert step.estimate is not None
        target_points = target_frame_message(step.target, frame_id)
        self._odometry.publish(step.estimate, self.front_end.odometry, target_points)
        self.statistics.odometry_published(step.estimate.stamp_ns, time.time_ns())
        self.statistics.first_ns = self.statistics.first_ns or step.estimate.stamp_ns
        self._target.publish(target_points)
        self.back_end.state.odometry(step.estimate.state, step.estimate.tracked, step.estimate.submap)
        self._closures.publish(step.closures)

    def _adopt(self) -> None:
        """Track the models that the back end has handed over."""
        while not self.scan.models.empty():
            scan, generation = self.scan.models.get()
            if scan != self._scan:
                continue
            with self.faults.contained('tracking by a model'):
                try:
                    with self.timer.stage('adopt'):
                        self.front_end.adopt(generation)
                    self._odometry.model_id = _id_of(generation)
                    if self.journal is not None:
                        self.journal.adopted()
                except ValueError as error:
                    self.get_logger().warning(f'the model cannot be tracked: {error}')

    def _begin(self) -> None:
        """Forget the scan: here at once, in the back end after its queued tasks."""
        self.front_end.reset()
        self._odometry.reset()
        self.statistics.reset()
        self._handled = 0
        self._scan += 1
        if self.journal is not None:
            self.journal.restart()
        self.scan.worker.post(self.back_end.reset)

    def _apply(self, settings: Settings) -> None:
        self.front_end.configure(settings)
        self.scan.worker.post(lambda: self.back_end.configure(settings))

    # in the back end's thread ------------------------------------------------------------------------

    def _hand_over(self, step: Step) -> None:
        """Add the estimate and closures of a frame as one task, so that no model is made between them."""
        assert step.estimate is not None
        self.back_end.add(step.estimate, step.target, step.closures)

    def _drained(self) -> Callable[[], bool]:
        frames_done = self.frames.caught_up()
        return lambda: frames_done() and not self.scan.worker.backlog

    def _counts(self) -> FrameCounts:
        """Frames dropped before the back end, and timing."""
        dropped = self.diagnostics.rejected.copy()  # whole, while other threads go on counting
        rejected = self.front_end.rejected.copy()
        rejected.update(dropped)
        lost = self.input.lost
        lost += max(0, self.statistics.sent - self._handled - dropped.total() - lost)
        if lost:
            rejected[LOST_IN_TRANSPORT] += lost
        descriptions = self.front_end.detector.descriptions
        timing, units = self.statistics.timing(self.timer), self.front_end.preprocessor.unit_warning
        return FrameCounts(dict(rejected), timing, descriptions, hint=joined(*self.hints), units=units)


def _id_of(generation: Generation) -> str:
    """The name by which the model is published."""
    return '' if generation.model is None else model_id(model_message(generation.model, TIMELESS_NS, ''))


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner scanner``."""
    return run(ScannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
