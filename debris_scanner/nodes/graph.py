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

"""Node ``graph``: keeps frames and closures, generates the model, publishes it and saves the scan.

The executor only queues what comes; one worker does the work, so a generation of seconds stops nothing.
"""

import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, TOPIC, WARN, Problem, read_reports
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.publishing.estimates import read_verdict
from debris_scanner.nodes.recovery.catching_up import forget_journals, journal_folder
from debris_scanner.nodes.scan.frame_statistics import FrameStatistics
from debris_scanner.nodes.scan.graph_scan import GraphScan
from debris_scanner.nodes.scan.idle_end import IdleEnd
from debris_scanner.nodes.scan.services import ScanServices
from debris_scanner.settings import Settings
from debris_scanner.warm_up import warm_up
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import read_stamp

SETTINGS = ('builder', 'pose_graph', 'fusion', 'verdict', 'normals', 'motion')
LIVE = ('fusion', 'verdict')
MOST_WAITING = 900  # messages, some 300 frames


class GraphNode(ManagedNode):
    """Everything the other nodes publish in; ``model``, ``model_mesh``, ``keyframe_poses``, ``state`` out."""

    def __init__(self) -> None:
        super().__init__('graph')

    def setup(self) -> None:
        """Everything beside parameters of the lifecycle; takes messages once the node is active."""
        self.settings = SettingsParameters(self, SETTINGS, live=LIVE, apply=self._apply)
        self.statistics = FrameStatistics()
        self.scan = GraphScan(self, self.settings.value, self.statistics, lambda: self._verdicts.lost)
        self.worker = self.scan.worker
        warm_up()
        folder = journal_folder(self)
        published = self.scan.publisher
        self.diagnostics.expect_subscribers(model=published.model, keyframe_poses=published.poses)
        self.scan_services = ScanServices(self, self.worker, self.scan, lambda: forget_journals(folder))
        # what was said while this node was away is said again to it
        normals = self.settings.value.normals
        resumed = folder is not None and self.scan.resume(folder, normals, self._on_cloud)
        heard = qos.kept() if resumed else qos.waiting()
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
            'state': self.scan.state.value,
            'keyframes': len(self.scan.stage.builder.keyframes),
            'frames': self.statistics.used,
            'model': int(self.scan.stage.generated),
            'finished': int(self.scan.ended),
            'backlog': self.worker.backlog,
            'count.lost': self._verdicts.lost + self._frames.lost,
        }

    def problem(self) -> Problem | None:
        """Files that could not be written, or a generation that was refused."""
        if failed := self.scan.output.problem:
            return ERROR, failed
        if failed := self.scan.journal_problem:
            return WARN, failed
        last = self.scan.stage.builder.last
        return (WARN, f'{last.reason}: {last.why}') if last is not None and last.reason else None

    def reset_stage(self) -> None:
        """A new scan: what is still on its way from the old one is passed over."""
        super().reset_stage()
        self.worker.post(self.scan.reset)

    def close_stage(self) -> None:
        """Save what was gathered; without a model the scan counts as interrupted."""
        if not self.scan.ended:
            self.worker.post(self.scan.save_interrupted)
        self.worker.stop()
        self.diagnostics.publish()
        self.worker.check()

    def teardown(self) -> None:
        """Save, and forget the scan."""
        self.close_stage()
        self.scan.forget()

    def _frames_received(self) -> int:
        report = self.statistics.reports.get('preprocess')
        return 0 if report is None else report.counts.get('received', 0)

    def _finish_unasked(self) -> None:
        self.worker.post(lambda: self.get_logger().info(self.scan.finish(None)[1]))
        self.worker.post(self.idle_end.done)

    def _on_verdict(self, msg: DiagnosticArray, _published_ns: int) -> None:
        try:
            verdict = read_verdict(msg)
        except MalformedMessage as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        self.scan.state.odometry(verdict.state, verdict.tracked)
        self.worker.post(lambda: self.scan.take_verdict(verdict))

    def _on_cloud(self, msg: PointCloud2, _published_ns: int) -> None:
        # when generations take longer than they should, memory must not pay for it
        if not self.scan.ended and self.worker.backlog < MOST_WAITING:
            self.worker.post(lambda: self.scan.join.add_cloud(msg))

    def _on_odometry(self, msg: OdometryMessage, published_ns: int) -> None:
        self.statistics.odometry_published(read_stamp(msg.header.stamp), published_ns)
        if not self.scan.ended:
            self.worker.post(lambda: self.scan.join.add_odometry(msg))

    def _on_candidates(self, msg: DiagnosticArray, _published_ns: int) -> None:
        self.worker.post(lambda: self.scan.stage.add_candidates(msg))

    def _on_closure(self, msg: TransformStamped, _published_ns: int) -> None:
        self.worker.post(lambda: self.scan.stage.add_closure(msg))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.namespace == self.get_namespace():
                self.statistics.report(report)

    def _apply(self, settings: Settings) -> None:
        self.scan.stage.builder.fusion, self.scan.stage.builder.verdict = settings.fusion, settings.verdict


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner graph``."""
    return run(GraphNode, args)


if __name__ == '__main__':
    sys.exit(main())
