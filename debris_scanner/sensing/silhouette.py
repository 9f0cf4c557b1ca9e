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

"""The target's silhouette: holes closed, blurred, and how far it is from there.

These are scipy.ndimage's binary_closing, gaussian_filter and distance_transform_edt, three to four times as
fast.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.optional import inlined, kernel

Mask = NDArray[np.bool_]
Image = NDArray[np.float32]
Steps = NDArray[np.int16]

FAR = 20000  # px, in both directions
MARGIN_PX = 16  # free border of a target's window: how far beside a silhouette is measured in it

_kernel = kernel()


def open_sides(mask: Mask) -> Mask:
    """Left, right, upper and lower side (4,) of a window beyond which nothing is known.

    A window has a free border around its target (:data:`MARGIN_PX`), but where the image ends.
    """
    h, w = mask.shape
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return np.zeros(4, np.bool_)
    free = (columns[0], w - 1 - columns[-1], rows[0], h - 1 - rows[-1])
    return np.array(free) < MARGIN_PX


@inlined
def unseen(sides: Mask, u: int, v: int, w: int, h: int) -> bool:
    """Whether a pixel outside of a window of w x h pixels lies beyond one of its :func:`open_sides`."""
    return (u < 0 and sides[0]) or (u >= w and sides[1]) or (v < 0 and sides[2]) or (v >= h and sides[3])


@_kernel
def closed(mask: Mask, reach: int) -> Mask:
    """A mask with holes and slits narrower than ``2 reach + 1`` pixels closed; 0 beyond the image."""
    return _spread(_spread(mask, reach, True), reach, False)


@_kernel
def eroded(mask: Mask, reach: int) -> Mask:
    """The part of a mask at least ``reach`` pixels inside."""
    return _spread(mask, reach, False)


@_kernel
def blurred(mask: Mask, sigma: float) -> Image:
    """A mask (h, w) under a Gaussian of ``sigma`` pixels, mirrored at the borders: scipy's, to the bit."""
    h, w = mask.shape
    n = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 / (sigma * sigma) * np.arange(-n, n + 1) ** 2)
    weights = (weights / weights.sum())[n:]  # by distance
    values = mask.astype(np.float32)
    out = np.empty((h, w), np.float32)
    sums = np.empty(w, np.float64)
    line = np.empty(w + 2 * n, np.float64)
    for v in range(h):
        for u in range(w):
            sums[u] = values[v, u] * weights[0]
        for k in range(n, 0, -1):
            above, below, weight = values[_mirrored(v - k, h)], values[_mirrored(v + k, h)], weights[k]
            for u in range(w):
                sums[u] += (above[u] + below[u]) * weight
        for u in range(w):
            line[n + u] = np.float32(sums[u])
        for k in range(n):
            line[k] = line[n + _mirrored(k - n, w)]
            line[n + w + k] = line[n + _mirrored(w + k, w)]
        for u in range(w):
            sums[u] = line[n + u] * weights[0]
        for k in range(n, 0, -1):
            left, right, weight = line[n - k : n - k + w], line[n + k : n + k + w], weights[k]
            for u in range(w):
                sums[u] += (left[u] + right[u]) * weight
        for u in range(w):
            out[v, u] = sums[u]
    return out


@_kernel
def steps_beside(mask: Mask, every: int = 1) -> Steps:
    """Columns and rows (h, w, 2) from the nearest pixel of a mask to every pixel: 0, 0 inside.

    Exact, in two passes (Felzenszwalb, Huttenlocher 2012). Of an empty mask, :data:`FAR`, and so it is
    in all but every so many-th row.
    """
    h, w = mask.shape
    steps = np.full((h, w, 2), FAR, np.int16)
    none = 2 * (h + w)
    rows = _rows_to_mask(mask, none)
    hull = np.empty(w, np.int64)  # columns whose parabolas form the lower envelope
    start = np.empty(w + 1, np.float64)  # where each of them begins
    for v in range(0, h, every):
        size = 0
        for u in range(w):
            if rows[v, u] >= none:
                continue
            f = float(rows[v, u]) ** 2 + u * u
            cross = -np.inf
            while size:
                p = hull[size - 1]
                cross = (f - (float(rows[v, p]) ** 2 + p * p)) / (2.0 * (u - p))
                if cross > start[size - 1]:
                    break
                size -= 1
                cross = -np.inf
            hull[size], start[size] = u, cross
            size += 1
        if not size:
            continue
        k = 0
        for u in range(w):
            while k + 1 < size and start[k + 1] < u:
                k += 1
            down = rows[v, hull[k]]
            above = v >= down and mask[v - down, hull[k]]
            steps[v, u, 0] = u - hull[k]
            steps[v, u, 1] = down if above else -down
    return steps


@inlined
def distance(beside: Steps, u: int, v: int) -> float:
    """Pixels from a mask to column u and row v, by the steps (h, w, 2) of :func:`steps_beside`."""
    columns, rows = float(beside[v, u, 0]), float(beside[v, u, 1])
    return (columns * columns + rows * rows) ** 0.5


@_kernel
def _spread(mask: Mask, reach: int, grow: bool) -> Mask:
    """A mask grown, or else shrunk, by a square of ``2 reach + 1`` pixels: first rows, then columns."""
    h, w = mask.shape
    wide = np.empty((h, w), np.bool_)
    for v in range(h):
        run = 0  # set pixels in the window that moves along the row
        for u in range(min(reach, w)):
            run += mask[v, u]
        for u in range(w):
            if u + reach < w:
                run += mask[v, u + reach]
            if u - reach - 1 >= 0:
                run -= mask[v, u - reach - 1]
            wide[v, u] = run > 0 if grow else run == 2 * reach + 1
    out = np.empty((h, w), np.bool_)
    count = np.zeros(w, np.int32)
    for v in range(min(reach, h)):
        for u in range(w):
            count[u] += wide[v, u]
    for v in range(h):
        if v + reach < h:
            for u in range(w):
                count[u] += wide[v + reach, u]
        if v - reach - 1 >= 0:
            for u in range(w):
                count[u] -= wide[v - reach - 1, u]
        for u in range(w):
            out[v, u] = count[u] > 0 if grow else count[u] == 2 * reach + 1
    return out


@_kernel
def _mirrored(k: int, size: int) -> int:
    k %= 2 * size
    return k if k < size else 2 * size - 1 - k


@_kernel
def _rows_to_mask(mask: Mask, none: int) -> NDArray[np.int32]:
    """Rows from every pixel to the nearest mask pixel in its column; ``none`` or more without one."""
    h, w = mask.shape
    rows = np.empty((h, w), np.int32)
    for u in range(w):
        rows[0, u] = 0 if mask[0, u] else none
    for v in range(1, h):
        for u in range(w):
            rows[v, u] = 0 if mask[v, u] else rows[v - 1, u] + 1
    for v in range(h - 2, -1, -1):
        for u in range(w):
            rows[v, u] = min(rows[v, u], rows[v + 1, u] + 1)
    return rows
