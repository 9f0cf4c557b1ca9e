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

"""Topics ``model``, ``model_id``, ``model_mesh``, ``keyframe_poses``, ... and the markers, all latched."""

from collections.abc import Callable, Sequence

import numpy as np
from nav_msgs.msg import Path
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.frames import KeyPose
from debris_scanner.modelling.generation import Generation
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare_live
from debris_scanner.nodes.publishing.frame_names import FrameNames, declared_frame_names
from debris_scanner.sensing.depth_offset import NO_OFFSET
from msg_adapters.clouds import cloud_message
from msg_adapters.markers import graph_markers
from msg_adapters.models import (
    TIMELESS_NS,
    depth_offset_message,
    empty_marker,
    fingerprint,
    mesh_marker,
    model_id,
    model_message,
)
from msg_adapters.poses import path_message


class ModelPublisher:
    """Publishes a generation.

    Nothing of it moves in the target frame, so its stamp is zero: TF places it by the latest transform. A
    late joiner has none of the time at which the model was made.

    ``keyframe_poses`` holds T_target_sensor of each key frame, with the key frame's own stamp: the poses that
    the model was made from. Odometry needs them to change from its own target frame to the model's. In place
    of a stamp the path's header has the model's :func:`fingerprint`, by which the two are joined. So has that
    of ``depth_offset``, what the sensor does to its images: model and poses are free from it. ``model_id``
    has it in hexadecimal digits, and so have the text of the mesh's marker and the status of tracked frames.
    """

    def __init__(self, node: Node) -> None:
        self._max_triangles, self.frames = self.declare(node)
        self.model = node.create_publisher(PointCloud2, 'model', qos.latched())
        self._id = node.create_publisher(String, 'model_id', qos.latched())
        self._mesh = node.create_publisher(Marker, 'model_mesh', qos.latched())
        self.poses = node.create_publisher(Path, 'keyframe_poses', qos.latched())
        self._offset = node.create_publisher(PointCloud2, 'depth_offset', qos.latched())
        self._markers = node.create_publisher(MarkerArray, 'graph_markers', qos.latched())

    @staticmethod
    def declare(node: Node) -> tuple[Callable[[], int], FrameNames]:
        """Declare the parameters; returns the largest number of triangles, and the names of the frames."""
        doc = 'most triangles published'
        return declare_live(node, 'max_mesh_triangles', 20_000, doc, 100, 10**7), declared_frame_names(node)

    def publish(self, generation: Generation) -> None:
        """Publish a generation that has a model."""
        assert generation.model is not None
        poses = sorted(generation.poses.items())
        model = model_message(generation.model, TIMELESS_NS, self.frames.target)
        name = fingerprint(model)
        self._offset.publish(depth_offset_message(generation.offset, name, self.frames.target))
        self.poses.publish(path_message(name, self.frames.target, poses))
        self.model.publish(model)
        optimised = generation.optimised
        edges = [] if optimised is None else optimised.edges
        self._markers.publish(
            graph_markers(
                TIMELESS_NS,
                self.frames.target,
                [T for _, T in poses],
                [(e.j, e.i) for e in edges if not e.is_closure],
                [(e.j, e.i) for e in edges if e.is_closure],
            )
        )
        mesh = mesh_marker(generation.model, TIMELESS_NS, self.frames.target, self._max_triangles())
        mesh.text = model_id(model)
        self._mesh.publish(mesh)
        self._id.publish(String(data=mesh.text))

    def publish_graph(self, keyframes: Sequence[KeyPose]) -> None:
        """Publish the key frames of a scan that has no model yet."""
        if keyframes:
            poses = [k.T_target_sensor for k in keyframes]
            chain = [(k, k + 1) for k in range(len(poses) - 1)]
            self._markers.publish(graph_markers(TIMELESS_NS, self.frames.scanning, poses, chain, []))

    def clear(self) -> None:
        """Clear everything: a latched model of an earlier scan must not be tracked."""
        empty = cloud_message(TIMELESS_NS, self.frames.target, dict.fromkeys('xyz', np.zeros(0, np.float32)))
        gone = empty_marker(TIMELESS_NS, self.frames.target, 'model_mesh', 0, Marker.TRIANGLE_LIST)
        gone.action = Marker.DELETEALL
        self._offset.publish(depth_offset_message(NO_OFFSET, fingerprint(empty), self.frames.target))
        self.model.publish(empty)
        self.poses.publish(path_message(fingerprint(empty), self.frames.target, []))
        self._mesh.publish(gone)
        self._id.publish(String())
        self._markers.publish(graph_markers(TIMELESS_NS, self.frames.target, [], [], []))
