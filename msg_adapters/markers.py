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

"""The pose graph as markers for RViz: key frames, the edges between neighbours, and the closures."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from debris_scanner.core.geometry import Array
from msg_adapters.errors import MalformedMessage
from msg_adapters.models import empty_marker, point_messages

NODE_COLOUR = ColorRGBA(r=0.2, g=0.5, b=1.0, a=1.0)
EDGE_COLOUR = ColorRGBA(r=0.7, g=0.7, b=0.7, a=1.0)
CLOSURE_COLOUR = ColorRGBA(r=1.0, g=0.3, b=0.1, a=1.0)


def graph_markers(
    stamp_ns: int,
    frame_id: str,
    keyframes: Sequence[Array],
    edges: Iterable[tuple[int, int]],
    closures: Iterable[tuple[int, int]],
    node_size: float = 0.01,
) -> MarkerArray:
    """Three markers: spheres where the sensor stood, lines for the edges, lines for the closures.

    All three are always there, empty if need be, so that a new graph replaces all of an old one.

    Args:
        stamp_ns: stamp, nanoseconds.
        frame_id: the target frame.
        keyframes: T_target_sensor (4, 4) of each key frame.
        edges: pairs of indices into ``keyframes``.
        closures: pairs of indices into ``keyframes``.
        node_size: diameter of the spheres, metres; the lines are a quarter of it wide.
    """
    positions = np.array([T[:3, 3] for T in keyframes], np.float64).reshape(-1, 3)
    points = point_messages(positions)
    nodes = empty_marker(stamp_ns, frame_id, 'keyframes', 0, Marker.SPHERE_LIST)
    nodes.scale = Vector3(x=node_size, y=node_size, z=node_size)
    nodes.color = NODE_COLOUR
    nodes.points = points
    return MarkerArray(
        markers=[
            nodes,
            _lines(stamp_ns, frame_id, 'edges', EDGE_COLOUR, points, edges, node_size / 4),
            _lines(stamp_ns, frame_id, 'closures', CLOSURE_COLOUR, points, closures, node_size / 4),
        ]
    )


def read_graph(array: Any) -> tuple[str, NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Frame, key frames (k, 3), edges (n, 2, 3) and closures (m, 2, 3) of :func:`graph_markers`.

    Raises:
        MalformedMessage: markers are missing, or have points that are not finite or not in pairs.
    """
    markers = {str(marker.ns): marker for marker in array.markers}
    if missing := {'keyframes', 'edges', 'closures'} - set(markers):
        raise MalformedMessage(f'graph without markers {sorted(missing)}')
    with np.errstate(over='ignore'):  # a double beyond float's range becomes Inf
        points = {
            name: np.array([(p.x, p.y, p.z) for p in marker.points], np.float32).reshape(-1, 3)
            for name, marker in markers.items()
        }
    if not all(np.isfinite(p).all() for p in points.values()):
        raise MalformedMessage('graph has points that are not finite')
    if any(len(points[name]) % 2 for name in ('edges', 'closures')):
        raise MalformedMessage('graph has lines without an end')
    edges, closures = (points[name].reshape(-1, 2, 3) for name in ('edges', 'closures'))
    return str(markers['keyframes'].header.frame_id), points['keyframes'], edges, closures


def _lines(
    stamp_ns: int,
    frame_id: str,
    namespace: str,
    colour: ColorRGBA,
    points: list[Point],
    pairs: Iterable[tuple[int, int]],
    width: float,
) -> Marker:
    lines = empty_marker(stamp_ns, frame_id, namespace, 0, Marker.LINE_LIST)
    lines.scale = Vector3(x=width)
    lines.color = colour
    lines.points = [points[i] for pair in pairs for i in pair]
    return lines
