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

"""An atlas: the surface of a closed mesh laid flat, in charts side by side in one image.

Each triangle is seen along one of six directions. Connected triangles of one direction are a chart, its
parallel projection: texels are as large on faces across the direction, and thinner on oblique ones. Charts
are packed as Lévy et al. (2002) do: one after another, the longest first, each dropped onto those before it.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel

EVENINGS = 3  # of the normals by which a direction is chosen: without them noise makes specks
LEAST_FACING = 0.1  # cosine to its direction; a texel on such a face is ten times as long as wide
MAJORITY_ROUNDS = 20  # in which triangles join two of their three neighbours
LAYERS = 4  # in which what lies behind other parts of its chart gets charts of its own
MARGIN = 1  # texels around those that interpolation asks: the next coarser image asks more
FULL = 0.6  # share of the image that charts fill, usually: it is then about square

_Ints = NDArray[np.int32]


@dataclass(frozen=True)
class Atlas:
    """Where the triangles of a mesh lie in an image (height, width).

    A vertex between charts comes once for each of them.
    """

    vertices: _Ints  # (k,) the mesh's
    triangles: _Ints  # (t, 3) of these k, in the mesh's order
    xy: NDArray[np.float32]  # (k, 2) column and row; integers are the centres of texels
    width: int
    height: int

    def faces(self) -> _Ints:
        """Triangle (height, width) that covers each texel's centre, -1 between the charts."""
        flat = np.column_stack([self.xy, np.ones(len(self.xy), np.float32)])
        return rasterise(flat, self.triangles, self.height, self.width)[0]


