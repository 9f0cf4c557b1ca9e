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

"""Node ``scanner``: all stages in one process, built on the object that scans offline.

The executor decodes and queues, one worker takes the frames from preprocessing to closures, and another
builds the models, so that no frame waits for one. As between the four processes, a frame is tracked once
the model is there: how many are scanned until then is a matter of time.
"""

import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.parameters import flatten
from debris_scanner.core.results import ScanResult
from debris_scanner.modelling.model_builder import Generation
from debris_scanner.nodes.inputs.sensor_input import LOST_IN_TRANSPORT, SensorInput, input_values
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import TOPIC, WARN, Problem, read_reports, throughput
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import PAUSED_TOPIC
from debris_scanner.nodes.lifecycle.worker import Worker
from debris_scanner.nodes.publishing.closure_publisher import ClosurePublisher
from debris_scanner.nodes.publishing.odometry_publisher import OdometryPublisher
from debris_scanner.nodes.recovery.catching_up import forget_journals, journal_folder
from debris_scanner.nodes.recovery.scanner_journal import ScannerJournal
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.idle_end import IdleEnd
from debris_scanner.nodes.scan.scan_building import ScanBuilding
from debris_scanner.nodes.scan.scan_state import ScanState
from debris_scanner.nodes.scan.services import ScanServices
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.target_frames import target_frame_message

