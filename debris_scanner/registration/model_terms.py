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

"""Terms of a model in a raw depth image: its surface on what is measured, its edges on what ends there.

The planes are the model's own, so that no plane has to be fitted in the image. A point of the model is free
from the image's noise, and so is its place among the pixels: what is measured there, along the model's
normal, is the residual.

Where a face of the target ends in front of something far, or of nothing, the image ends, too. So an edge is
sought along the line that leads out of its face, a few pixels to either side of where it is expected.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel
from debris_scanner.registration.kernels import (
    EDGE_DEPTH,
    HUBER,
    LEAST_FACING,
    MIN_FACING_COS,
    add_term,
    moved,
    turned,
    turned_back,
)
from debris_scanner.sensing.rim import INSET_PX, MIN_EDGE_COS

Image = NDArray[np.float32]

REACH_PX = 4  # of the search for an edge, to either side
BEYOND_PX = 2  # behind an edge there is nothing of the face for so far

_kernel = kernel(fastmath=True)


@_kernel
def accumulate_model(
    points: Image, normals: Image, R: Array, t: Array, depth: Image, intrinsics: Array, resolution: float,
    gate: float, weight: float, step: int, H: Array, g: Array,
) -> float:  # fmt: skip
    """Point-to-plane terms of every step-th point of a model in a depth image.

    Returns how many pixels the matched points would cover, were each of them a unit of area.

    R and t carry a point into the camera's frame. Adds to ``H`` (6, 6), upper triangle, and ``g`` (6,), for
    a left twist of the camera in the model's frame.
    """
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    huber, covered = HUBER * resolution, 0.0
    eye0, eye1, eye2 = turned_back(R, -t[0], -t[1], -t[2])
    J = np.empty(6)
    for k in range(0, points.shape[0], step):
        p0, p1, p2 = points[k, 0], points[k, 1], points[k, 2]
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        towards = n0 * (eye0 - p0) + n1 * (eye1 - p1) + n2 * (eye2 - p2)
        if towards <= 0:
            continue
        y0, y1, y2 = moved(R, t, p0, p1, p2)
        facing = towards / (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5
        if facing < MIN_FACING_COS or y2 <= 0:
            continue
        u = int(np.floor(y0 / y2 * fx + cx + 0.5))
        v = int(np.floor(y1 / y2 * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            continue
        d = depth[v, u]
        if d <= 0 or abs(y2 - d) > 4 * gate:
            continue
        m0, m1, m2 = turned(R, n0, n1, n2)
        r = m0 * (y0 - (u - cx) / fx * d) + m1 * (y1 - (v - cy) / fy * d) + m2 * (y2 - d)
        if abs(r) > gate:
            continue
        covered += facing * fx * fy / (y2 * y2)
        trust = weight * max(facing, LEAST_FACING)
        if abs(r) > huber:
            trust *= huber / abs(r)
        add_term(H, g, J, p0, p1, p2, n0, n1, n2, trust, -r)
    return covered


@_kernel
def accumulate_edges(
    points: Image, normals: Image, outward: Image, R: Array, t: Array, depth: Image, intrinsics: Array,
    resolution: float, weight: float, H: Array, g: Array,
) -> None:  # fmt: skip
    """Terms of the edge points (n, 3) of a model, at which faces end.

    Args: as :func:`accumulate_model`, and ``outward`` (n, 3), the unit directions out of the faces.
    """
    fx, fy, cx, cy = intrinsics
    huber, level = HUBER * resolution, EDGE_DEPTH * resolution
    J = np.empty(6)
    for k in range(points.shape[0]):
        p0, p1, p2 = points[k, 0], points[k, 1], points[k, 2]
        y0, y1, y2 = moved(R, t, p0, p1, p2)
        if y2 <= 0:
            continue
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        o0, o1, o2 = outward[k, 0], outward[k, 1], outward[k, 2]
        m0, m1, m2 = turned(R, n0, n1, n2)
        if -(m0 * y0 + m1 * y1 + m2 * y2) < MIN_EDGE_COS * (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5:
            continue
        # along the edge, and across it in the image
        e0, e1, e2 = turned(R, n1 * o2 - n2 * o1, n2 * o0 - n0 * o2, n0 * o1 - n1 * o0)
        q0, q1, q2 = turned(R, o0, o1, o2)
        a0, a1 = fx * (e0 - y0 / y2 * e2), fy * (e1 - y1 / y2 * e2)
        b0, b1 = fx * (q0 - y0 / y2 * q2), fy * (q1 - y1 / y2 * q2)
        gx, gy = -a1, a0
        if gx * b0 + gy * b1 < 0:
            gx, gy = a1, -a0
        length = (gx * gx + gy * gy) ** 0.5
        if length <= 0:
            continue
        gx, gy = gx / length, gy / length
        column, row = y0 / y2 * fx + cx, y1 / y2 * fy + cy
        end = _end(depth, column, row, gx, gy, y2, level)
        if end > REACH_PX:
            continue
        # the last pixel's border is half a pixel beyond its centre, the true outline INSET_PX
        r = -(end - 0.5 + INSET_PX) * y2 / fx
        trust = weight if abs(r) < huber else weight * huber / abs(r)
        c0, c1, c2 = turned_back(R, gx, gy, -(gx * y0 + gy * y1) / y2)
        add_term(H, g, J, p0, p1, p2, c0, c1, c2, trust, -r)


@_kernel
def points_on_rows(points: Image, R: Array, t: Array, intrinsics: Array, every: int) -> NDArray[np.intp]:
    """Indices of the points of a model that fall on every so many-th row of an image."""
    _, fy, _, cy = intrinsics
    chosen = np.empty(len(points), np.intp)
    n = 0
    for k in range(len(points)):
        _, y1, y2 = moved(R, t, points[k, 0], points[k, 1], points[k, 2])
        if y2 > 0 and int(np.floor(y1 / y2 * fy + cy + 0.5)) % every == 0:
            chosen[n] = k
            n += 1
    return chosen[:n]


@_kernel
def _end(depth: Image, column: float, row: float, gx: float, gy: float, z: float, level: float) -> float:
    """How far along a direction, pixels, surface at about the depth z ends; beyond reach if it does not."""
    h, w = depth.shape
    inside, end, off = False, 2.0 * REACH_PX, 0
    for k in range(-2 * REACH_PX, 2 * (REACH_PX + BEYOND_PX) + 1):
        u = int(np.floor(column + 0.5 * k * gx + 0.5))
        v = int(np.floor(row + 0.5 * k * gy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            return 2.0 * REACH_PX
        d = depth[v, u]
        if d > 0 and abs(d - z) < level:
            inside, off = True, 0
            continue
        if not inside:
            continue
        if 0 < d < z:  # something is in front
            return 2.0 * REACH_PX
        if off == 0:
            end = 0.5 * k - 0.25
        off += 1
        if off > 2 * BEYOND_PX:
            return end
    return 2.0 * REACH_PX