def make_atlas(vertices: NDArray[np.floating], triangles: _Ints, texel: float) -> Atlas:
    """Atlas of a closed mesh: vertices (m, 3), triangles (t, 3), edge of a texel, all in one unit."""
    corners = vertices[triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    # axes that most faces lie across or along: flat sides come whole
    axes = np.linalg.eigh(unit.T @ normals)[1].T
    directions = np.concatenate([axes, -axes])
    # of each direction two axes of the image across it, and itself
    frames = np.stack([np.tile(np.roll(axes, -k, axis=0), (2, 1)) for k in (1, 2)] + [directions], axis=1)
    beside = _neighbours(triangles, len(vertices))
    evened = _evened(normals, triangles, len(vertices))
    direction = _chosen(evened @ directions.T, unit @ directions.T, beside)
    layer = direction
    for _ in range(LAYERS):
        chart = _connected(layer, beside)
        # a vertex once for each chart that it belongs to
        keys = chart[:, None].astype(np.int64) * len(vertices) + triangles
        kept, first, index = np.unique(keys, return_index=True, return_inverse=True)
        index = index.reshape(-1, 3).astype(np.int32)
        chart_of = kept // len(vertices)
        seen_as = frames[direction.repeat(3)[first]]
        flat = np.einsum('kij,kj->ki', seen_as, vertices[triangles.ravel()[first]] / texel)
        xy, width, height = _packed(_upright(flat[:, :2], chart_of), index, chart, chart_of)
        hidden = _hidden(np.column_stack([xy, flat[:, 2]]), index, height, width)
        if not hidden.any():
            break
        layer = layer + hidden * len(directions)
    return Atlas((kept % len(vertices)).astype(np.int32), index, xy, width, height)


@kernel()
def rasterise(
    points: NDArray[np.float32], triangles: _Ints, height: int, width: int
) -> tuple[_Ints, NDArray[np.float32]]:
    """The triangle (height, width) on top at each pixel, -1 where none is, and its value there, or 0.

    Args:
        points: (m, 3) column, row, and a value above 0, linear on each triangle; the largest is on top,
            among equal ones the first.
        triangles: (t, 3); those with a corner of value 0 are left out.
        height: of the image.
        width: of the image.
    """
    face = np.full((height, width), -1, np.int32)
    top = np.zeros((height, width), np.float32)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        az, bz, cz = points[a, 2], points[b, 2], points[c, 2]
        if not (az > 0 and bz > 0 and cz > 0):
            continue
        ax, ay = np.float64(points[a, 0]), np.float64(points[a, 1])
        bx, by = points[b, 0] - ax, points[b, 1] - ay
        cx, cy = points[c, 0] - ax, points[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0:
            continue
        u0, u1 = ax + min(0.0, bx, cx), ax + max(0.0, bx, cx)
        v0, v1 = ay + min(0.0, by, cy), ay + max(0.0, by, cy)
        if not (u1 >= 0 and v1 >= 0 and u0 <= width - 1 and v0 <= height - 1):
            continue
        for v in range(int(np.ceil(max(v0, 0.0))), int(np.floor(min(v1, height - 1.0))) + 1):
            for u in range(int(np.ceil(max(u0, 0.0))), int(np.floor(min(u1, width - 1.0))) + 1):
                x, y = u - ax, v - ay
                of_b, of_c = (x * cy - y * cx) / area, (bx * y - by * x) / area
                if of_b < -1e-9 or of_c < -1e-9 or of_b + of_c > 1 + 1e-9:
                    continue
                value = az + of_b * (bz - az) + of_c * (cz - az)
                if value > top[v, u]:
                    top[v, u] = value
                    face[v, u] = t
    return face, top


def _neighbours(triangles: _Ints, count: int) -> NDArray[np.int64]:
    """The triangle (t, 3) beyond each side; itself where there is none."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    sides = ends[:, 0].astype(np.int64) * count + ends[:, 1]
    order = np.argsort(sides, kind='stable')
    pairs = sides[order][1:] == sides[order][:-1]
    one, other = order[:-1][pairs], order[1:][pairs]
    beside = np.repeat(np.arange(len(triangles)), 3)
    beside[one], beside[other] = other // 3, one // 3
    return beside.reshape(-1, 3)


def _evened(normals: Array, triangles: _Ints, count: int) -> Array:
    """Normals (t, 3) of the triangles, each evened with those around it."""
    for _ in range(EVENINGS):
        of_corners = np.repeat(normals, 3, axis=0)
        summed = np.column_stack([np.bincount(triangles.ravel(), column, count) for column in of_corners.T])
        normals = summed[triangles].sum(axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return normals


def _chosen(evened: Array, facing: Array, beside: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (t,) of each triangle's direction, from its evened and its own cosine to each (t, d)."""
    each = np.arange(len(facing))
    chosen = evened.argmax(axis=1)
    astray = facing[each, chosen] < LEAST_FACING
    chosen[astray] = facing[astray].argmax(axis=1)
    for _ in range(MAJORITY_ROUNDS):
        a, b, c = chosen[beside].T
        most = np.where(b == c, b, a)
        changed = (most != chosen) & ((a == b) | (b == c) | (c == a)) & (facing[each, most] >= LEAST_FACING)
        if not changed.any():
            break
        chosen[changed] = most[changed]
    return chosen


def _connected(layer: NDArray[np.int64], beside: NDArray[np.int64]) -> _Ints:
    """Number (t,) of the chart of each triangle: connected ones of one layer."""
    of, to = np.repeat(np.arange(len(layer)), 3), beside.ravel()
    same = layer[of] == layer[to]
    links = scipy.sparse.coo_matrix(
        (np.ones(np.count_nonzero(same), np.int8), (of[same], to[same])), (len(layer),) * 2
    )
    return np.asarray(scipy.sparse.csgraph.connected_components(links, directed=False)[1], np.int32)


def _upright(xy: Array, chart: NDArray[np.int64]) -> Array:
    """Flat vertices (k, 2), each chart turned so that its long axis is the image's second."""
    count = np.bincount(chart)
    centred = xy - np.column_stack([np.bincount(chart, column) / count for column in xy.T])[chart]
    x, y = centred.T
    xx, xy_, yy = (np.bincount(chart, product) for product in (x * x, x * y, y * y))
    angle = (0.5 * np.arctan2(2 * xy_, xx - yy))[chart]
    return np.column_stack([y * np.cos(angle) - x * np.sin(angle), x * np.cos(angle) + y * np.sin(angle)])


def _packed(
    xy: Array, triangles: _Ints, chart: _Ints, chart_of: NDArray[np.int64]
) -> tuple[NDArray[np.float32], int, int]:
    """Vertices (k, 2) moved to the places of their charts in an image, and its width and height.

    Args:
        xy: (k, 2) flat, each chart anywhere.
        triangles: (t, 3) of them.
        chart: (t,) of each triangle.
        chart_of: (k,) of each vertex.
    """
    count = int(chart.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart_of, xy)
    np.maximum.at(high, chart_of, xy)
    xy = xy - low[chart_of] + MARGIN
    sizes = np.ceil(high - low).astype(np.int64) + 2 * MARGIN + 1
    start = np.concatenate([[0], np.cumsum(sizes[:, 0])])
    lower, upper = _profiles(xy, triangles, chart, start)
    order = np.argsort(-sizes[:, 1], kind='stable')
    width = max(int(np.sqrt((upper - lower).sum() / FULL)), int(sizes[:, 0].max()))
    places = _dropped(order, start, lower, upper, width)
    height = int((places[:, 1] + sizes[:, 1]).max())
    return np.asarray(xy + places[chart_of], np.float32), width, height


@kernel()
def _profiles(xy: Array, triangles: _Ints, chart: _Ints, start: NDArray[np.int64]) -> tuple[_Ints, _Ints]:
    """First row and the row after the last (columns of all charts in a line), margins included."""
    lower = np.full(start[-1], np.iinfo(np.int32).max, np.int32)
    upper = np.zeros(start[-1], np.int32)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        u0, u1 = min(xy[a, 0], xy[b, 0], xy[c, 0]), max(xy[a, 0], xy[b, 0], xy[c, 0])
        v0, v1 = min(xy[a, 1], xy[b, 1], xy[c, 1]), max(xy[a, 1], xy[b, 1], xy[c, 1])
        first = start[chart[t]] + int(np.floor(u0)) - MARGIN
        last = start[chart[t]] + int(np.ceil(u1)) + MARGIN
        for column in range(first, min(last + 1, start[chart[t] + 1])):
            lower[column] = min(lower[column], int(np.floor(v0)) - MARGIN)
            upper[column] = max(upper[column], int(np.ceil(v1)) + MARGIN + 1)
    return lower, upper


@kernel()
def _dropped(
    order: NDArray[np.int64], start: NDArray[np.int64], lower: _Ints, upper: _Ints, width: int
) -> NDArray[np.int64]:
    """Column and row (n, 2) of each chart: where it lies lowest, and then wastes least below it."""
    places = np.zeros((len(order), 2), np.int64)
    horizon = np.zeros(width, np.int64)
    for c in order:
        size = start[c + 1] - start[c]
        low, high = lower[start[c] : start[c + 1]], upper[start[c] : start[c + 1]]
        lowest, least = np.int64(np.iinfo(np.int64).max), np.int64(0)
        for x in range(width - size + 1):
            y = np.int64(0)
            for k in range(size):
                y = max(y, horizon[x + k] - low[k])
            if y > lowest:
                continue
            wasted = np.int64(0)
            for k in range(size):
                wasted += y + low[k] - horizon[x + k]
            if y < lowest or wasted < least:
                lowest, least = y, wasted
                places[c, 0], places[c, 1] = x, y
        x, y = places[c]
        for k in range(size):
            horizon[x + k] = y + high[k]
    return places


def _hidden(flat: Array, triangles: _Ints, height: int, width: int) -> NDArray[np.bool_]:
    """Which triangles (t,) lie behind others of their chart: flat vertices (k, 3) column, row, height."""
    flat = np.asarray(flat - [0, 0, flat[:, 2].min() - 1], np.float32)
    top = rasterise(flat, triangles, height, width)[1]
    u, v, own = flat[triangles].mean(axis=1).T
    # within a texel even the steepest triangle falls by less
    return top[np.rint(v).astype(int), np.rint(u).astype(int)] - own > 1 / LEAST_FACING
