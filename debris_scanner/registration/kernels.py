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

"""Kernels of the projective registration: normal equations and counts of one direction of a pair.

The cost has two parts. The surface part compares the points of one view with the surface in the image of the
other, point to plane. The rim part compares the rim of one view with the silhouette of the other.

They are compiled, because per-point work in numpy needs a dozen passes over the same few thousand points.
Both carry a point p of view i into view j: X = R_i p + t_i in the target frame, y = R_jᵀ (X - t_j) in view j.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import array_at, inlined, kernel, pointer
from debris_scanner.registration.view_table import (
    ANCHORS,
    DEPTH_MAP,
    EDGES,
    HEIGHT,
    NORMALS,
    ON_EDGE,
    OUTWARD,
    OUTWARD_COUNT,
    POINT_COUNT,
    POINTS,
    RIM_COUNT,
    RIM_NORMALS,
    RIM_POINTS,
    WIDTH,
    Addresses,
    image,
    normal_image,
    open_sides,
    steps,
    vectors,
)
from debris_scanner.sensing.rim import INSET_PX
from debris_scanner.sensing.silhouette import Mask, Steps, distance, unseen

Image = NDArray[np.float32]
Index = NDArray[np.uint16]

# Lengths are multiples of the reference's resolution: its pixel footprint (px), or more if it is noisy.
NEAREST = 50.0  # px: points nearer than this to view j are not projected
HUBER = 2.0  # px, residuals beyond it count linearly

# Of the surface.
MIN_OUTSIDE_COS = 0.5  # surfaces turned further away may be missing: a real stereo camera sees none of them
MIN_FACING_COS = 0.15  # surfaces turned further away are not expected to be seen
LEAST_FACING = 0.3  # cosine, by which a point weighs: more oblique ones weigh no less
NORMAL_COS = 0.8  # matched surfaces face the same way
MASK_TOLERANCE_PX = 2.0
CONTRADICTION = 8.0  # px: this far beside the mask or in free space is a contradiction

# Of the rim.
HULL_WEIGHT = 0.1  # of a point beside the silhouette against a surface point; 1.0 biases the pose
EDGE_WEIGHT = 0.3  # of a point on an edge of the target
MIN_HULL_COS = 0.2  # surfaces seen more obliquely may be missing from the silhouette
EDGE_REACH_PX = 4
EDGE_DEPTH = 5.5  # px: matched edges also agree in depth
EDGE_NORMAL_COS = 0.85
OUTLINE_REACH_PX = 2  # a straight line is fitted to the edge pixels this near
OUTLINE_COS = 0.8  # and facing the same way

_kernel = kernel(fastmath=True)


@_kernel
def accumulate_surface(
    points: Image, normals: Image, anchors: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    depth: Image, normal_map: Image, beside: Steps, sides: Mask, intrinsics: Array,
    resolution: float, usual_range: float, gate: float, shared: float, step: int,
    H: Array, g: Array, counts: Array,
) -> None:  # fmt: skip
    """Point-to-plane terms of every step-th of the source's points in view j's image.

    A residual turns about the source's anchor or, by the share ``shared``, about the place that it met on
    view j: noise that a point shares with its anchor would be in residual and lever arm, and shorten every
    motion.

    Adds to ``H`` (6, 6), upper triangle, and ``g`` (6,), for a left twist of the source in the target frame,
    and to ``counts`` (9,): points, matched, square, visible, in free space, occluded, outside the mask,
    turned away, hidden (:class:`debris_scanner.registration.projective.RegistrationStats`).
    """
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    huber, contradiction, nearest = HUBER * resolution, CONTRADICTION * resolution, NEAREST * resolution
    J = np.empty(6)
    for k in range(0, points.shape[0], step):
        counts[0] += 1
        p0, p1, p2 = anchors[k, 0], anchors[k, 1], anchors[k, 2]
        # Not by the helpers below: with them the compiler sums X, y, b and m in another order (measured).
        X0 = R_i[0, 0] * p0 + R_i[0, 1] * p1 + R_i[0, 2] * p2 + t_i[0]
        X1 = R_i[1, 0] * p0 + R_i[1, 1] * p1 + R_i[1, 2] * p2 + t_i[1]
        X2 = R_i[2, 0] * p0 + R_i[2, 1] * p1 + R_i[2, 2] * p2 + t_i[2]
        d0, d1, d2 = X0 - t_j[0], X1 - t_j[1], X2 - t_j[2]
        y0 = R_j[0, 0] * d0 + R_j[1, 0] * d1 + R_j[2, 0] * d2
        y1 = R_j[0, 1] * d0 + R_j[1, 1] * d1 + R_j[2, 1] * d2
        y2 = R_j[0, 2] * d0 + R_j[1, 2] * d1 + R_j[2, 2] * d2
        if y2 < nearest:
            continue
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        b0 = R_i[0, 0] * n0 + R_i[0, 1] * n1 + R_i[0, 2] * n2
        b1 = R_i[1, 0] * n0 + R_i[1, 1] * n1 + R_i[1, 2] * n2
        b2 = R_i[2, 0] * n0 + R_i[2, 1] * n1 + R_i[2, 2] * n2
        m0 = R_j[0, 0] * b0 + R_j[1, 0] * b1 + R_j[2, 0] * b2
        m1 = R_j[0, 1] * b0 + R_j[1, 1] * b1 + R_j[2, 1] * b2
        m2 = R_j[0, 2] * b0 + R_j[1, 2] * b1 + R_j[2, 2] * b2
        facing = -(m0 * y0 + m1 * y1 + m2 * y2) / (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5
        u = int(np.floor(y0 / y2 * fx + cx + 0.5))
        v = int(np.floor(y1 / y2 * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            counts[6] += not unseen(sides, u, v, w, h)
            continue
        outside = distance(beside, u, v) - MASK_TOLERANCE_PX
        if outside > 0:
            # a plate seen edge-on returns nothing: its absence contradicts no pose
            if outside * y2 / fx > contradiction and abs(facing) > MIN_OUTSIDE_COS:
                counts[6] += 1
            continue
        if facing < MIN_FACING_COS:
            counts[5] += 1  # the target itself may occlude it: no evidence
            continue
        d = depth[v, u]
        if d <= 0:
            continue
        counts[3] += 1
        dz = y2 - d
        if dz < -contradiction and dz < -gate:
            counts[4] += 1
            continue
        q0, q1, q2 = normal_map[v, u, 0], normal_map[v, u, 1], normal_map[v, u, 2]
        # offset of the measured point from its anchor
        f0, f1, f2 = turned(R_i, points[k, 0] - p0, points[k, 1] - p1, points[k, 2] - p2)
        c0, c1, c2 = turned(R_j, q0, q1, q2)
        # the foot is on the pixel's own ray: half a pixel of rounding would bias oblique surfaces
        r = q0 * (y0 - (u - cx) / fx * d) + q1 * (y1 - (v - cy) / fy * d) + q2 * dz
        beyond = shared * r / (q0 * y0 + q1 * y1 + q2 * y2)
        r += c0 * f0 + c1 * f1 + c2 * f2
        if abs(r) > gate or abs(dz) > 4 * gate:
            if dz > 0:
                counts[5] += 1
                counts[8] += 1
            else:
                counts[4] += 1
            continue
        if q0 * m0 + q1 * m1 + q2 * m2 < NORMAL_COS:
            counts[7] += 1
            continue
        weight = 1.0 if abs(r) < huber else huber / abs(r)
        weight *= max(facing, LEAST_FACING)
        counts[1] += 1
        # disparity noise grows with the square of the distance: points further off may scatter more
        referred = r / resolution * min(1.0, (usual_range / y2) ** 2)
        counts[2] += referred * referred
        if q0 * y0 + q1 * y1 + q2 * y2 >= 0:  # seen from behind: that is no place that it met
            continue
        X0, X1, X2 = X0 - beyond * d0, X1 - beyond * d1, X2 - beyond * d2
        add_term(H, g, J, X0, X1, X2, c0, c1, c2, weight, r)


@_kernel
def accumulate_rim(
    points: Image, normals: Image, on_edge: NDArray[np.uint8], R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    beside: Steps, edge: Index, outward: Image, depth: Image, normal_map: Image,
    intrinsics: Array, resolution: float, gate: float, hull: bool, step: int, H: Array, g: Array,
) -> None:  # fmt: skip
    """Add to ``H`` (6, 6), upper triangle, and ``g`` (6,): edges on edges, all else inside the silhouette.

    Without ``hull``, edges alone. That is for a partially occluded target: its silhouette ends at the
    occluder's shadow, and few of the other view's edges are near enough to be matched with that.
    """
    fx, fy, cx, cy = intrinsics
    h, w = edge.shape
    huber, nearest, edge_depth = HUBER * resolution, NEAREST * resolution, EDGE_DEPTH * resolution
    J = np.empty(6)
    for k in range(0, points.shape[0], step):
        X0, X1, X2 = moved(R_i, t_i, points[k, 0], points[k, 1], points[k, 2])
        d0, d1, d2 = X0 - t_j[0], X1 - t_j[1], X2 - t_j[2]
        y0, y1, y2 = turned_back(R_j, d0, d1, d2)
        if y2 < nearest:
            continue
        column, row = y0 / y2 * fx + cx, y1 / y2 * fy + cy
        u, v = int(np.floor(column + 0.5)), int(np.floor(row + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            continue
        b0, b1, b2 = turned(R_i, normals[k, 0], normals[k, 1], normals[k, 2])
        if -(b0 * d0 + b1 * d1 + b2 * d2) < MIN_HULL_COS * (d0 * d0 + d1 * d1 + d2 * d2) ** 0.5:
            continue
        matched = False
        gx, gy, r, weight = 0.0, 0.0, 0.0, 0.0
        if on_edge[k]:
            m0, m1, m2 = turned_back(R_j, b0, b1, b2)
            a, b = _nearest_edge(edge, depth, column, row, y2, edge_depth)
            if a >= 0:
                facing = m0 * normal_map[b, a, 0] + m1 * normal_map[b, a, 1] + m2 * normal_map[b, a, 2]
                matched = facing > EDGE_NORMAL_COS
        if matched:
            gx, gy = outward[edge[b, a], 0], outward[edge[b, a], 1]
            r = (_beyond_outline(edge, outward, column, row, a, b) - INSET_PX) * y2 / fx
            weight = EDGE_WEIGHT
        else:
            # from the centre of the outermost pixel it is half a pixel to its border
            apart = distance(beside, u, v)
            r = (apart - 0.5 - INSET_PX) * y2 / fx
            if not hull or r <= 0 or r > 2 * gate:
                continue
            gx, gy = beside[v, u, 0] / apart, beside[v, u, 1] / apart
            weight = HULL_WEIGHT
        if abs(r) > huber:
            weight *= huber / abs(r)
        gz = -(gx * y0 + gy * y1) / y2
        c0, c1, c2 = turned(R_j, gx, gy, gz)
        add_term(H, g, J, X0, X1, X2, c0, c1, c2, weight, r)


@_kernel
def accumulate_pairs(
    addresses: Addresses, sizes: Addresses, intrinsics: Array, scales: Array, hulls: NDArray[np.int8],
    poses: Array, directions: Addresses, order: Addresses, gate: float, H: Array, g: Array, counts: Array,
) -> None:  # fmt: skip
    """Both kernels over many directions (m, 2) of pairs, into arrays with a row for each.

    ``scales`` (n, 4) holds resolution, usual range, density and shared noise of each view; ``hulls`` (m,) is
    1 for a direction with the whole rim, 0 with edges alone, -1 with none of it.
    """
    for n in order:
        i, j = directions[n]
        own, other, h, w = addresses[i], addresses[j], sizes[j, HEIGHT], sizes[j, WIDTH]
        points, rim_points = sizes[i, POINT_COUNT], sizes[i, RIM_COUNT]
        resolution, usual_range, density, shared = scales[j, 0], scales[j, 1], scales[i, 2], scales[i, 3]
        R_i, t_i = poses[i, :3, :3].copy(), poses[i, :3, 3].copy()
        R_j, t_j = poses[j, :3, :3].copy(), poses[j, :3, 3].copy()
        depth = image(other, DEPTH_MAP, h, w)
        normal_map, beside = normal_image(other, h, w), steps(other, h, w)
        accumulate_surface(
            vectors(own, POINTS, points), vectors(own, NORMALS, points),
            vectors(own, ANCHORS, points), R_i, t_i, R_j, t_j, depth, normal_map, beside,
            open_sides(other), intrinsics[j],
            resolution, usual_range, gate * resolution, shared, 1, H[n], g[n], counts[n],
        )  # fmt: skip
        H[n] /= density
        g[n] /= density
        if hulls[n] >= 0:
            accumulate_rim(
                vectors(own, RIM_POINTS, rim_points), vectors(own, RIM_NORMALS, rim_points),
                array_at(pointer(own[ON_EDGE]), (rim_points,), np.uint8), R_i, t_i, R_j, t_j, beside,
                array_at(pointer(other[EDGES]), (h, w), np.uint16),
                array_at(pointer(other[OUTWARD]), (sizes[j, OUTWARD_COUNT], 2), np.float32), depth,
                normal_map, intrinsics[j], resolution, gate * resolution, hulls[n] > 0, 1, H[n], g[n],
            )  # fmt: skip
        for a in range(6):
            for b in range(a):
                H[n, a, b] = H[n, b, a]


@inlined
def turned(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R (x, y, z)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@inlined
def turned_back(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rᵀ (x, y, z)."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@inlined
def moved(R: Array, t: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R (x, y, z) + t."""
    a, b, c = turned(R, x, y, z)
    return a + t[0], b + t[1], c + t[2]


