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

"""Smoothing a cloud onto locally fitted polynomial surfaces: moving least squares of any order.

Trowbridge 2014, section 3.2, uses order 5; PCL's MovingLeastSquares with simple projection and without
upsampling is the reference. Around every point a plane is fitted to the neighbours within a radius, a
polynomial height over that plane is fitted with Gaussian weights, and the point is put onto it. Open3D
has the plane only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel

MIN_NEIGHBOURS = 3  # the point itself included; with fewer there is no plane and the point is left out
CHUNK = 500  # points fitted at a time


@dataclass(frozen=True)
class SmoothedCloud:
    """Result: points (m, 3), unit normals (m, 3) of either sign, and the input points they came from (m,)."""

    points: Array
    normals: Array
    index: NDArray[np.intp]


def moving_least_squares(points: NDArray[np.floating], radius: float = 0.01, order: int = 5) -> SmoothedCloud:
    """Smooth points (n, 3), metres.

    Args:
        points: finite.
        radius: of the neighbourhood and, as in PCL, of the Gaussian weight exp(-d² / radius²), metres.
        order: of the polynomial; 0 and 1 leave the plane. Where there are fewer neighbours than
            coefficients, the plane is taken too.

    Raises:
        ValueError: for a radius that is not positive or a negative order.
    """
    if not radius > 0 or order < 0:
        raise ValueError(f'radius {radius} must be positive and order {order} not negative')
    cloud: Array = np.asarray(points, np.float64)
    smoothed, normals = np.empty_like(cloud), np.empty_like(cloud)
    if not len(cloud):
        return SmoothedCloud(smoothed, normals, np.empty(0, np.intp))
    tree = cKDTree(cloud)
    count = tree.query_ball_point(cloud, radius, return_length=True)
    kept = np.flatnonzero(count >= MIN_NEIGHBOURS)
    # points with about as many neighbours together: less padding
    order_by_count = kept[np.argsort(count[kept], kind='stable')]
    for start in range(0, len(order_by_count), CHUNK):
        rows = order_by_count[start : start + CHUNK]
        # k-th neighbours up to the largest count; beyond the radius they are infinitely far away
        distance, near = tree.query(
            points[rows], k=int(count[rows].max()), distance_upper_bound=radius * (1 + 1e-12)
        )
        valid = np.isfinite(distance)
        neighbours = cloud[np.where(valid, near, 0)]
        smoothed[rows], normals[rows] = _project(cloud[rows], neighbours, valid, radius, order)
    return SmoothedCloud(smoothed[kept], normals[kept], kept)


def _project(
    points: Array, neighbours: Array, valid: NDArray[np.bool_], radius: float, order: int
) -> tuple[Array, Array]:
    """Points (c, 3) on the surfaces fitted to their neighbours (c, k, 3), and normals (c, 3)."""
    share = valid / valid.sum(axis=1, keepdims=True)
    centroid = (share[:, None] @ neighbours)[:, 0]
    off = neighbours - centroid[:, None]
    normal = np.linalg.eigh((share[:, :, None] * off).transpose(0, 2, 1) @ off)[1][:, :, 0]
    foot = points - ((points - centroid) * normal).sum(axis=1, keepdims=True) * normal
    # by powers of u, then of v, as _accumulate has them
    terms = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    fitted = valid.sum(axis=1) >= len(terms)
    if order < 2 or not fitted.any():
        return foot, normal
    u_axis, v_axis = _tangents(normal)
    off = (neighbours - foot[:, None]) / radius  # in units of the radius: powers stay near one
    local = off @ np.stack([u_axis, v_axis, normal], axis=2)
    weight = np.where(valid, np.exp(-(off**2).sum(axis=2)), 0.0)
    A, right_side = np.zeros((len(points), len(terms), len(terms))), np.zeros((len(points), len(terms)))
    _accumulate(local, weight, order, A, right_side)
    A[~fitted] = np.eye(len(terms))
    # neighbours on few distinct lines determine less than the full polynomial
    A += 1e-14 * A[:, :1, :1] * np.eye(len(terms))
    c = np.linalg.solve(A, right_side[:, :, None])[:, :, 0]
    c[~fitted | ~np.isfinite(c).all(axis=1)] = 0.0
    surface = foot + (radius * c[:, :1]) * normal
    slope_u, slope_v = c[:, terms.index((1, 0))], c[:, terms.index((0, 1))]
    tilted = normal - slope_u[:, None] * u_axis - slope_v[:, None] * v_axis
    return surface, tilted / np.linalg.norm(tilted, axis=1, keepdims=True)


def _tangents(normal: Array) -> tuple[Array, Array]:
    """Two unit vectors (c, 3) each that complete the normals to right-handed frames."""
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    v = np.cross(normal, least)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return np.cross(v, normal), v


@kernel()
def _accumulate(local: Array, weight: Array, order: int, A: Array, right_side: Array) -> None:
    """Add up the normal equations (c, p, p) and (c, p) of height over u and v, local (c, k, 3)."""
    p = A.shape[1]
    term = np.empty(p)
    for c in range(local.shape[0]):
        for k in range(local.shape[1]):
            w = weight[c, k]
            if w == 0.0:
                continue
            u, v, height = local[c, k, 0], local[c, k, 1], local[c, k, 2]
            m = 0
            u_power = 1.0
            for i in range(order + 1):
                power = u_power
                for _ in range(order + 1 - i):
                    term[m] = power
                    power *= v
                    m += 1
                u_power *= u
            for a in range(p):
                weighted = w * term[a]
                right_side[c, a] += weighted * height
                for b in range(a + 1):
                    A[c, a, b] += weighted * term[b]
        for a in range(p):
            for b in range(a):
                A[c, b, a] = A[c, a, b]
