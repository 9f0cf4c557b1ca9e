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

"""A pattern that a sensor lays over every depth image, such as the bumps of a stereo camera.

The depth of a pixel is wrong by the same in every frame, and alike at pixels near it. Two views share that
error where the surface has hardly moved in the image. So every registration finds a little reason not to have
moved: motions come out short, and flat faces stay behind.

No single pair of views shows it. But of two pairs that show different sides of the target, what each leaves
over at the same pixel has nothing in common except this pattern b. If the surface moved by d in the image,

    E[e_p e_q] = 2 sigma² (1 - exp(-d² / l²)),    e = b(u + d) - b(u) + noise

Random noise averages to nothing there, and so does what registration and fitted planes do to a shape: by then
another is there. What the pattern draws a registration by is then taken off
(:func:`debris_scanner.registration.kernels.accumulate_surface`).
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, apply
from debris_scanner.sensing.views import MAD_TO_SIGMA, NO_PATTERN, FixedPattern, View

CELL_PX = 4  # points of different pairs so near are at the same place in the image
LENGTHS_PX = (15.0, 20.0, 30.0, 45.0, 70.0)  # that are tried
CLIP = 4.0  # sigma: residuals further off are no noise
FACE_ON_COS = 0.9  # flanks of a round target look alike from all sides, with what smoothing does to them
SAME_NORMAL_COS = 0.9
SURE = 4.0  # standard errors, for a pattern to be there
SHUFFLES = 30  # of the pairs' signs: what chance makes of them
FEWEST_PAIRS = 8
SIDES = 4  # parts of a scan, by time; pairs of one part may show the same

Pair = tuple[View, Array, View]  # a view, T_other_view (4, 4), the other view


def disjoint_pairs(count: int, apart: int) -> list[tuple[int, int]]:
    """Pairs of indices below ``count`` that lie so far apart, no index in two of them."""
    return [(k, k + apart) for k in range(count - apart) if k % (2 * apart) < apart]


def measure_pattern(groups: Iterable[Sequence[Pair]]) -> FixedPattern:
    """The fixed pattern that pairs of views show, none if it may be chance.

    Args:
        groups: pairs with about the same displacement; in a group no view in two of them.
    """
    products = [found for group in groups if (found := _products(group)) is not None]
    if not products:
        return NO_PATTERN
    best, likeliest = NO_PATTERN, 0.0
    for length in LENGTHS_PX:
        rises = [1 - np.exp(-((apart / length) ** 2)) for apart, _, _ in products]
        norm = sum(float(weight @ rise**2) for rise, (_, weight, _) in zip(rises, products, strict=True))
        # the first row is of the pairs as they are, the others of shuffled signs
        seen = sum(product @ rise for rise, (_, _, product) in zip(rises, products, strict=True))
        certainty = float(seen[0] / max(float(np.std(seen[1:])), 1e-300))
        if certainty > SURE and seen[0] ** 2 / norm > likeliest:
            likeliest = float(seen[0] ** 2 / norm)
            best = FixedPattern(float(np.sqrt(0.5 * seen[0] / norm)), length)
    return best


def _products(group: Sequence[Pair]) -> tuple[Array, Array, Array] | None:
    """Of each cell (m,) the displacement, px, the number of products of two pairs, and their sums.

    The sums are (1 + SHUFFLES, m); in all rows but the first each pair has a random sign.
    """
    found = [_residuals(*pair) for pair in group]
    found = [f for f in found if len(f[0])]
    if len(found) < FEWEST_PAIRS:
        return None
    pair = np.concatenate([np.full(len(cell), n) for n, (cell, _, _) in enumerate(found)])
    cell, off, apart = (np.concatenate([f[k] for f in found]) for k in range(3))
    sigma = MAD_TO_SIGMA * float(np.median(np.abs(off)))
    off = np.clip(off, -CLIP * sigma, CLIP * sigma)
    _, cell = np.unique(cell, return_inverse=True)
    count = np.bincount(cell)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (SHUFFLES, len(found)))
    rows = [np.ones(len(found)), *signs]
    part = pair * SIDES // len(found)
    of_part = cell + part * len(count)

    def across_parts(values: Array) -> Array:
        """Sums over products of values of two parts, by cell."""
        each = np.bincount(of_part, values, SIDES * len(count)).reshape(SIDES, -1)
        return np.asarray(each.sum(axis=0) ** 2 - (each**2).sum(axis=0))

    weight = across_parts(np.ones(len(cell)))
    sums = np.array([across_parts(off * row[pair]) for row in rows])
    several = weight > 0
    return (np.bincount(cell, apart) / count)[several], weight[several], sums[:, several]


def _residuals(view: View, T_other_view: Array, other: View) -> tuple[NDArray[np.intp], Array, Array]:
    """Of what both views show face-on, by cell of the other image (n,): depth difference, displacement in px.

    The difference is along the ray, over the square of the depth, in 1/m: so a disparity's error grows.
    """
    y = apply(T_other_view, view.points.astype(np.float64))
    c, d = other.frame.camera, view.frame.camera
    column = np.rint(y[:, 0] / y[:, 2] * c.fx + c.cx).astype(int)
    row = np.rint(y[:, 1] / y[:, 2] * c.fy + c.cy).astype(int)
    h, w = other.depth_map.shape
    k = np.flatnonzero((column >= 0) & (row >= 0) & (column < w) & (row < h) & (y[:, 2] > 0))
    column, row, y, p, normals = column[k], row[k], y[k], view.points[k], view.normals[k]
    q, n = other.depth_map[row, column].astype(float), other.normal_map[row, column].astype(float)
    ray = np.stack([(column - c.cx) / c.fx, (row - c.cy) / c.fy, np.ones(len(k))], axis=1)
    slope = (n * ray).sum(axis=1)
    facing = (q > 0) & (-slope > FACE_ON_COS * np.linalg.norm(ray, axis=1))
    facing &= -(normals * p).sum(axis=1) > FACE_ON_COS * np.linalg.norm(p, axis=1)
    facing &= ((normals @ T_other_view[:3, :3].T) * n).sum(axis=1) > SAME_NORMAL_COS
    y, p, q, n, ray, slope = y[facing], p[facing], q[facing], n[facing], ray[facing], slope[facing]
    off = (n * (y - ray * q[:, None])).sum(axis=1) / slope / y[:, 2] ** 2
    # about the principal points: the windows lie elsewhere in the image
    apart = np.hypot(
        c.fx * y[:, 0] / y[:, 2] - d.fx * p[:, 0] / p[:, 2],
        c.fy * y[:, 1] / y[:, 2] - d.fy * p[:, 1] / p[:, 2],
    )
    across = np.rint(column[facing] - c.cx).astype(np.int64) // CELL_PX
    down = np.rint(row[facing] - c.cy).astype(np.int64) // CELL_PX
    # one value a cell, for points of one pair are no two witnesses
    cell, place = np.unique((down << 20) + across, return_inverse=True)
    count = np.maximum(np.bincount(place), 1)
    return cell, np.bincount(place, off) / count, np.bincount(place, apart) / count
