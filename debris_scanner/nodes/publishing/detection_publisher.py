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

"""Topic ``detection``: the tracked target as vision_msgs/Detection3D, where that package is installed."""

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, compose, transform
from debris_scanner.nodes.lifecycle import qos
from msg_adapters.poses import pose_message, read_target_pose

try:
    from vision_msgs import msg as vision_msgs
except ImportError:  # not on PyPI
    vision_msgs = None


def box_of(model: Model) -> tuple[Array, Array]:
    """Centre and size (3,), m, of a model's bounding box along the axes of its target frame."""
    low, high = model.points.min(axis=0), model.points.max(axis=0)
    return (low + high) / 2.0, high - low


class DetectionPublisher:
    """Publishes nothing without vision_msgs."""

    def __init__(self, node: Node) -> None:
        self._publisher: Any = None
        if vision_msgs is not None:
            self._publisher = node.create_publisher(vision_msgs.Detection3D, 'detection', qos.waiting())

    def send(self, pose: PoseWithCovarianceStamped, model: Model, frame_id: str) -> None:
        """Publish a believed pose of the tracked target.

        Args:
            pose: of the target frame, in the sensor's.
            model: in the target frame.
            frame_id: of the target, its name for a user of several detections.
        """
        if self._publisher is None or vision_msgs is None:
            return
        centre, size = box_of(model)
        T = compose(read_target_pose(pose).T_sensor_target, transform(np.eye(3), centre))
        detection = vision_msgs.Detection3D(header=pose.header, id=frame_id)
        detection.bbox.center = pose_message(T)
        for axis, extent in zip('xyz', size.tolist(), strict=True):
            setattr(detection.bbox.size, axis, extent)
        result = vision_msgs.ObjectHypothesisWithPose(pose=pose.pose)
        result.hypothesis.class_id, result.hypothesis.score = 'target', 1.0
        detection.results = [result]
        self._publisher.publish(detection)
