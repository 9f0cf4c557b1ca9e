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

"""What two pictures of the target say about a pose, beside the depths: normal equations and nats.

Each ratio of a point's colours is compared with the picture of the other view where the point falls. An
offset between the two views, as of the white balance, is no evidence and is taken out of the equations.

Nothing about the picture's noise is assumed. With S² the variance of the ratio and s² that of the
differences, the pictures are correlated by rho = 1 - s² / 2 S², as two that share a part of what they show.
So a point says -log(1 - rho²) / 2 nats, and weighs rho² / ((1 - rho²) S²): nothing where one picture does not
explain the other. Differences of neighbouring points that are alike count as fewer points, by their
correlation: what is left when a picture is registered badly to its depth is alike, and so says little.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import inlined, kernel
from debris_scanner.registration.kernels import moved, turned, turned_back
from debris_scanner.sensing.views import Surface, View

Image = NDArray[np.float32]

LEAST_FACING = 0.34  # cosine: more oblique paint is too foreshortened to compare
NORMAL_COS = 0.8  # matched surfaces face the same way
FEWEST = 60  # points of both pictures
COARSE_GATE = 10.0  # px: with a wider one, poses are so far off that the coarse pictures are compared
OUTLYING, ROUNDS = 3.0, 2  # spreads
MEAN_TO_SIGMA = 1.2533  # of a normal distribution: its standard deviation over its mean deviation
MOST_CORRELATED = 0.999  # of two pictures
MOST_ALIKE = 0.95  # neighbouring differences
POSE, DIFFERENCE, OWN, COLUMNS = 6, 6, 7, 8  # of what is compared: the pose's six come first
RIDGE = 1e-6  # of the information on a motion that is taken out
TINY = 1e-300

_kernel = kernel(fastmath=True)


def picture_terms(
    source: Surface,
    T_target_source: Array,
    reference: View,
    T_target_reference: Array,
    gate: float,
    centre: Array | None = None,
    step: int = 1,
    coarse: bool = False,
) -> tuple[Array, Array, float] | None:
    """Evidence of the source's colours in the picture of the reference; None where they share none.

    Args:
        source: a view.
        T_target_source: its pose (4, 4).
        reference: the view whose picture is looked at.
        T_target_reference: its pose (4, 4).
        gate: largest distance, m, of a point from the surface that it is compared with.
        centre: (3,), target frame, that a twist turns about; None: its origin.
        step: every step-th point is looked at.
        coarse: compare the coarse pictures.

    Returns:
        information (6, 6) on a left twist of the source, gradient (6,) of the negative log-likelihood, and
        the log-likelihood, nats, over that of pictures that have nothing to do with each other.
    """
    picture, colours = reference.picture, source.colours
    if picture is None or colours is None:
        return None
    level = picture.coarse if coarse else picture.fine
    about = np.zeros(3) if centre is None else centre
    H, g = np.zeros((6, 6)), np.zeros(6)
    place = (
        np.ascontiguousarray(T_target_source[:3, :3]), np.ascontiguousarray(T_target_source[:3, 3]),
        np.ascontiguousarray(T_target_reference[:3, :3]), np.ascontiguousarray(T_target_reference[:3, 3]),
    )  # fmt: skip
    nats = sum(
        _evidence(
            source.anchors, source.normals, shown, *place, about,
            reference.depth_map, reference.normal_map, reference.intrinsics,
            values, gradient, level.scale, gate, step, H, g,
        )
        for shown, values, gradient in zip(colours[int(coarse)], level.values, level.gradient, strict=True)
    )  # fmt: skip
    return H, g, nats


@_kernel
def _evidence(
    points: Image, normals: Image, colours: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    about: Array, depth: Image, normal_map: Image, intrinsics: Array, values: Image, gradient: Image,
    scale: float, gate: float, step: int, H: Array, g: Array,
) -> float:  # fmt: skip
    """Nats of one ratio of the points' colours (n,) in view j's picture; adds to H (6, 6) and g (6,)."""
    J, b = np.empty((6, 6)), np.empty(6)
    rows = np.empty((COLUMNS, points.shape[0] // step + 1))
    n = _compare(
        points, normals, colours, R_i, t_i, R_j, t_j, about, depth, normal_map, intrinsics, values,
        gradient, scale, gate, step, rows,
    )  # fmt: skip
    if n < FEWEST:
        return 0.0
    weights, left = np.ones(n), np.empty(n)
    total, noise, square, count = 0.0, 0.0, 0.0, 0.0
    for turn in range(ROUNDS):
        _centre(rows, weights, n)
        square = _product(rows, DIFFERENCE, DIFFERENCE, weights)
        total = _product(rows, OWN, OWN, weights)
        for i in range(POSE):
            for j in range(i + 1):
                J[i, j] = J[j, i] = _product(rows, i, j, weights)
            b[i] = _product(rows, i, DIFFERENCE, weights)
        # what no motion explains: until the poses are right the differences hold that, too
        motion = np.linalg.solve(J + np.diag(RIDGE * np.diag(J) + TINY), b)
        for k in range(n):
            left[k] = rows[DIFFERENCE, k]
        for i in range(POSE):
            for k in range(n):
                left[k] -= motion[i] * rows[i, k]
        noise, count, off = 0.0, 0.0, 0.0
        for k in range(n):
            noise += weights[k] * left[k] * left[k]
            off += weights[k] * abs(left[k])
            count += weights[k]
        if turn < ROUNDS - 1:
            sigma = MEAN_TO_SIGMA * off / count
            for k in range(n):
                weights[k] = 1 / (1 + (left[k] / (OUTLYING * sigma + TINY)) ** 2) ** 2
    if total <= 0:
        return 0.0
    lagged = 0.0
    for k in range(1, n):
        lagged += (weights[k] * weights[k - 1]) ** 0.5 * left[k] * left[k - 1]
    alike = min(MOST_ALIKE, max(0.0, lagged / (noise + TINY)))
    share = ((1 - alike) / (1 + alike)) ** 2
    rho = _correlation(noise, total)
    weight = share * rho * rho / ((1 - rho * rho) * total / count)
    H += weight * J
    g += weight * b
    return -0.5 * share * count * np.log(1 - _correlation(square, total) ** 2)


@inlined
def _correlation(difference: float, spread: float) -> float:
    """Of two pictures, 0 or more, by the squares of their differences and of one's ratios."""
    return max(0.0, min(MOST_CORRELATED, 1 - difference / (2 * spread)))


