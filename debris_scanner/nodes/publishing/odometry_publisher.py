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
from debris_scanner.nodes.publishing.estimates import FrameStatus, estimate_messages, status_message
from debris_scanner.nodes.publishing.forecast_publisher import ForecastPublisher
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # not on PyPI
    TransformBroadcaster = None


class TargetTransforms:
    """TF: the target frame as a child of the sensor's optical frame; silent without tf2_ros."""

    def __init__(self, node: Node) -> None:
        self._broadcaster = TransformBroadcaster(node) if TransformBroadcaster else None

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
    """Publishes all of an estimate; the pose of a key frame leaves before its cloud."""

    def __init__(self, node: Node) -> None:
        self.odometry = node.create_publisher(OdometryMessage, 'odometry', qos.kept())
        self.status = node.create_publisher(DiagnosticArray, 'odometry_status', qos.kept())
        self.keyframes = node.create_publisher(PointCloud2, 'keyframe_points', qos.cloud_publisher())
        self._pose = node.create_publisher(PoseWithCovarianceStamped, 'target_pose', qos.waiting())
        self._transforms = TargetTransforms(node)
        self._forecast = ForecastPublisher(node)
        self._log = node.get_logger()

    def publish(self, estimate: OdometryEstimate, source: Odometry, target_points: PointCloud2) -> None:
        """Publish the estimate of a frame.

        Args:
            estimate: of the frame.
            source: the odometry that made it, right after the frame.
            target_points: the frame.
        """
        assert source.filter is not None
        odometry, pose = estimate_messages(estimate, source.filter, target_points.header.frame_id)
        self.odometry.publish(odometry)
        self.status.publish(status_message(estimate))
        if estimate.accepted:
            self._pose.publish(pose)
            self._transforms.send(pose, FrameStatus.of(estimate).frame_id)
        self._forecast.note(estimate, source, target_points.header.frame_id)
        if estimate.keyframe is not None:
            self.keyframes.publish(target_points)
            if full := source.full:
                self._log.warning(full)
