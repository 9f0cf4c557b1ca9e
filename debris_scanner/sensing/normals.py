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

"""Normals of an organised depth image by a plane fit in disparity, also of a porous one.

A plane is a linear function of the pixel in 1/z, and the sensor's noise is uniform there. A
least-squares fit over a small window therefore gives normal and smoothed depth in one pass, at a fraction of
the cost of a neighbour search (docs/performance.md). The kernel processes row by row, all pixels of a row at
a time, so that the compiler vectorises eight of them.

A surface that returns light from some of its pixels only gives a porous image. Shiny insulation does so
(Trowbridge 2014, 1.2.6 and 6.2.3): where it faces the sensor one pixel in two or three returns, where it is
turned away none. Planes are fitted through the pores, and a pixel without return is no evidence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame, median_footprint
from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel
from debris_scanner.core.parameters import parameter
from debris_scanner.sensing.silhouette import Mask, closed, open_sides

Image = NDArray[np.float32]

OUTLINE_REACH_PX = 2  # holes and slits this narrow are closed in the outline
PORES = 0.5  # share of the outline that returns nothing: 0.6 of insulation, at most 0.4 of anything else
FILL_REACH_PX = 3  # pores are filled from measurements this near
LEAST_NEIGHBOURS = 4

_FAR = np.float32(1e6)  # m: depth of a missing pixel, far from any measured one
_ZERO, _ONE = np.float32(0), np.float32(1)

_kernel = kernel(fastmath=True)


@dataclass(frozen=True)
class NormalSettings:
    """Window of the plane fit."""

    radius: int = parameter(5, 'half width of the fitted window: (2 radius + 1)² pixels', 'px', 1, 20)

    @property
    def inner_radius(self) -> int:
        """Half width, px, of the window that sets the depth."""
        return max(1, self.radius // 2)

    @property
    def max_jump(self) -> float:
        """Neighbours further away in depth, px, are left out: a plane seen at 63 degrees spans as much."""
        return 2.0 * self.radius


def fit_normals(
    depth: NDArray[np.float32], camera: Camera, settings: NormalSettings
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Plane-fitted depth (h, w) in metres and unit normals (h, w, 3) towards the sensor.

    Pixels without depth, or with too few neighbours for a fit, are 0 in both. In a porous image the pores are
    fitted as well.
    """
    fitted = np.zeros_like(depth)
    normals = np.zeros((*depth.shape, 3), np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    max_jump = settings.max_jump * median_footprint(depth, camera)
    if is_porous(depth, outline(depth)):
        depth = filled(depth, max_jump)
    _plane_fit(depth, intrinsics, settings.radius, settings.inner_radius, max_jump, 1, fitted, normals)
    return fitted, normals


def fit_rows(frame: TargetFrame, settings: NormalSettings, every: int) -> tuple[Image, Image]:
    """As :func:`fit_normals`, of every so many-th row of a frame that is not porous; the others stay 0."""
    c = frame.camera
    fitted, normals = np.zeros_like(frame.depth), np.zeros((*frame.depth.shape, 3), np.float32)
    intrinsics, max_jump = np.array([c.fx, c.fy, c.cx, c.cy]), settings.max_jump * frame.footprint
    _plane_fit(
        frame.depth, intrinsics, settings.radius, settings.inner_radius, max_jump, every, fitted, normals
    )
    return fitted, normals


def outline(depth: Image) -> Mask:
    """Outline of the target in a depth image (h, w), small holes closed.

    At an open side of the window the target goes on as it ends.
    """
    mask, reach = depth > 0, 2 * OUTLINE_REACH_PX
    left, right, above, below = reach * open_sides(mask)
    if left + right + above + below:
        (h, w), mask = mask.shape, np.pad(mask, ((above, below), (left, right)), mode='edge')
        return np.ascontiguousarray(closed(mask, OUTLINE_REACH_PX)[above : above + h, left : left + w])
    return np.asarray(closed(mask, OUTLINE_REACH_PX))


def is_porous(depth: Image, within: Mask) -> bool:
    """Whether most pixels within the outline return nothing."""
    return bool(np.count_nonzero(depth > 0) < (1 - PORES) * np.count_nonzero(within))


@kernel()
def filled(depth: Image, max_jump: float) -> Image:
    """Depth (h, w), metres, with each pore filled by the mean inverse depth of its measured neighbours.

    Neighbours more than ``max_jump``, metres, behind the nearest are left out; a pore with too few stays.
    """
    h, w = depth.shape
    out = depth.copy()
    for v in range(h):
        for u in range(w):
            if depth[v, u] > 0:
                continue
            rows = range(max(0, v - FILL_REACH_PX), min(h, v + FILL_REACH_PX + 1))
            columns = range(max(0, u - FILL_REACH_PX), min(w, u + FILL_REACH_PX + 1))
            nearest = np.inf
            for b in rows:
                for a in columns:
                    if 0 < depth[b, a] < nearest:
                        nearest = depth[b, a]
            count, total = 0, 0.0
            for b in rows:
                for a in columns:
                    if 0 < depth[b, a] < nearest + max_jump:
                        count += 1
                        total += 1 / depth[b, a]
            if count >= LEAST_NEIGHBOURS:
                out[v, u] = count / total
    return out


@_kernel
def _plane_fit(
    depth: Image, intrinsics: Array, radius: int, inner: int, max_jump: float, every: int, fitted: Image,
    normals: Image,
) -> None:  # fmt: skip
    h, w = depth.shape
    fx, fy, cx, cy = intrinsics
    enough = 12 + radius * radius * 0.5
    border = max(radius, inner)
    z, q = _bordered(depth, border)
    row = np.empty((5, w), np.float32)
    wide = np.empty((9, w), np.float32)
    near = np.empty((4, w), np.float32)
    for v in range(0, h, every):
        first, last = _extent(depth[v])
        if first > last:
            continue
        span = slice(first + border, last + 1 + border)
        _wide_sums(z, q, v + border, span, radius, max_jump, row, wide)
        _near_sums(z, q, v + border, span, inner, max_jump, near)
        for k in range(last + 1 - first):
            u = first + k
            n = wide[0, k]
            if depth[v, u] <= 0 or n < enough:
                continue
            mx, my, mq = wide[1, k] / n, wide[2, k] / n, wide[6, k] / n
            cxx, cxy, cyy = wide[3, k] / n - mx * mx, wide[4, k] / n - mx * my, wide[5, k] / n - my * my
            cxq, cyq = wide[7, k] / n - mx * mq, wide[8, k] / n - my * mq
            det = cxx * cyy - cxy * cxy
            if det < 0.5:  # the neighbours lie on a line
                continue
            a = (cxq * cyy - cyq * cxy) / det
            b = (cyq * cxx - cxq * cxy) / det
            centre = q[v + border, u + border]
            q0 = centre + mq - a * mx - b * my
            if q0 <= 0:
                continue
            # The wide window rounds ridges, oblique ones more, and that biases registration towards the
            # motion. So the level comes from the nearest pixels, the slope from all. The pixel itself is
            # left out: its noise must not be in both the point and its anchor.
            others = near[0, k] - 1
            if others > 0:
                q0 = centre + (near[3, k] - a * near[1, k] - b * near[2, k]) / others
                if q0 <= 0:
                    continue
            # 1/z = nx' (u-cx)/fx + ny' (v-cy)/fy + nz': the plane's normal up to scale
            nx, ny = a * fx, b * fy
            nz = q0 - a * (u - cx) - b * (v - cy)
            length = (nx * nx + ny * ny + nz * nz) ** 0.5
            fitted[v, u] = 1.0 / q0
            normals[v, u, 0] = -nx / length
            normals[v, u, 1] = -ny / length
            normals[v, u, 2] = -nz / length


@_kernel
def _bordered(depth: Image, border: int) -> tuple[Image, Image]:
    """Depth, ``_FAR`` where there is none, and its inverse, with a border so that no window is cut."""
    h, w = depth.shape
    z = np.full((h + 2 * border, w + 2 * border), _FAR, np.float32)
    q = np.zeros((h + 2 * border, w + 2 * border), np.float32)
    for v in range(h):
        for u in range(w):
            if depth[v, u] > 0:
                z[v + border, u + border] = depth[v, u]
                q[v + border, u + border] = _ONE / depth[v, u]
    return z, q


@_kernel
def _extent(row: Image) -> tuple[int, int]:
    """First and last pixel with depth; without any, the first is beyond the last."""
    first, last = len(row), -1
    for u in range(len(row)):
        if row[u] > 0:
            first, last = min(first, u), u
    return first, last


@_kernel
def _wide_sums(
    z: Image, q: Image, v: int, span: slice, radius: int, max_jump: float, row: Image, sums: Image
) -> None:
    """Over the window around each pixel of a row: 1, x, y, xx, xy, yy, q, xq, yq, in ``sums`` (9, n).

    x and y count from the pixel, and q is the inverse depth less its own, so single precision suffices.
    """
    jump = np.float32(max_jump)
    n = span.stop - span.start
    zc, qc = z[v, span], q[v, span]
    count, sx, sxx, sq, sxq = row[0, :n], row[1, :n], row[2, :n], row[3, :n], row[4, :n]
    sums[:, :n] = 0
    for i in range(-radius, radius + 1):
        y = np.float32(i)
        zi, qi = z[v + i, span], q[v + i, span]
        for u in range(n):
            count[u] = _ONE if abs(zi[u] - zc[u]) < jump else _ZERO
            sq[u] = (qi[u] - qc[u]) * count[u]
            sx[u] = sxx[u] = sxq[u] = _ZERO
        for j in range(1, radius + 1):  # left and right at once
            x = np.float32(j)
            left, right = slice(span.start - j, span.stop - j), slice(span.start + j, span.stop + j)
            zl, ql, zr, qr = z[v + i, left], q[v + i, left], z[v + i, right], q[v + i, right]
            for u in range(n):
                a = _ONE if abs(zl[u] - zc[u]) < jump else _ZERO
                b = _ONE if abs(zr[u] - zc[u]) < jump else _ZERO
                c, d = (ql[u] - qc[u]) * a, (qr[u] - qc[u]) * b
                count[u] += a + b
                sx[u] += x * (b - a)
                sxx[u] += x * x * (a + b)
                sq[u] += c + d
                sxq[u] += x * (d - c)
        for u in range(n):
            sums[0, u] += count[u]
            sums[1, u] += sx[u]
            sums[2, u] += y * count[u]
            sums[3, u] += sxx[u]
            sums[4, u] += y * sx[u]
            sums[5, u] += y * y * count[u]
            sums[6, u] += sq[u]
            sums[7, u] += sxq[u]
            sums[8, u] += y * sq[u]


@_kernel
def _near_sums(z: Image, q: Image, v: int, span: slice, inner: int, max_jump: float, sums: Image) -> None:
    """Over a smaller window: 1, x, y, q, in ``sums`` (4, n)."""
    jump = np.float32(max_jump)
    n = span.stop - span.start
    zc, qc = z[v, span], q[v, span]
    sums[:, :n] = 0
    for i in range(-inner, inner + 1):
        y = np.float32(i)
        for j in range(-inner, inner + 1):
            x = np.float32(j)
            beside = slice(span.start + j, span.stop + j)
            zi, qi = z[v + i, beside], q[v + i, beside]
            for u in range(n):
                a = _ONE if abs(zi[u] - zc[u]) < jump else _ZERO
                sums[0, u] += a
                sums[1, u] += x * a
                sums[2, u] += y * a
                sums[3, u] += (qi[u] - qc[u]) * a
