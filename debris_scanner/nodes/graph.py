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

"""Node ``graph``: collects frames and closures, generates the model, publishes it and saves the scan.

The executor only queues messages. One worker processes them, so that a generation that takes seconds blocks
no callback.
"""

import sys
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.memory import Housekeeping
from debris_scanner.io.scan_journal import ScanJournal
from debris_scanner.nodes.inputs.sensor_odometry import follow_sensor
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import (
    ERROR,
    HINT,
    TOPIC,
    UNITS,
    WARN,
    Problem,
    read_reports,
    together,
)
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters, declare_settings
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.publishing.closure_publisher import read_candidates
from debris_scanner.nodes.publishing.estimates import FrameStatus, read_status
from debris_scanner.nodes.publishing.odometry_publisher import JOURNAL_TOPIC
from debris_scanner.nodes.recovery.catching_up import (
    MissedClouds,
    declare_journal,
    forget_journals,
    journal_folder,
)
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.idle_end import IdleEnd
from debris_scanner.nodes.scan.joining import (
    BUSY_PATIENCE_S,
    NEW,
    PATIENCE_S,
    STALE,
    ClosureJoin,
    FrameJoin,
    JoinedFrame,
    ScanIdentity,
)
from debris_scanner.nodes.scan.scan_thread import ScanThread
from debris_scanner.nodes.scan.services import ScanServices
from debris_scanner.recorder import FrameCounts
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import read_closure
from msg_adapters.stamps import read_stamp

SETTINGS = ('builder', 'pose_graph', 'fusion', 'verdict', 'normals', 'motion', 'descriptor')
LIVE = ('fusion', 'verdict')
MOST_WAITING = 900  # messages, some 300 frames


