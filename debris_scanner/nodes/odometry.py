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

"""Node ``odometry``: publishes the target's pose, rates and key frames; later tracks the model."""

import sys
import time
from pathlib import Path as FolderPath
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.stamps import MonotonicStamps
from debris_scanner.io.odometry_journal import OdometryJournal
from debris_scanner.io.recent_frames import read_recent
from debris_scanner.nodes.inputs.sensor_odometry import follow_sensor
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import WARN, Problem, throughput, together
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.parameters import SettingsParameters, declare_settings
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.publishing.odometry_publisher import OdometryPublisher
from debris_scanner.nodes.recovery.catching_up import CatchingUp, declare_journal, journal_folder
from debris_scanner.settings import Settings
from debris_scanner.stages import make_odometry
from debris_scanner.tracking.odometry import LOST, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath
from debris_scanner.warm_up import warm_up
from msg_adapters.errors import MalformedMessage
from msg_adapters.models import fingerprint, model_id, read_depth_offset, read_model
from msg_adapters.poses import read_path
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import read_target_frame, target_frame_message

GROUPS, LIVE = ('odometry', 'motion', 'normals'), ('odometry',)


class OdometryNode(ManagedNode):
    """``target_points`` in; ``odometry``, its status, ``target_pose``, ``keyframe_points`` and TF out."""

    def __init__(self) -> None:
        super().__init__('odometry')

    def declare_parameters_of_stage(self) -> None:
        """The settings and parameters of all that :meth:`setup` makes."""
        declare_settings(self, GROUPS, LIVE)
        declare_journal(self)
        OdometryPublisher.declare(self)

    def setup(self) -> None:
        """Make all but the lifecycle's own parameters; messages are processed once the node is active."""
        self.settings = SettingsParameters(self, GROUPS, LIVE, self._apply)
        self.odometry = make_odometry(self.settings.value, self.timer)
        self._last_ns = self._resumed_ns = 0
        self._stamps = MonotonicStamps()
        self._outage: CatchingUp | None = None
        self._model: PointCloud2 | None = None
        self._poses: Path | None = None
        self._offset: PointCloud2 | None = None
        self._rate = throughput(self.diagnostics.counts, 'received')
        warm_up('odometry')
        self._sensor_path = SensorPath()
        follow_sensor(self, self._sensor_path)
        self._folder = journal_folder(self)
        self._publisher = OdometryPublisher(
            self,
            self._sensor_path,
            self.settings.value.motion.mean_motion,
            journal=self._folder is not None,
        )
        self.diagnostics.expect_subscribers(
            2,  # closure and graph
            odometry_status=self._publisher.status,
            keyframe_points=self._publisher.keyframes,
        )
        self.diagnostics.expect_subscribers(3, odometry=self._publisher.odometry)  # and preprocess
        self.create_subscription(PointCloud2, 'model', self._on_model, qos.latched())
        self.create_subscription(Path, 'keyframe_poses', self._on_poses, qos.latched())
        self.create_subscription(PointCloud2, 'depth_offset', self._on_offset, qos.latched())
        self.offer_reset()
        self._journal = None if self._folder is None else self._open_journal(self._folder)
        self._frames = self.receive(PointCloud2, 'target_points', self._on_frame, qos.recent())

    def diagnostic_values(self) -> dict[str, Any]:
        """State, rate and key frames."""
        motion = self.odometry.filter
        speed = 0.0 if motion is None else float(np.linalg.norm(motion.omega))
        return {
            'state': self.odometry.state,
            'frames_per_second': self._rate(),
            'keyframes': len(self.odometry.keyframes),
            'rate_rad_s': round(speed, 4),
            'count.lost': self._frames.lost,
        } | self._publisher.progress

    def problem(self) -> Problem | None:
        """A lost target, a journal that cannot be written, or no room for key frames."""
        journal = '' if self._journal is None else self._journal.problem
        lost = 'the target is lost' if self.odometry.state == LOST else ''
        return together(*((WARN, text) for text in (journal, lost, self.odometry.full)))

    def teardown(self) -> None:
        """Forget the scan."""
        self.reset_stage()

    def reset_stage(self) -> None:
        """The next frame is the first key frame of a new scan."""
        super().reset_stage()
        self.odometry.reset()
        self._model = self._poses = self._offset = None
        self._publisher.reset()
        self._last_ns = 0
        self._stamps.reset()
        if self._outage is not None:
            self._outage.cancel()
            self._outage = None
        if self._journal is not None:
            self._journal.restart()

    def _open_journal(self, folder: FolderPath) -> OdometryJournal:
        """Open the journal; if it holds a scan, continue that scan."""
        journal = OdometryJournal(folder, self.settings.value.normals)
        try:
            resumed = journal.resume(self.odometry)
        except (KeyError, ValueError, TypeError) as error:  # written by another release
            self.get_logger().warning(f'the journal in {folder} cannot be read, a new scan begins: {error}')
            self.odometry.reset()
            resumed = False
        if not resumed:
            journal.restart()
            return journal
        self._last_ns = journal.stamp_ns
        self._outage = CatchingUp(self, lambda: self._missed(folder), self._take_missed)
        self.get_logger().warning(
            f'restarted: continuing with {len(self.odometry.keyframes)} key frames, {self.odometry.state}'
        )
        return journal

    def _missed(self, folder: FolderPath) -> list[tuple[TargetFrame, str]]:
        return read_recent(folder, self._last_ns, self.settings.value.normals)

    def _take_missed(self, missed: tuple[TargetFrame, str]) -> None:
        frame, frame_id = missed
        self.diagnostics.counts['received'] += 1
        self._last_ns = self._resumed_ns = frame.stamp_ns
        self._process(frame, target_frame_message(frame, frame_id))

    def _on_frame(self, msg: PointCloud2, _published_ns: int) -> None:
        if self._outage is not None:
            if not self._outage.done or read_stamp(msg.header.stamp) <= self._resumed_ns:
                return  # it is read from disk, in order
            self._outage = None
        self.diagnostics.counts['received'] += 1
        try:
            with self.timer.stage('receive'):
                frame = read_target_frame(msg)
        except MalformedMessage as error:
            self.diagnostics.rejected['malformed_target'] += 1
            self.get_logger().warning(f'target frame rejected: {error}', throttle_duration_sec=5.0)
            return
        # preprocess sends no such frame: another node publishes, too
        follows = self._stamps.follows(frame.stamp_ns, time.monotonic())
        if not follows or (self._last_ns and frame.stamp_ns <= self._last_ns):
            self.diagnostics.rejected['non_monotone_stamp'] += 1
            return
        self._last_ns = frame.stamp_ns
        self._process(frame, msg)

    def _process(self, frame: TargetFrame, msg: PointCloud2) -> None:
        self._sensor_path.sees(msg.header.frame_id)
        submap = self.odometry.submap
        with self.faults.contained('a frame', self.diagnostics.rejected):
            self._publish(self.odometry.process(frame), submap, msg)

    def _publish(self, estimate: OdometryEstimate, submap: int, msg: PointCloud2) -> None:
        """Publish the estimate of a frame; ``submap`` is the one before it."""
        if self._journal is not None:
            self._journal.note(self.odometry, estimate)
        if self.odometry.submap != submap:
            self.get_logger().warning(
                'a new submap begins: the target was lost, or the key frames were partially occluded'
            )
        if estimate.ambiguous:
            self.get_logger().warning('relocalized, but another attitude fits the frame as well')
        self._publisher.publish(estimate, self.odometry, msg)
        self.diagnostics.counts['published'] += 1

    def _on_model(self, msg: PointCloud2) -> None:
        self._model = msg
        self._adopt()

    def _on_poses(self, msg: Path) -> None:
        self._poses = msg
        self._adopt()

    def _on_offset(self, msg: PointCloud2) -> None:
        self._offset = msg
        self._adopt()

    def _adopt(self) -> None:
        """Track a model once its cloud, the poses of its key frames and the offset have all arrived."""
        model, poses, offset = self._model, self._poses, self._offset
        if model is None or poses is None or offset is None:
            return
        named = fingerprint(model)  # see ModelPublisher
        if not named == read_stamp(poses.header.stamp) == read_stamp(offset.header.stamp):
            return
        self._model = self._poses = self._offset = None
        if not model.width:  # a reset clears the old model, and so does the back end where it is a wrong one
            if self.odometry.model is not None:
                self.odometry.drop_model()
                self.get_logger().warning('the model is given up, scanning on without it')
                if self._journal is not None:
                    self._journal.adopted(self.odometry)
            return
        try:
            with self.timer.stage('adopt'):
                self.odometry.adopt_model(
                    read_model(model), dict(read_path(poses)), read_depth_offset(offset)
                )
                if self._journal is not None:
                    self._journal.adopted(self.odometry)
        except (MalformedMessage, ValueError) as error:
            self.get_logger().warning(f'the model cannot be tracked: {error}')
            return
        self._publisher.model_id = model_id(model)
        frame_id = self._publisher.frames.target
        self.get_logger().info(f'tracking a model of {model.width} points in frame {frame_id!r}')

    def _apply(self, settings: Settings) -> None:
        self.odometry.settings = settings.odometry


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner odometry``."""
    return run(OdometryNode, args)


if __name__ == '__main__':
    sys.exit(main())
