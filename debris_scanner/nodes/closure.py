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

"""Node ``closure``: compares every key frame with all earlier ones, and publishes loop closures."""

import sys
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.frames import KeyFrame
from debris_scanner.io.journal import StateSlot
from debris_scanner.io.odometry_journal import read_scan_keyframes
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters, declare_settings
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.publishing.closure_publisher import ClosurePublisher
from debris_scanner.nodes.publishing.estimates import FrameStatus, read_status
from debris_scanner.nodes.recovery.catching_up import CatchingUp, declare_journal, journal_folder
from debris_scanner.nodes.scan.joining import NEW, STALE, FrameJoin, JoinedFrame, ScanIdentity
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector
from debris_scanner.warm_up import warm_up
from msg_adapters.errors import MalformedMessage

SETTINGS = ('closure', 'closure_search', 'descriptor', 'verification', 'normals')
LIVE = ('closure', 'closure_search', 'verification')
MARK = 'closure.state'  # the last key frame whose hypotheses were published


def wants_cloud(status: FrameStatus) -> bool:
    """Whether a frame needs its cloud: key frames do, until a model is tracked."""
    return status.keyframe and not status.tracked


class ClosureNode(ManagedNode):
    """``keyframe_points``, ``odometry``, ``odometry_status`` in; ``closures``, ``closure_candidates`` out."""

    def __init__(self) -> None:
        super().__init__('closure')

    def declare_parameters_of_stage(self) -> None:
        """The settings and parameters of all that :meth:`setup` makes."""
        declare_settings(self, SETTINGS, LIVE)
        declare_journal(self)

    def setup(self) -> None:
        """Make all but the lifecycle's own parameters; messages are processed once the node is active."""
        self.settings = SettingsParameters(self, SETTINGS, LIVE, self._apply)
        self.detector = make_closure_detector(self.settings.value, self.timer)
        self._identity = ScanIdentity()
        self._join = FrameJoin(wants_cloud)
        warm_up('closure')
        self._publisher = ClosurePublisher(self)
        self.diagnostics.expect_subscribers(
            closures=self._publisher.closures, closure_candidates=self._publisher.candidates
        )
        self.offer_reset()
        folder = journal_folder(self)
        self._mark = None if folder is None else StateSlot(folder / MARK)
        self._outage = None if folder is None else self._resume(folder)
        self.receive(DiagnosticArray, 'odometry_status', self._on_status, qos.waiting())
        self.receive(OdometryMessage, 'odometry', self._on_odometry, qos.waiting())
        self._keyframes = self.receive(PointCloud2, 'keyframe_points', self._on_keyframe, qos.waiting())
        self.create_timer(0.5, self._advance)  # times out frames of which a message was lost

    def diagnostic_values(self) -> dict[str, Any]:
        """Number of key frames, and the best probability of the newest."""
        return {
            'keyframes': len(self.detector.keyframes),
            'best_probability': float(self.detector.best_probability),
            'count.lost': self._keyframes.lost,
        }

    def teardown(self) -> None:
        """Forget the scan."""
        self._forget()

    def reset_stage(self) -> None:
        """Forget all key frames."""
        super().reset_stage()
        if self._identity.reset():
            self._forget()

    def _forget(self) -> None:
        self.detector.reset()
        self._join.restart()
        if self._outage is not None:
            self._outage.cancel()
            self._outage = None
        if self._mark is not None:
            self._mark.restart()

    def _resume(self, folder: Path) -> CatchingUp | None:
        """Describe again, from odometry's journal, the key frames up to the mark; later ones were missed."""
        mark = StateSlot.read(folder / MARK)
        if mark is None:
            return None
        normals = self.settings.value.normals
        done_ns = int(mark.values['stamp_ns'])
        for keyframe in read_scan_keyframes(folder, 0, normals):
            if keyframe.stamp_ns <= done_ns:
                self.detector.remember(keyframe)
        frames = self.detector.keyframes.frames
        if not frames:
            return None
        self._identity.of(frames[0].stamp_ns)
        self.get_logger().warning(f'restarted: continuing with {len(frames)} key frames')
        return CatchingUp(self, lambda: read_scan_keyframes(folder, frames[-1].stamp_ns, normals), self._add)

    def _on_status(self, msg: DiagnosticArray, _published_ns: int) -> None:
        try:
            status = read_status(msg)
        except MalformedMessage as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        scan = self._identity.of(status.scan_ns)
        if scan == NEW:  # odometry has begun a new scan
            self._forget()
        if scan != STALE:
            self._join.add_status(status, time.monotonic())
        self._advance()

    def _on_odometry(self, msg: OdometryMessage, _published_ns: int) -> None:
        self._join.add_odometry(msg)
        self._advance()

    def _on_keyframe(self, msg: PointCloud2, _published_ns: int) -> None:
        self.diagnostics.counts['received'] += 1
        self._join.add_cloud(msg)
        self._advance()

    def _advance(self) -> None:
        if self._outage is not None and not self._outage.done:
            return
        for joined in self._join.pop(time.monotonic()):
            if wants_cloud(joined.status):
                self._add_joined(joined)

    def _add_joined(self, joined: JoinedFrame) -> None:
        try:
            with self.timer.stage('receive'):
                estimate, _ = joined.decode()
        except MalformedMessage as error:
            self.diagnostics.rejected['malformed_keyframe'] += 1
            self.get_logger().warning(f'key frame rejected: {error}', throttle_duration_sec=1.0)
            return
        keyframe = estimate.keyframe
        assert keyframe is not None
        if keyframe.stamp_ns not in self.detector.keyframes.index:  # else it was read from the journal
            self._add(keyframe)

    def _add(self, keyframe: KeyFrame) -> None:
        with self.faults.contained('the closure search of a key frame'):
            self._publisher.publish(self.detector.add(keyframe))
        if self._mark is not None:
            self._mark.write('described', {'stamp_ns': keyframe.stamp_ns})

    def _apply(self, settings: Settings) -> None:
        detector = self.detector
        detector.configure(settings.closure, settings.closure_search, settings.verification)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner closure``."""
    return run(ClosureNode, args)


if __name__ == '__main__':
    sys.exit(main())