MOST_WAITING = 200  # frames: 20 seconds of a 10 Hz sensor, 250 MB of depth
LIVE = ('isolation', 'odometry', 'closure', 'closure_search', 'verification', 'fusion', 'verdict')
PAUSED, QUEUE_FULL = 'paused', 'queue_full'
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
        self.scanner = Scanner(self.settings.value, timer=self.timer)
        self.statistics = FrameStatistics()
        self.frames = Worker(lambda: None)
        sys.setswitchinterval(SWITCH_S)
        self.paused = False
        self._frames_per_second = throughput(self.diagnostics.counts, 'received')
        warm_up()
        self.state = ScanState(self)
        self._target = self.create_publisher(PointCloud2, 'target_points', qos.cloud_publisher())
        self._odometry = OdometryPublisher(self)
        self._closures = ClosurePublisher(self)
        self.building = ScanBuilding(self, self.scanner, self.frames, self.state, self._result)
        folder = journal_folder(self)
        self.journal = None if folder is None else self._open_journal(folder)
        self.scan_services = ScanServices(
            self, self.building.worker, self.building, lambda: forget_journals(folder)
        )
        self.create_subscription(Bool, PAUSED_TOPIC, self._on_paused, qos.latched())
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.input = SensorInput(self, self._queue)
        self.idle_end = IdleEnd(
            self,
            lambda: self.diagnostics.counts['received'],
            lambda: self.building.finish_unasked(self.idle_end.done),
        )
        for worker in (self.frames, self.building.worker):
            self.create_timer(0.2, worker.check)
            worker.start()

    def _open_journal(self, folder: Path) -> ScannerJournal:
        """The journal; where it tells of a scan, that scan goes on."""
        scanner, building = self.scanner, self.building
        normals = self.settings.value.normals
        journal = ScannerJournal(folder, scanner, building.builder, normals)
        try:
            resumed = journal.resume()
        except (KeyError, ValueError, TypeError) as error:  # of another release
            self.get_logger().warning(f'the journal in {folder} cannot be read, a new scan begins: {error}')
            scanner.reset()
            journal.restart()
            journal.restart_models()
            resumed = False
        building.journal = journal
        if resumed:
            frames, state = len(scanner.recorder.odometry), scanner.odometry.state
            self.get_logger().warning(f'started anew: going on with {frames} frames, {state}')
            building.resume(journal.ended)
        return journal

    # in the executor's thread ----------------------------------------------------------------------

    def diagnostic_values(self) -> dict[str, Any]:
        """State and size of the scan."""
        builder = self.building.builder
        return {
            'state': self.state.value,
            'frames_per_second': self._frames_per_second(),
            'keyframes': len(builder.keyframes),
            'best_probability': float(self.scanner.detector.best_probability),
            'model': int(builder.last is not None and builder.last.model is not None),
            'finished': int(self.building.ended),
            'backlog': self.frames.backlog,
        } | input_values(self.input)

    def problem(self) -> Problem | None:
        """Silence of the sensor, a journal that cannot be written, no room for key frames, or background."""
        silence = None if self.paused else self.input.problem()
        unkept = '' if self.journal is None else self.journal.problem
        amiss = unkept or self.scanner.odometry.full or self.scanner.preprocessor.remnant
        return silence or ((WARN, amiss) if amiss else None)

    def reset_stage(self) -> None:
        """A new scan, once the frames that wait have been dealt with."""
        super().reset_stage()
        self.input.reset()
        self.frames.post(self._begin)

    def close_stage(self) -> None:
        """Save what was gathered; without a model the scan counts as interrupted."""
        self.frames.stop()
        self.building.close()
        self.diagnostics.publish()
        for worker in (self.frames, self.building.worker):
            worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.building.publisher.clear()
        if self.journal is not None:
            self.journal.restart()
            self.journal.restart_models()

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
                self.statistics.report(report)

    # in the frames' thread -------------------------------------------------------------------------

    def _process(self, frame: DepthFrame, frame_id: str) -> None:
        if self.building.ended:
            return
        self._adopt()
        tracked = self.scanner.odometry.model is not None
        step = self.scanner.process(frame)
        if step.target is None or step.estimate is None:
            return
        target_points = target_frame_message(step.target, frame_id)
        said = self._odometry.publish(step.estimate, self.scanner.odometry, tracked, target_points)
        self.statistics.odometry_published(step.estimate.stamp_ns, time.time_ns())
        self._target.publish(target_points)
        self.statistics.first_ns = self.statistics.first_ns or step.estimate.stamp_ns
        self.state.odometry(step.estimate.state, tracked)
        self._closures.publish(step.closures)
        note = None
        if (journal := self.journal) is not None:
            journal.frame(step.estimate)
            note = partial(journal.taken, *said, step.target, step.closures)
        self.building.hand_over(note)
        if any(c.accepted for c in step.closures):
            self.building.closed()

    def _adopt(self) -> None:
        """Track the models that have come."""
        while (generation := self.building.new_model()) is not None and generation.model is not None:
            try:
                with self.timer.stage('adopt'):
                    self.scanner.odometry.adopt_model(generation.model, generation.poses)
                if self.journal is not None:
                    self.journal.adopted()
            except ValueError as error:
                self.get_logger().warning(f'the model cannot be tracked: {error}')

    def _begin(self) -> None:
        self.scanner.reset()
        self.statistics.reset()
        self._odometry.reset()
        if self.journal is not None:
            self.journal.restart()
        self.building.begin()

    def _apply(self, settings: Settings) -> None:
        scanner = self.scanner
        scanner.preprocessor.configure(settings.isolation)
        scanner.odometry.settings = settings.odometry
        scanner.detector.settings, scanner.detector.search = settings.closure, settings.closure_search
        scanner.detector.verification = settings.verification
        builder = self.building.builder
        builder.fusion, builder.verdict = settings.fusion, settings.verdict

    def _result(self, generation: Generation, interrupted: str | None = None) -> ScanResult:
        """The scanner's result with what was dropped before it, and how late its odometry was."""
        result = self.scanner.result(generation, interrupted)
        dropped = dict(self.diagnostics.rejected)
        known = result.frames_read + sum(dropped.values()) + self.input.lost
        lost = self.input.lost + max(0, self.statistics.sent - known)
        if lost:
            dropped[LOST_IN_TRANSPORT] = lost
        result.frames_rejected = result.frames_rejected | dropped
        result.frames_read += sum(dropped.values())
        result.timing = self.statistics.timing(self.timer)
        return result


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner scanner``."""
    return run(ScannerNode, args)


if __name__ == '__main__':
    sys.exit(main())
