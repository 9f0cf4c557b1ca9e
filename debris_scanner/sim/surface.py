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

"""A triangle mesh for ray casting and distances."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.open3d_library import load_open3d

# Steps of a sequence that fills the square evenly (Roberts 2018, R2).
_FINE = 300_000  # triangles: so fine a mesh looks smooth by itself
_CREASE_COS = 0.87  # faces that meet at less than 30 degrees stand for a curved surface
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])


class Surface:
    """Triangles that rays are cast at and distances are taken to, in their own frame."""

    def __init__(
        self, vertices: NDArray[np.floating], triangles: NDArray[np.integer], threads: int = 1
    ) -> None:
        """Build the search tree of vertices (n, 3) and triangles (t, 3)."""
        self._o3d = load_open3d()
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=threads)
        self._corners = np.asarray(vertices, np.float64)[np.asarray(triangles, np.int64)]
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(
        self, origin: NDArray[np.float32], direction: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Distances (...) in lengths of direction, inf for a miss, and the mesh's unit normals (..., 3).

        Args:
            origin: (3,) of all rays.
            direction: (..., 3).
        """
        hit = self._cast(origin, direction)
        return hit['t_hit'].numpy(), hit['primitive_normals'].numpy()

    def cast_smooth(
        self, origin: NDArray[np.float32], direction: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The same with the normals of the curved surface that the triangles stand for."""
        hit = self._cast(origin, direction)
        length, uv = hit['t_hit'].numpy(), hit['primitive_uvs'].numpy()
        face = np.where(np.isfinite(length), hit['primitive_ids'].numpy().astype(np.int64), 0)
        share = np.stack([1 - uv.sum(axis=-1), uv[..., 0], uv[..., 1]], axis=-1)
        normals = np.einsum('...k,...ki->...i', share, self._corner_normals[face])
        return length, np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True), np.float32)

    def _cast(self, origin: NDArray[np.float32], direction: NDArray[np.float32]) -> Any:
        rays = np.empty((*direction.shape[:-1], 6), np.float32)
        rays[..., :3], rays[..., 3:] = origin, direction
        return self._scene.cast_rays(self._o3d.core.Tensor(rays))

    @cached_property
    def _corner_normals(self) -> Array:
        return corner_normals(self._corners)

    def distance(self, points: NDArray[np.floating]) -> Array:
        """Unsigned distance (n,) of points (n, 3) to the surface."""
        query = self._o3d.core.Tensor(np.ascontiguousarray(points, np.float32))
        nearest = self._scene.compute_closest_points(query)['primitive_ids'].numpy()
        # its own distances are off by 0.1 mm on long thin triangles, for lack of precision
        return distance_to_triangles(np.asarray(points, np.float64), self._corners[nearest])


def corner_normals(corners: Array) -> Array:
    """Unit normals (t, 3 corners, 3): at each corner the mean of the faces that meet there without a crease.

    Args:
        corners: (t, 3 corners, 3) of triangles.
    """
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = area / np.maximum(np.linalg.norm(area, axis=1), 1e-30)[:, None]
    flat = np.repeat(unit[:, None], 3, axis=1)
    if len(corners) > _FINE:
        return flat
    places = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(places, kind='stable')
    count = np.bincount(places)
    many = count[places[order]]  # corners at the place of each
    first = np.repeat(order, many)
    begin = (np.cumsum(count) - count)[places[order]]
    within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    second = order[np.repeat(begin, many) + within]
    smooth = (unit[first // 3] * unit[second // 3]).sum(axis=1) > _CREASE_COS
    total = np.zeros((3 * len(corners), 3))
    np.add.at(total, first[smooth], area[second[smooth] // 3])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-30, total / np.maximum(length, 1e-30), flat.reshape(-1, 3)).reshape(-1, 3, 3)


def distance_to_triangles(points: Array, corners: Array) -> Array:
    """Distance (n,) of each point (n, 3) to its own triangle (n, 3 corners, 3)."""
    sides = np.roll(corners, -1, axis=1) - corners
    spokes = points[:, None] - corners
    normal = np.cross(sides[:, 0], sides[:, 1])
    area = np.linalg.norm(normal, axis=1)
    # outside the triangle the nearest point lies on a side
    length = np.einsum('nki,nki->nk', sides, sides)
    along = np.einsum('nki,nki->nk', spokes, sides) / np.maximum(length, 1e-30)
    to_sides = np.linalg.norm(spokes - np.clip(along, 0, 1)[..., None] * sides, axis=2).min(axis=1)
    to_plane = np.abs(np.einsum('ni,ni->n', spokes[:, 0], normal)) / np.maximum(area, 1e-30)
    inward = np.einsum('nki,ni->nk', np.cross(sides, spokes), normal)
    above = np.all(inward >= 0, axis=1) & (area > 0)
    return np.where(above, to_plane, to_sides)


def sample_mesh(vertices: NDArray[np.floating], triangles: NDArray[np.integer], count: int) -> Array:
    """Points (count, 3) spread evenly over the triangles' area; the same mesh gives the same points."""
    corners = np.asarray(vertices, np.float64)[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # one point per equal share of the area; within the triangles an evenly filling sequence
    share = (np.arange(count) + 0.5) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), share), len(area) - 1)
    walk = (np.arange(1, count + 1)[:, None] * _STEPS) % 1.0
    a, b = np.sqrt(walk[:, :1]), walk[:, 1:]
    p, q, r = corners[face].transpose(1, 0, 2)
    return np.asarray((1 - a) * p + a * (1 - b) * q + a * b * r)
