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

"""The model as messages, latched: cloud ``model``, mesh ``model_mesh``, ``depth_offset`` of the sensor."""

import zlib
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from debris_scanner.core.frames import Model
from debris_scanner.sensing.depth_offset import LARGEST_SHARE, NO_OFFSET, SUPPORT, DepthOffset
from msg_adapters.clouds import cloud_message, read_cloud, read_scalars
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import header_message

Colours = NDArray[np.uint8] | None  # (m, 3)
MESH_COLOUR = ColorRGBA(r=0.75, g=0.75, b=0.78, a=1.0)
TIMELESS_NS = 0  # stamp of what does not change in its frame: for TF, the latest transform there is
MOST_COEFFICIENTS = 256  # of a depth offset, in a row or column
_NORMALS = ('normal_x', 'normal_y', 'normal_z')


def fingerprint(cloud: Any) -> int:
    """Checksum of a model's cloud, below 2^32, by which other messages name the model; 0 of an empty one."""
    return zlib.crc32(cloud.data)


def model_id(cloud: Any) -> str:
    """The name of a model by its :func:`fingerprint`, eight hexadecimal digits; empty of an empty cloud."""
    return f'{fingerprint(cloud):08x}' if cloud.width else ''


def model_message(model: Model, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Cloud (n,) of the model's points, metres, target frame: x, y, z, normal_x, _y, _z and rgb if known."""
    fields = {axis: model.points[:, i] for i, axis in enumerate('xyz')}
    fields |= {name: model.normals[:, i] for i, name in enumerate(_NORMALS)}
    return cloud_message(stamp_ns, frame_id, fields, model.rgb)


def read_model(cloud: Any, mesh: Any = None) -> Model:
    """Model of its cloud and, where it is at hand, the Marker of its mesh; without it the mesh is empty.

    Raises:
        MalformedMessage: a message contradicts itself, or is no model: an empty cloud, points or normals
            that are not finite, a marker that is no list of triangles.
    """
    read = read_cloud(cloud)
    normals = np.stack([v.astype(np.float32) for v in read_scalars(cloud, _NORMALS).values()], axis=-1)
    points, normals = read.xyz.reshape(-1, 3), normals.reshape(-1, 3)
    if not len(points) or len(normals) != len(points):
        raise MalformedMessage(f'model of {len(points)} points and {len(normals)} normals')
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        raise MalformedMessage('model has points or normals that are not finite')
    vertices, triangles = read_mesh(mesh) if mesh is not None else _empty_mesh()
    rgb = None if read.rgb is None else read.rgb.reshape(-1, 3)
    return Model(points, normals, vertices, triangles, rgb)


def depth_offset_message(offset: DepthOffset, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Organised cloud of the coefficients: x, y are tangents of the ray, z is 1, ``share`` is of the depth.

    It is empty where there is no offset.
    """
    if offset.is_none:
        return cloud_message(stamp_ns, frame_id, dict.fromkeys(('x', 'y', 'z', 'share'), np.zeros(0)))
    columns, rows = offset.coefficients.shape
    # a cubic spline's coefficient counts most one step into its first cell
    x = (offset.first[0] - 1 + np.arange(columns)) * offset.step
    y = (offset.first[1] - 1 + np.arange(rows)) * offset.step
    across, down = np.meshgrid(x, y)
    fields = {'x': across, 'y': down, 'z': np.ones_like(across), 'share': offset.coefficients.T.copy()}
    return cloud_message(stamp_ns, frame_id, fields)


def read_depth_offset(cloud: Any) -> DepthOffset:
    """The inverse of :func:`depth_offset_message`.

    Raises:
        MalformedMessage: the message contradicts itself, or is no lattice of shares of the depth.
    """
    x, y, share = read_scalars(cloud, ('x', 'y', 'share')).values()
    if not share.size:
        return NO_OFFSET
    if share.ndim != 2 or min(share.shape) < SUPPORT or max(share.shape) > MOST_COEFFICIENTS:
        raise MalformedMessage(f'a depth offset of {share.shape} coefficients')
    if not (np.isfinite([x, y, share]).all() and np.abs(share).max() <= LARGEST_SHARE):
        raise MalformedMessage('a depth offset that is not finite, or too large')
    step = float(x[0, 1] - x[0, 0])
    steps = np.concatenate([np.diff(x, axis=1).ravel(), np.diff(y, axis=0).ravel()])
    if not step > 0 or not np.allclose(steps, step, rtol=1e-3):
        raise MalformedMessage('the steps of a depth offset are not even')
    first = round(float(x[0, 0]) / step) + 1, round(float(y[0, 0]) / step) + 1
    return DepthOffset(step, first, np.ascontiguousarray(share.T, np.float64))


def mesh_marker(model: Model, stamp_ns: int, frame_id: str, max_triangles: int | None = None) -> Marker:
    """TRIANGLE_LIST of the model's mesh, metres, target frame; coloured where the model is.

    rclpy takes points one object each: making and serialising the marker costs 2.5 microseconds a
    triangle (0.5 s and 14 MB for 200 000), and a subscriber in Python pays 8 to read it.

    Args:
        model: with the mesh.
        stamp_ns: stamp, nanoseconds.
        frame_id: the target frame.
        max_triangles: at most so many; a larger mesh is coarsened by merging its vertices on a grid.
    """
    vertices, triangles, rgb = model.vertices, model.triangles, model.vertex_rgb
    if max_triangles is not None:
        vertices, triangles, rgb = _coarsened(vertices, triangles, rgb, max_triangles)
    marker = empty_marker(stamp_ns, frame_id, 'model_mesh', 0, Marker.TRIANGLE_LIST)
    marker.scale = Vector3(x=1.0, y=1.0, z=1.0)
    marker.color = MESH_COLOUR
    corners = point_messages(vertices)  # one object a vertex: its six or so triangles share it
    marker.points = [corners[i] for i in triangles.ravel().tolist()]
    if rgb is not None:
        colours = [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in (rgb / 255.0).tolist()]
        marker.colors = [colours[i] for i in triangles.ravel().tolist()]
    return marker


def read_mesh(marker: Any) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Vertices (m, 3), metres, and triangles (t, 3) of a marker; equal corners become one vertex.

    Raises:
        MalformedMessage: not a TRIANGLE_LIST, not three corners a triangle, or corners not finite.
    """
    if marker.type != Marker.TRIANGLE_LIST or len(marker.points) % 3:
        raise MalformedMessage(f'marker of type {marker.type} with {len(marker.points)} points is no mesh')
    if not marker.points:
        return _empty_mesh()
    corners = np.array([(p.x, p.y, p.z) for p in marker.points], np.float32)
    if not np.isfinite(corners).all():
        raise MalformedMessage('mesh has corners that are not finite')
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int32)


def empty_marker(stamp_ns: int, frame_id: str, namespace: str, number: int, kind: int) -> Marker:
    """Marker without points at the origin of its frame; it moves with the frame, and stays until replaced."""
    return Marker(
        header=header_message(stamp_ns, frame_id),
        ns=namespace,
        id=number,
        type=kind,
        action=Marker.ADD,
        frame_locked=True,
        pose=Pose(orientation=Quaternion(w=1.0)),
    )


def point_messages(points: NDArray[Any]) -> list[Point]:
    """Point messages of (n, 3), metres; about 2 microseconds each."""
    return [Point(x=x, y=y, z=z) for x, y, z in points.astype(np.float64).tolist()]


def _empty_mesh() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)


