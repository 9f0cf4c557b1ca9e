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

"""TF from the sensor's optical frame to the target, where tf2_ros is installed."""

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from rclpy.node import Node

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # not on PyPI
    TransformBroadcaster = None


class TargetTransforms:
    """Sends the target frame as a child of the sensor's frame; silent without tf2_ros."""

    def __init__(self, node: Node) -> None:
        self._broadcaster = TransformBroadcaster(node) if TransformBroadcaster else None

    def send(self, pose: PoseWithCovarianceStamped, child_frame_id: str) -> None:
        """One pose of the target."""
        if self._broadcaster is None:
            return
        message = TransformStamped(header=pose.header, child_frame_id=child_frame_id)
        p = pose.pose.pose.position
        message.transform.translation = Vector3(x=p.x, y=p.y, z=p.z)
        message.transform.rotation = pose.pose.pose.orientation
        self._broadcaster.sendTransform(message)
