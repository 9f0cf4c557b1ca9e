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

"""A true surface where no mesh exists: depth frames fused with measured poses.

Models are measured against it, so it is made from raw depth alone, by averaging over frames, and shares no
smoothing with the models.
"""

from collections.abc import Iterable

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, apply
from debris_scanner.core.voxel_grid import voxel_grid_with_normals
from debris_scanner.sensing.normals import NormalSettings, fit_normals

_EDGE_PX = 2  # a silhouette's pixels mix target and background
_EDGE_JUMP_M = 0.015
_GRAZING_COS = 0.42  # 65 degrees: beyond it depth noise is mostly noise along the surface
# In units of the distance between neighbouring pixels on the target (0.8 mm for a Kinect at 0.42 m).
_VOXEL = 0.65  # of the result: finer than the measurements, so that its spacing hardly counts
_FIT_RADIUS = 3.2
_FIT_NEIGHBOURS = 96
_FIT_LEAST = 24  # fewer neighbours than this are a stray pixel, not a surface
_CHUNK = 20_000


def fuse_depth(frames: Iterable[tuple[DepthFrame, Array]]) -> NDArray[np.float32]:
    """Points (n, 3) of the surface that frames with their T_target_sensor saw, target frame, metres."""
    points, normals, spacings = [], [], []
    for frame, T_target_sensor in frames:
        seen, facing = _clear_pixels(frame)
        points.append(apply(T_target_sensor, seen))
        normals.append(facing @ T_target_sensor[:3, :3].T)
        spacings.append(seen[:, 2] / frame.camera.fx)
    if not sum(map(len, points)):
        return np.zeros((0, 3), np.float32)
    spacing = float(np.median(np.concatenate(spacings)))
    return _smooth(np.concatenate(points), np.concatenate(normals), spacing)


def cloud_ply(points: NDArray[np.float32]) -> bytes:
    """Binary PLY of bare points (n, 3)."""
    header = (
        f'ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n'
        'property float x\nproperty float y\nproperty float z\nend_header\n'
    )
    return header.encode() + np.ascontiguousarray(points, '<f4').tobytes()


def _clear_pixels(frame: DepthFrame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Points and normals (n, 3), sensor frame, of pixels away from edges and not seen too obliquely."""
    _, normals = fit_normals(frame.depth, frame.camera, NormalSettings(radius=3))
    size = 2 * _EDGE_PX + 1
    nearest = scipy.ndimage.minimum_filter(frame.depth, size)  # 0 next to a hole or the background
    inner = (nearest > 0) & (scipy.ndimage.maximum_filter(frame.depth, size) - nearest < _EDGE_JUMP_M)
    points = frame.camera.back_project(frame.depth)[inner]
    facing = normals[inner]
    cosine = -np.sum(facing * points, axis=1) / np.linalg.norm(points, axis=1)
    clear = cosine > _GRAZING_COS
    return points[clear], facing[clear]


def _smooth(points: Array, normals: Array, spacing: float) -> NDArray[np.float32]:
    """One point per voxel, moved onto the plane through the measurements around it; strays dropped."""
    tree = scipy.spatial.cKDTree(points)
    centres, facing = voxel_grid_with_normals(points, normals, _VOXEL * spacing)
    kept = [np.zeros((0, 3))]
    for start in range(0, len(centres), _CHUNK):
        centre = centres[start : start + _CHUNK].astype(np.float64)
        n = facing[start : start + _CHUNK]
        distance, index = tree.query(centre, _FIT_NEIGHBOURS, distance_upper_bound=_FIT_RADIUS * spacing)
        index = np.minimum(index, len(points) - 1)  # absent neighbours carry the index len(points)
        # The other side of a thin part may lie within the radius, but faces away.
        same_side = np.einsum('nkc,nc->nk', normals[index], n) > 0.5
        weight = (np.isfinite(distance) & same_side).astype(np.float64)
        count = weight.sum(axis=1)
        offset = points[index] - centre[:, None]
        mean = np.einsum('nk,nkc->nc', weight, offset) / np.maximum(count, 1)[:, None]
        spread = offset - mean[:, None]
        covariance = np.einsum('nk,nkc,nkd->ncd', weight, spread, spread)
        normal = np.linalg.eigh(covariance)[1][:, :, 0]
        on_plane = centre + np.sum(mean * normal, axis=1)[:, None] * normal
        kept.append(on_plane[count >= _FIT_LEAST])
    return np.concatenate(kept).astype(np.float32)