def _means(rows: NDArray[Any], index: NDArray[np.intp]) -> NDArray[np.float64]:
    """The mean of the rows (m, 3) of each index."""
    counts = np.bincount(index)
    return np.stack([np.bincount(index, rows[:, i]) / counts for i in range(3)], axis=1)


def _coarsened(
    vertices: NDArray[np.float32], triangles: NDArray[np.int32], rgb: Colours, limit: int
) -> tuple[NDArray[np.float32], NDArray[np.int32], Colours]:
    """Mesh of at most ``limit`` triangles: vertices of a grid's cell, and their colours, become their mean.

    No holes arise, unlike when triangles are dropped. The grid starts at the size that a closed surface
    of so many triangles has, and grows until they fit.
    """
    if len(triangles) <= limit:
        return vertices, triangles, rgb
    corner = vertices[triangles].astype(np.float64)
    area = (
        0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    )
    extent = float(np.ptp(vertices, axis=0).max())
    cell = max(float(np.sqrt(2 * area / max(limit, 1))), extent * 1e-6)
    while cell < 2 * extent:
        keys = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
        size = keys.max(axis=0) + 1  # one number a cell: sorting rows takes twenty times as long
        number = (keys[:, 0] * size[1] + keys[:, 1]) * size[2] + keys[:, 2]
        _, index = np.unique(number, return_inverse=True)
        merged = index[triangles]
        kept = (
            (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
        )
        remaining = merged[kept]
        if len(remaining) <= limit:
            mean = _means(vertices, index).astype(np.float32)
            shades = None if rgb is None else np.rint(_means(rgb, index)).astype(np.uint8)
            return mean, remaining.astype(np.int32), shades
        cell *= 1.2
    return *_empty_mesh(), None