class GraphNode(ManagedNode):
    """The topics of the other stages in; ``model``, ``model_mesh``, ``keyframe_poses``, ``state`` out."""

    def __init__(self) -> None:
        super().__init__('graph')

    def declare_parameters_of_stage(self) -> None:
        """The settings and parameters of all that :meth:`setup` makes."""
        declare_settings(self, SETTINGS, LIVE)
        declare_journal(self)
        ScanThread.declare(self)
        IdleEnd.declare(self)

    def setup(self) -> None:
        """Make all but the lifecycle's own parameters; messages are processed once the node is active."""
        self.settings = SettingsParameters(self, SETTINGS, live=LIVE, apply=self._apply)
        folder = journal_folder(self)
        self.statistics = FrameStatistics(folder)
        self._frame_join = FrameJoin(lambda status: status.accepted)
        self._closure_join = ClosureJoin(self._complain)
        self._identity = ScanIdentity()
        self._housekeeping = Housekeeping()
        self._taken_ns = 0  # stamp of the latest status
        self.scan = ScanThread(
            self, self.settings.value, self._counts, self._join, lambda: self._is_drained, nice=5
        )
        self.back_end, self.worker = self.scan.back_end, self.scan.worker
        follow_sensor(self, self.back_end.sensor_path)
        self.back_end.descriptor = self.settings.value.descriptor
        warm_up()
        published = self.scan.publisher
        self.diagnostics.expect_subscribers(model=published.model, keyframe_poses=published.poses)
        self.scan_services = ScanServices(self, self.scan, lambda: forget_journals(folder))
        # after a restart the publishers send the messages again that this node missed
        resumed = folder is not None and self._resume(folder)
        profile = qos.kept() if resumed else qos.waiting()
        self._statuses = self.receive(DiagnosticArray, 'odometry_status', self._on_status, profile)
        self._frames = self.receive(PointCloud2, 'target_points', self._on_cloud, qos.waiting())
        self.receive(PointCloud2, 'keyframe_points', self._on_keyframe, qos.waiting())
        self.receive(OdometryMessage, 'odometry', self._on_odometry, qos.waiting())
        if resumed:
            self.receive(OdometryMessage, JOURNAL_TOPIC, self._on_missed_odometry, profile)
        self.receive(DiagnosticArray, 'closure_candidates', self._on_candidates, profile)
        self.receive(TransformStamped, 'closures', self._on_closure, profile)
        self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.idle_end = IdleEnd(
            self,
            self._frames_received,
            lambda: self.scan.finish_automatically(self.idle_end.done),
            self.back_end.state.silent,
        )
        self.worker.start()

    def _resume(self, folder: Path) -> bool:
        """Open the journal; whether it holds a scan, which is then continued."""
        normals = self.settings.value.normals
        journal = ScanJournal(folder, normals)
        if not self.back_end.resume(journal):
            return False
        assert journal.last_stamp_ns is not None
        self._identity.of(journal.last_scan_ns)
        self._taken_ns = journal.last_stamp_ns
        self.get_logger().warning(f'restarted: continuing with {self.back_end.recorder.used} frames')
        if self.back_end.resumed_model:
            self.worker.post(self.back_end.generate)
        if not self.back_end.ended:
            MissedClouds(self, folder, normals, self._taken_ns, self._on_cloud)
        return True

    # in the executor's thread ----------------------------------------------------------------------

    def diagnostic_values(self) -> dict[str, Any]:
        """State and size of the scan."""
        return {
            'state': self.back_end.state.value,
            'keyframes': len(self.back_end.builder.keyframes),
            'frames': self.back_end.recorder.used,
            'model': int(self.back_end.builder.has_model),
            'finished': int(self.back_end.ended),
            'phase': self.back_end.state.phase,
            'backlog': self.worker.backlog,
            'count.lost': self._statuses.lost + self._frames.lost,
        } | self.scan.measured_values()

    def problem(self) -> Problem | None:
        """Files that cannot be written, or a generation without a model."""
        journal, last = self.back_end.journal, self.back_end.builder.last
        return together(
            (ERROR, self.back_end.output.problem),
            (WARN, '' if journal is None else journal.problem),
            (WARN, f'{last.reason}: {last.why}' if last is not None and last.reason else ''),
        )

    def reset_stage(self) -> None:
        """Start a new scan; messages of the old one that still arrive are ignored."""
        super().reset_stage()
        self.worker.post(self._reset)

    def close_stage(self) -> None:
        """Save the scan; without a model it counts as interrupted."""
        self.scan.close()
        self.diagnostics.publish()
        self.worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.scan.forget()

    def _frames_received(self) -> int:
        report = self.statistics.reports.get('preprocess')
        return 0 if report is None else report.counts.get('received', 0)

    def _on_status(self, msg: DiagnosticArray, _published_ns: int) -> None:
        try:
            status = read_status(msg)
        except MalformedMessage as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        self.back_end.state.odometry(status.state, status.tracked, status.submap)
        self.worker.post(lambda: self._take_status(status))

    def _on_cloud(self, msg: PointCloud2, _published_ns: int) -> None:
        self.back_end.sensor_path.sees(msg.header.frame_id)
        if self.back_end.ended:
            return
        if self.worker.backlog < MOST_WAITING:
            self.worker.post(lambda: self._frame_join.add_cloud(msg))
        else:  # bounds memory while a large model is made: of these frames the poses alone are kept
            stamp_ns = read_stamp(msg.header.stamp)
            self.worker.post(lambda: self._frame_join.drop_cloud(stamp_ns))

    def _on_keyframe(self, msg: PointCloud2, _published_ns: int) -> None:
        if not self.back_end.ended:  # however many wait: nothing replaces a key frame
            self.worker.post(lambda: self._frame_join.add_cloud(msg))

    def _on_odometry(self, msg: OdometryMessage, published_ns: int) -> None:
        self.statistics.odometry_published(read_stamp(msg.header.stamp), published_ns)
        if not self.back_end.ended:
            self.worker.post(lambda: self._frame_join.add_odometry(msg))

    def _on_missed_odometry(self, msg: OdometryMessage, _published_ns: int) -> None:
        if not self.back_end.ended:
            self.worker.post(lambda: self._frame_join.add_odometry(msg))

    def _on_candidates(self, msg: DiagnosticArray, _published_ns: int) -> None:
        try:
            records = read_candidates(msg)
        except MalformedMessage as error:
            self._complain(str(error))
            return
        self.worker.post(lambda: self.back_end.add_hypotheses(self._closure_join.add_records(records)))

    def _on_closure(self, msg: TransformStamped, _published_ns: int) -> None:
        now_s = time.monotonic()
        try:
            closure = read_closure(msg)
        except MalformedMessage as error:
            self._complain(str(error))
            return
        self.worker.post(lambda: self._closure_join.add(closure, now_s))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self.statistics.report(report)

    def _complain(self, text: str) -> None:
        """Log a malformed message, throttled: a flood of them must not fill the disk."""
        self.get_logger().warning(text, throttle_duration_sec=1.0)

    # in the worker's thread ------------------------------------------------------------------------

    def _take_status(self, status: FrameStatus) -> None:
        """Queue the status of a frame; its pose and cloud come on other topics."""
        scan = self._identity.of(status.scan_ns)
        if scan == NEW and self.back_end.recorder.rates:
            self.get_logger().warning('odometry began a new scan: this node does, too')
            self._begin()
        if self.back_end.ended or scan == STALE or status.stamp_ns <= self._taken_ns:
            return
        self._taken_ns = status.stamp_ns
        self._frame_join.add_status(status, time.monotonic())

    def _join(self) -> None:
        """After every message: process the frames and closures that are complete."""
        self._housekeeping.look()
        now_s = time.monotonic()
        patience_s = BUSY_PATIENCE_S if self.worker.backlog else PATIENCE_S
        for joined in self._frame_join.pop(now_s, patience_s):
            self._take_frame(joined)
        known = self.back_end.builder.graph.keyframes.index
        for closure, since_s in self._closure_join.pop(known, now_s, patience_s):
            with self.faults.contained('a closure'):
                self.back_end.add_closure(closure, since_s)

    def _take_frame(self, joined: JoinedFrame) -> None:
        self.statistics.first_ns = self.statistics.first_ns or joined.status.stamp_ns
        with self.faults.contained('a frame', self.back_end.recorder.rejected):
            try:
                self.back_end.add(*joined.decode())
            except MalformedMessage as error:
                self.statistics.incomplete += 1
                self._complain(str(error))

    def _is_drained(self) -> bool:
        """Whether every message has been processed."""
        return not (self.worker.backlog or len(self._frame_join) or len(self._closure_join))

    def _reset(self) -> None:
        if self._identity.reset():
            self._begin()

    def _begin(self) -> None:
        self._frame_join.restart()
        self._closure_join.restart()
        self.statistics.reset()
        self._taken_ns = 0
        self.back_end.reset()

    def _counts(self) -> FrameCounts:
        s = self.statistics
        rejected = s.rejected(self.back_end.recorder.taken, self._statuses.lost)
        hint, units = s.told(HINT), s.told(UNITS)
        return FrameCounts(rejected, s.timing(self.timer), errors=s.errors, hint=hint, units=units)

    def _apply(self, settings: Settings) -> None:
        self.worker.post(lambda: self.back_end.configure(settings))


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner graph``."""
    return run(GraphNode, args)


if __name__ == '__main__':
    sys.exit(main())