@inlined
def add_term(
    H: Array, g: Array, J: Array, X0: float, X1: float, X2: float, c0: float, c1: float, c2: float,
    weight: float, r: float,
) -> None:  # fmt: skip
    """Add one residual r with the gradient c at the point X, both in the target frame: J = (X x c, c)."""
    J[0], J[1], J[2] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2, X0 * c1 - X1 * c0
    J[3], J[4], J[5] = c0, c1, c2
    for a in range(6):
        g[a] += weight * J[a] * r
        for b in range(a, 6):
            H[a, b] += weight * J[a] * J[b]


@_kernel
def _beyond_outline(edge: Index, outward: Image, column: float, row: float, u: int, v: int) -> float:
    """Signed distance, pixels, from the straight outline through the edge pixels about (u, v)."""
    h, w = edge.shape
    out0, out1 = outward[edge[v, u], 0], outward[edge[v, u], 1]
    n, mean_u, mean_v = 0, 0.0, 0.0
    for b in range(max(0, v - OUTLINE_REACH_PX), min(h, v + OUTLINE_REACH_PX + 1)):
        for a in range(max(0, u - OUTLINE_REACH_PX), min(w, u + OUTLINE_REACH_PX + 1)):
            k = edge[b, a]
            if k and outward[k, 0] * out0 + outward[k, 1] * out1 > OUTLINE_COS:
                n, mean_u, mean_v = n + 1, mean_u + a, mean_v + b
    # at least the edge pixel itself, for its direction is of unit length
    return float(out0 * (column - mean_u / n) + out1 * (row - mean_v / n))


@_kernel
def _nearest_edge(
    edge: Index, depth: Image, column: float, row: float, z: float, edge_depth: float
) -> tuple[int, int]:
    """Column and row of the nearest edge pixel in reach at about the depth z; -1, -1 without one."""
    h, w = depth.shape
    u, v = int(np.floor(column + 0.5)), int(np.floor(row + 0.5))
    best, found_u, found_v = float(EDGE_REACH_PX * EDGE_REACH_PX), -1, -1
    for b in range(max(0, v - EDGE_REACH_PX), min(h, v + EDGE_REACH_PX + 1)):
        for a in range(max(0, u - EDGE_REACH_PX), min(w, u + EDGE_REACH_PX + 1)):
            if edge[b, a] == 0:
                continue
            apart = (column - a) ** 2 + (row - b) ** 2
            if apart < best and abs(depth[b, a] - z) < edge_depth:
                best, found_u, found_v = apart, a, b
    return found_u, found_v