@_kernel
def _product(rows: Array, a: int, b: int, weights: Array) -> float:
    total = 0.0
    for k in range(len(weights)):
        total += weights[k] * rows[a, k] * rows[b, k]
    return total


@_kernel
def _centre(rows: Array, weights: Array, n: int) -> None:
    """Take their weighted means from rows (COLUMNS, n) of what is compared: an offset is no evidence."""
    for c in range(COLUMNS):
        total, mean = 0.0, 0.0
        for k in range(n):
            total += weights[k]
            mean += weights[k] * rows[c, k]
        mean /= total
        for k in range(n):
            rows[c, k] -= mean


@_kernel
def _compare(
    points: Image, normals: Image, colours: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    about: Array, depth: Image, normal_map: Image, intrinsics: Array, values: Image, gradient: Image,
    scale: float, gate: float, step: int, rows: Array,
) -> int:  # fmt: skip
    """Fill rows (COLUMNS, n) with what is compared, one column a point; their number."""
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    rows_there, columns_there = values.shape
    n = 0
    for k in range(0, points.shape[0], step):
        colour = colours[k]
        if colour <= 0:
            continue
        X0, X1, X2 = moved(R_i, t_i, points[k, 0], points[k, 1], points[k, 2])
        y0, y1, y2 = turned_back(R_j, X0 - t_j[0], X1 - t_j[1], X2 - t_j[2])
        if y2 <= 0:
            continue
        column, row = y0 / y2 * fx + cx, y1 / y2 * fy + cy
        u, v = int(np.floor(column + 0.5)), int(np.floor(row + 0.5))
        if u < 0 or v < 0 or u >= w or v >= h:
            continue
        d = depth[v, u]
        if d <= 0:
            continue
        n0, n1, n2 = normals[k, 0], normals[k, 1], normals[k, 2]
        b0, b1, b2 = turned(R_i, n0, n1, n2)
        m0, m1, m2 = turned_back(R_j, b0, b1, b2)
        if -(m0 * y0 + m1 * y1 + m2 * y2) < LEAST_FACING * (y0 * y0 + y1 * y1 + y2 * y2) ** 0.5:
            continue
        q0, q1, q2 = normal_map[v, u, 0], normal_map[v, u, 1], normal_map[v, u, 2]
        if q0 * m0 + q1 * m1 + q2 * m2 < NORMAL_COS:
            continue
        off = q0 * (y0 - (u - cx) / fx * d) + q1 * (y1 - (v - cy) / fy * d) + q2 * (y2 - d)
        if abs(off) > gate:
            continue
        column, row = (column + 0.5) / scale - 0.5, (row + 0.5) / scale - 0.5
        u, v = int(np.floor(column + 0.5)), int(np.floor(row + 0.5))
        if u < 1 or v < 1 or u >= columns_there - 1 or v >= rows_there - 1 or values[v, u] <= 0:
            continue
        slope0, slope1 = gradient[v, u, 0], gradient[v, u, 1]
        there = values[v, u] + slope0 * (column - u) + slope1 * (row - v)
        # of the colour there, by a shift of the point: the difference falls by it
        e0, e1 = slope0 * fx / (scale * y2), slope1 * fy / (scale * y2)
        c0, c1, c2 = turned(R_j, -e0, -e1, (e0 * y0 + e1 * y1) / y2)
        X0, X1, X2 = X0 - about[0], X1 - about[1], X2 - about[2]
        rows[0, n], rows[1, n], rows[2, n] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2, X0 * c1 - X1 * c0
        rows[3, n], rows[4, n], rows[5, n] = c0, c1, c2
        rows[DIFFERENCE, n], rows[OWN, n] = colour - there, colour
        n += 1
    return n
