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

"""What an error of the depth that stays in the image does to the residuals of a registered pair.

If the depth is too large by the share b at a pixel, the point that is carried over lies b p too far out along
its ray, and so does the place that it meets. Of a residual r = q · (y - foot), with the normal q,

    dr = q · (R p) db(p) - q · foot db(foot)

is due to that. b is linear in the coefficients of a :class:`debris_scanner.sensing.depth_offset.DepthOffset`.
The terms are those of :func:`debris_scanner.registration.kernels.accumulate_surface`, thinned.
"""

from collections.abc import Sequence

import numpy as np

from debris_scanner.core.geometry import Array, parts
from debris_scanner.core.optional import inlined, kernel
from debris_scanner.registration.kernels import (
    HUBER,
    LEAST_FACING,
    MIN_FACING_COS,
    NEAREST,
    NORMAL_COS,
    Image,
    moved,
    turned,
)
from debris_scanner.sensing.depth_offset import SUPPORT, DepthOffset, spline_weights
from debris_scanner.sensing.views import View

EVERY = 4  # of the points that are looked at: their neighbours' noise is nearly theirs

_kernel = kernel(fastmath=True)
_weights = inlined(spline_weights)


class OffsetEquations:
    """Normal equations of posed views for the m coefficients of an offset that they still have.

    Args:
        views: n of them.
        poses: T_target_view (4, 4) of each.
        offset: on whose lattice.

    ``twist`` (n, 6, m) is the product of the coefficients with a left twist of each view, target frame; ``H``
    (m, m) and ``g`` (m,) are of the coefficients alone; ``seen`` (m,) is how much each counted.
    """

    def __init__(self, views: Sequence[View], poses: Sequence[Array], offset: DepthOffset) -> None:
        m = offset.coefficients.size
        self.twist = np.zeros((len(views), 6, m))
        self.g, self.seen = np.zeros(m), np.zeros(m)
        self._half = np.zeros((m, m))
        self._lattice = np.array([offset.step, *offset.first, *offset.coefficients.shape])
        self._views = views
        self._poses = [parts(T) for T in poses]

    @property
    def H(self) -> Array:
        """(m, m), of the coefficients."""
        return np.asarray(self._half + self._half.T)

    def add_pair(self, i: int, j: int, gate: float, weight: float) -> None:
        """Add both directions of a pair, by index; ``gate`` in multiples of the resolution (px)."""
        for source, other in ((i, j), (j, i)):
            a, b = self._views[source], self._views[other]
            _accumulate(
                a.points, a.normals, a.anchors, *self._poses[source], *self._poses[other],
                b.depth_map, b.normal_map, b.intrinsics, b.resolution, gate * b.resolution,
                EVERY * weight / a.density, self._lattice,
                self.twist[source], self.twist[other], self._half, self.g, self.seen,
            )  # fmt: skip


@_kernel
def _accumulate(
    points: Image, normals: Image, anchors: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    depth: Image, normal_map: Image, intrinsics: Array, resolution: float, gate: float, stands_for: float,
    lattice: Array, twist_i: Array, twist_j: Array, half: Array, g: Array, seen: Array,
) -> None:  # fmt: skip
    """Add one direction of a pair; see ``accumulate_surface`` and :class:`OffsetEquations`."""
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    huber, nearest = HUBER * resolution, NEAREST * resolution
    R, t = R_j.T @ R_i, R_j.T @ (t_i - t_j)
    index, value = np.zeros(2 * SUPPORT * SUPPORT, np.int64), np.zeros(2 * SUPPORT * SUPPORT)
    J = np.empty(6)
    for k in range(0, points.shape[0], EVERY):
        p = anchors[k]
        c0, c1, c2 = turned(R, p[0], p[1], p[2])
        y0, y1, y2 = c0 + t[0], c1 + t[1], c2 + t[2]
        if y2 < nearest:
            continue
        u, v = int(np.floor(y0 / y2 * fx + cx + 0.5)), int(np.floor(y1 / y2 * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h or depth[v, u] <= 0:
            continue
        m0, m1, m2 = turned(R, normals[k, 0], normals[k, 1], normals[k, 2])
        facing = -(m0 * y0 + m1 * y1 + m2 * y2) / (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5
        q, d = normal_map[v, u], depth[v, u]
        if facing < MIN_FACING_COS or q[0] * m0 + q[1] * m1 + q[2] * m2 < NORMAL_COS:
            continue
        across, down = (u - cx) / fx, (v - cy) / fy
        f0, f1, f2 = turned(R, points[k, 0] - p[0], points[k, 1] - p[1], points[k, 2] - p[2])
        r = q[0] * (y0 - across * d + f0) + q[1] * (y1 - down * d + f1) + q[2] * (y2 - d + f2)
        if abs(r) > gate or abs(y2 - d) > 4 * gate:
            continue
        weight = stands_for * max(facing, LEAST_FACING)
        if abs(r) > huber:
            weight *= huber / abs(r)
        source, met = -(q[0] * c0 + q[1] * c1 + q[2] * c2), (q[0] * across + q[1] * down + q[2]) * d
        if p[2] == 0:
            continue
        _spline(lattice, p[0] / p[2], p[1] / p[2], source, index, value, 0)
        _spline(lattice, across, down, met, index, value, SUPPORT * SUPPORT)
        n0, n1, n2 = turned(R_j, q[0], q[1], q[2])
        X0, X1, X2 = moved(R_j, t_j, y0, y1, y2)
        J[0], J[1], J[2] = X1 * n2 - X2 * n1, X2 * n0 - X0 * n2, X0 * n1 - X1 * n0
        J[3], J[4], J[5] = n0, n1, n2
        for a in range(len(index)):
            by = weight * value[a]
            g[index[a]] += by * r
            seen[index[a]] += abs(by)
            for b in range(a):
                half[index[a], index[b]] += by * value[b]
            half[index[a], index[a]] += 0.5 * by * value[a]
            for b in range(6):
                twist_i[b, index[a]] += by * J[b]
                twist_j[b, index[a]] -= by * J[b]


@inlined
def _spline(
    lattice: Array, x: float, y: float, factor: float, index: Array, value: Array, start: int
) -> None:
    """Write the coefficients that a spline's value at the tangents x, y is made of, and their weights."""
    step, columns, rows = lattice[0], int(lattice[3]), int(lattice[4])
    if step == 0:
        return
    s = min(max(x / step - lattice[1], 0.0), columns - SUPPORT + 1 - 1e-9)
    t = min(max(y / step - lattice[2], 0.0), rows - SUPPORT + 1 - 1e-9)
    i, j = int(s), int(t)
    across, down = _weights(s - i), _weights(t - j)
    n = start
    for a in range(SUPPORT):
        for b in range(SUPPORT):
            index[n] = (i + a) * rows + j + b
            value[n] = factor * across[a] * down[b]
            n += 1
