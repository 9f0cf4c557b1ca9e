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

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.publishing.detection_publisher import DetectionPublisher
from debris_scanner.nodes.publishing.estimates import estimate_messages, status_message
from debris_scanner.nodes.publishing.forecast_publisher import ForecastPublisher
from debris_scanner.nodes.publishing.frame_names import declared_frame_names
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # not on PyPI
    TransformBroadcaster = None


# the latest poses again, for a stage that restarts; `odometry` itself brings a late joiner only new ones
JOURNAL_TOPIC = 'odometry_journal'


class TargetTransforms:
    """TF: the target frame as a child of the sensor's optical frame; silent without tf2_ros."""

    def __init__(self, node: Node) -> None:
        wanted = self.declare(node)
        self._broadcaster = TransformBroadcaster(node) if TransformBroadcaster and wanted else None

    @staticmethod
    def declare(node: Node) -> bool:
        """Declare the parameter; returns whether TF is wanted."""
        doc = "send the target's pose to TF, where tf2_ros is installed"
        return bool(declare(node, 'publish_tf', True, doc))

    def send(self, pose: PoseWithCovarianceStamped, child_frame_id: str) -> None:
        """Send one pose of the target."""
        if self._broadcaster is None:
            return
        message = TransformStamped(header=pose.header, child_frame_id=child_frame_id)
        p = pose.pose.pose.position
        message.transform.translation = Vector3(x=p.x, y=p.y, z=p.z)
        message.transform.rotation = pose.pose.pose.orientation
        self._broadcaster.sendTransform(message)


class OdometryPublisher:
    """Publishes all of an estimate; the pose of a key frame leaves before its cloud, and the status last.

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
        self.odometry.publish(odometry)
        if self._journal is not None:
            self._journal.publish(odometry)
        if estimate.accepted:
            self._pose.publish(pose)
            self._transforms.send(pose, target_frame)
            if estimate.tracked and source.model is not None:
                self._detection.send(pose, source.model, target_frame)
        self._forecast.note(estimate, source, target_points.header.frame_id)
        if estimate.keyframe is not None:
            self.keyframes.publish(target_points)
            if full := source.full:
                self._log.warning(full)
        self.status.publish(status_message(estimate))
