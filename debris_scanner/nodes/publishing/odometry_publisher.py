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

"""Topics of the odometry: ``odometry``, its status, ``target_pose``, ``keyframe_points``, forecasts, TF."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.core.turn import TurnWatch
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.publishing.detection_publisher import DetectionPublisher
from debris_scanner.nodes.publishing.estimates import estimate_messages, status_message
from debris_scanner.nodes.publishing.forecast_publisher import ForecastPublisher
from debris_scanner.nodes.publishing.frame_names import declared_frame_names
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.poses import target_pose_message, transform_message

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # not on PyPI
    TransformBroadcaster = None


# the latest poses again, for a stage that restarts; `odometry` itself brings a late joiner only new ones
JOURNAL_TOPIC = 'odometry_journal'


class TargetTransforms:
    """TF: sensor's optical frame → ``target_scanning`` → ``target``; silent without tf2_ros.

    The first never jumps, but where the target was lost and another submap began. The second is there once a
    model is tracked, and changes with each model that is adopted. Displays know the optical frame as
    ``sensor``, whatever the driver calls it.
    """

    def __init__(self, node: Node) -> None:
        wanted = self.declare(node)
        self._broadcaster = TransformBroadcaster(node) if TransformBroadcaster and wanted else None

    @staticmethod
    def declare(node: Node) -> bool:
        """Declare the parameter; returns whether TF is wanted."""
        doc = "send the target's pose to TF, where tf2_ros is installed"
        return bool(declare(node, 'publish_tf', True, doc))

    def send(self, stamp_ns: int, frame_id: str, child_frame_id: str, T: Array) -> None:
        """Send the pose T (4, 4) of a frame in its parent."""
        if self._broadcaster is not None and frame_id != child_frame_id:
            self._broadcaster.sendTransform(transform_message(stamp_ns, frame_id, child_frame_id, T))


class OdometryPublisher:
    """Publishes all of an estimate; the pose of a key frame leaves before its cloud, and the status last.

    ``odometry`` names the target frame that its pose is of. ``target_pose`` cannot, so it is that of one
    frame from the start, ``target_scanning``, where that of ``odometry`` changes as a model is adopted.

    Other nodes count a frame by its status: one of which something could not be published is lost to all.

    Args:
        node: whose topics these are.
        sensor_path: how the sensor moves, for the forecast.
        mean_motion: of the orbit, rad/s, for the forecast.
        journal: whether a stage may restart and ask for the latest poses again.
    """

    def __init__(
        self, node: Node, sensor_path: SensorPath, mean_motion: float, journal: bool = False
    ) -> None:
        self.odometry = node.create_publisher(OdometryMessage, 'odometry', qos.waiting())
        self._journal = node.create_publisher(OdometryMessage, JOURNAL_TOPIC, qos.kept()) if journal else None
        self.status = node.create_publisher(DiagnosticArray, 'odometry_status', qos.kept())
        self.keyframes = node.create_publisher(PointCloud2, 'keyframe_points', qos.cloud_publisher())
        self._pose = node.create_publisher(PoseWithCovarianceStamped, 'target_pose', qos.waiting())
        self.frames = declared_frame_names(node)
        self._transforms = TargetTransforms(node)
        self._forecast = ForecastPublisher(node, sensor_path, mean_motion)
        self._detection = DetectionPublisher(node)
        self._log = node.get_logger()
        self._turn = TurnWatch()
        self.model_id = ''  # of the model that is tracked, by the name that ``model_id`` gives it

    @property
    def progress(self) -> dict[str, float]:
        """Key-values of how far the target has turned, degrees."""
        return {'turned_deg': round(float(np.degrees(self._turn.shown)), 1)}

    def reset(self) -> None:
        """A new scan begins."""
        self._turn, self.model_id = TurnWatch(), ''

    @staticmethod
    def declare(node: Node) -> None:
        """Declare the parameters."""
        declared_frame_names(node)
        TargetTransforms.declare(node)

    def publish(self, estimate: OdometryEstimate, source: Odometry, target_points: PointCloud2) -> None:
        """Publish the estimate of a frame.

        Args:
            estimate: of the frame.
            source: the odometry that made it, right after the frame.
            target_points: the frame.
        """
        assert source.filter is not None
        target_frame = self.frames.of(estimate.tracked)
        sensor_frame = target_points.header.frame_id
        odometry, pose = estimate_messages(estimate, source.filter, sensor_frame, target_frame)
        self._turn.add(target_frame, estimate.T_sensor_target[:3, :3])
        self.odometry.publish(odometry)
        if self._journal is not None:
            self._journal.publish(odometry)
        if estimate.accepted:
            stamp_ns, T_target_scanning = estimate.stamp_ns, source.T_target_scanning
            T = compose(estimate.T_sensor_target, T_target_scanning)
            self._pose.publish(target_pose_message(stamp_ns, sensor_frame, T, estimate.covariance))
            self._transforms.send(stamp_ns, sensor_frame, self.frames.scanning, T)
            self._transforms.send(stamp_ns, sensor_frame, self.frames.sensor, np.eye(4))
            if estimate.tracked and source.model is not None:
                T = inverse(T_target_scanning)
                self._transforms.send(stamp_ns, self.frames.scanning, self.frames.target, T)
                self._detection.send(pose, source.model, target_frame)
        self._forecast.note(estimate, source, target_points.header.frame_id)
        if estimate.keyframe is not None:
            self.keyframes.publish(target_points)
            if full := source.full:
                self._log.warning(full)
        self.status.publish(status_message(estimate, self.model_id if estimate.tracked else ''))
