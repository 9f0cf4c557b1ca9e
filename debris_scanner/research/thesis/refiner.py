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

"""Model refiner: merged cloud in; thinned, cleaned, smoothed and meshed model out (T19).

Trowbridge 2014, section 3.2. Voxel grid, 3 sigma outliers among k = 50 neighbours, moving least squares
of order 5, triangles. The cloud equals PCL's to rounding at every step. The mesh cannot: nothing that is
maintained has PCL's greedy projection, so Open3D's ball pivoting makes the triangles, and those that
greedy projection would not reach are taken out again. Without that the mesh covers more of the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.core.parameters import parameter
from debris_scanner.core.voxel_grid import group
from debris_scanner.research.thesis.moving_least_squares import moving_least_squares

o3d = load_open3d()

MIN_POINTS = 60  # fewer make no surface, and have no 50 neighbours to judge outliers by
# PCL's mu is 2.5, the reach in units of the distance to the nearest neighbour; but it closes part of the
# holes this leaves. Ball pivoting has PCL's area within 3 % at this value, for order 2 and order 5 alike.
REACH = 3.25


@dataclass(frozen=True)
class RefinerSettings:
    """Numbers of section 3.2; what it does not print is PCL's default or the data's scale."""

    voxel: float = parameter(0.002, 'edge of the voxel grid', 'm', 1e-4, 0.1)
    outlier_neighbours: int = parameter(50, 'neighbours of the outlier filter, k', '', 1, 1000)
    outlier_sigma: float = parameter(3.0, 'mean neighbour distances beyond this are outliers', 'sigma', 0.0)
    order: int = parameter(5, 'order of the moving least squares polynomial', '', 0, 8)
    radius: float = parameter(0.01, 'neighbourhood of the moving least squares', 'm', 1e-4, 1.0)
    ball_radii: tuple[float, float] = parameter(
        (0.002, 0.004), 'balls that pivot over the smoothed points, one after the other', 'm', 1e-4, 1.0
    )
    max_surface_angle_deg: float = parameter(
        45.0, 'corners of a triangle have normals at most this far apart', 'deg', 0.0, 90.0
    )
    greedy_gaps: bool = parameter(
        True, 'leave out what greedy projection would not reach; off, the mesh is more complete'
    )


@dataclass(frozen=True)
class RefinedSurface:
    """Refined cloud and mesh; the mesh's vertices are the cloud's points."""

    points: NDArray[np.float32]  # (n, 3) metres
    normals: NDArray[np.float32]  # (n, 3) unit, outward
    triangles: NDArray[np.int32]  # (t, 3), counter-clockwise from outside


def refine(
    points: NDArray[np.floating],
    towards: NDArray[np.floating] | None = None,
    settings: RefinerSettings | None = None,
) -> RefinedSurface | None:
    """Refined surface of a merged cloud (n, 3), metres, or None where too few points are left.

    Args:
        points: of all frames, in the target frame.
        towards: (n, 3) directions from each point to the sensor that saw it, target frame; they tell
            outside from inside. Without them neighbouring normals are made to agree, and on the whole
            to point away from the centroid.
        settings: as :class:`RefinerSettings`.
    """
    s = settings or RefinerSettings()
    leaves = group(points, s.voxel)
    cloud = leaves.mean(points)
    if len(cloud) < MIN_POINTS:
        return None
    inliers = without_outliers(cloud, s.outlier_neighbours, s.outlier_sigma)
    smoothed = moving_least_squares(cloud[inliers], s.radius, s.order)
    if len(smoothed.points) < MIN_POINTS:
        return None
    view = None if towards is None else leaves.mean(towards)[inliers][smoothed.index]
    normals = outward(smoothed.points, smoothed.normals, view)
    return RefinedSurface(
        smoothed.points.astype(np.float32),
        normals.astype(np.float32),
        triangulate(smoothed.points, normals, s),
    )


def without_outliers(points: Array, neighbours: int = 50, sigmas: float = 3.0) -> NDArray[np.intp]:
    """Indices, ascending, of points (n, 3) whose mean distance to their neighbours is not exceptional."""
    # Open3D counts the point itself as its own first neighbour, PCL does not
    _, kept = _cloud(points).remove_statistical_outlier(neighbours + 1, sigmas)
    return np.sort(np.asarray(kept, np.intp))


def outward(points: Array, normals: Array, towards: Array | None) -> Array:
    """Normals (n, 3) flipped to the side of ``towards`` (n, 3), or else to agree with each other."""
    if towards is not None:
        return np.where((normals * towards).sum(axis=1, keepdims=True) < 0, -normals, normals)
    cloud = _cloud(points, normals)
    cloud.orient_normals_consistent_tangent_plane(20)
    agreed = np.asarray(cloud.normals).copy()
    outside = (agreed * (points - points.mean(axis=0))).sum()
    return agreed if outside >= 0 else -agreed


def triangulate(points: Array, normals: Array, settings: RefinerSettings) -> NDArray[np.int32]:
    """Triangles (t, 3) over points (n, 3) with outward normals (n, 3)."""
    mesh = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
        _cloud(points, normals), o3d.utility.DoubleVector(sorted(settings.ball_radii))
    )
    triangles = np.asarray(mesh.triangles, np.int32).reshape(-1, 3)
    corner = normals[triangles]
    cosines = np.abs((corner * np.roll(corner, -1, axis=1)).sum(axis=2)).min(axis=1)
    keep = cosines > np.cos(np.radians(settings.max_surface_angle_deg))
    if settings.greedy_gaps:
        keep &= _reached(points, triangles)
    return np.ascontiguousarray(triangles[keep])


def merge(clouds: Sequence[NDArray[np.floating]], poses: Sequence[Array]) -> tuple[Array, Array]:
    """All points (n, 3) in the target frame and the directions (n, 3) to the sensors that saw them.

    Args:
        clouds: of each frame (m, 3), sensor frame.
        poses: T_target_sensor (4, 4) of each.
    """
    moved = [c @ T[:3, :3].T + T[:3, 3] for c, T in zip(clouds, poses, strict=True)]
    towards = [T[:3, 3] - p for p, T in zip(moved, poses, strict=True)]
    directions = [d / np.linalg.norm(d, axis=1, keepdims=True) for d in towards]
    return np.concatenate(moved), np.concatenate(directions)


def _reached(points: Array, triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Triangles (t,) that greedy projection could make from one of their corners."""
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    corner = points[triangles]
    length = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
    longer = np.maximum(length, np.roll(length, 1, axis=1))  # of the two edges at each corner
    return np.asarray((longer < REACH * nearest[triangles]).any(axis=1))


def _cloud(points: Array, normals: Array | None = None) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(points, np.float64)))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(np.asarray(normals, np.float64))
    return cloud
