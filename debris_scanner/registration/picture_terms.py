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

The ratios of a point's colours are compared with the picture of the other view where the point falls. An
offset between the two views, as of the white balance, is no evidence and is taken out of the equations.

Gloss adds a lamp's white light to a colour, and stays in the image while the target turns. It shifts the two
ratios in a direction that is known of each colour: towards white. So differences are taken along that
direction and across it, where gloss leaves them alone, and each have a noise of their own.

Nothing about that noise is assumed. With S² the variance of the ratios and s² that of their differences, the
pictures are correlated by rho = 1 - s² / 2 S², as two that share a part of what they show. So a point says
-log(1 - rho²) / 2 nats, and weighs rho² / ((1 - rho²) S²): nothing where one picture does not explain the
other. Differences of neighbouring points that are alike count as fewer points, by their correlation. What is
said along gloss weighs less by chi-square where it contradicts what is said across it; and so does the
picture as a whole where it contradicts the shape (`reconcile`): one of another time, lens or camera.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, parts
from debris_scanner.core.optional import inlined, kernel
from debris_scanner.registration.kernels import moved, turned, turned_back
from debris_scanner.sensing.picture import ACROSS, BELOW, BLUR, CHANNELS, KNOWN
from debris_scanner.sensing.views import SAMPLE_STRIDE, Surface, View

Image = NDArray[np.float32]

LEAST_FACING = 0.34  # cosine: more oblique paint is too foreshortened to compare
NORMAL_COS = 0.8  # matched surfaces face the same way
FEWEST = 60  # points of both pictures
REACH_PX = BLUR * SAMPLE_STRIDE  # that a picture is smoothed by: from so far it leads to the right pose
MOVED_PX = 0.2 * REACH_PX  # by which its equations hold
COARSE_GATE = 10.0  # px: with a wider one, poses are so far off that the coarse pictures are compared
OUTLYING, ROUNDS = 3.0, 4  # spreads
MEAN_TO_SIGMA = 1.1284  # of two normal variables: their standard deviation over their mean length / sqrt(2)
MOST_CORRELATED = 0.999  # of two pictures
STEP_VARIANCE = 1e-6  # of logarithms: about that of rounding to steps of 1 / 255
MOST_ALIKE = 0.95  # neighbouring differences
POSE, UNKNOWNS, COLUMNS = 6, 9, 10  # a twist; an offset of each channel; the difference that they explain
LIGHT = 2  # the channel of brightness
RIDGE = 1e-6  # of the information on a motion that is taken out
TINY = 1e-300

_kernel = kernel(fastmath=True)


Terms = tuple[Array, Array, float]  # information (6, 6) and gradient (6,) of a twist, nats


class PictureTerms:
    """What the pictures of two views say while one moves: taken anew when it went further than `MOVED_PX`.

    Args:
        source: the view that moves.
        reference: the view whose picture is looked at.
        T_target_reference: its pose (4, 4).
        most: points whose colours are compared; None: all.
    """

    def __init__(
        self, source: View, reference: View, T_target_reference: Array, most: int | None = None
    ) -> None:
        self._source, self._reference, self._T_reference = source, reference, T_target_reference
        self._step = 1 if most is None else max(1, len(source.points) // most)
        self._known: tuple[bool, Array, Terms | None] | None = None

    def at(self, T_target_source: Array, gate: float, off_px: float = np.inf) -> Terms | None:
        """See :func:`picture_terms`.

        Args:
            T_target_source: pose (4, 4) of the view that moves.
            gate: in multiples of the reference's resolution.
            off_px: by which that pose is off, 1 sigma.
        """
        coarse = gate > COARSE_GATE and off_px > REACH_PX
        if self._known is not None and self._known[0] == coarse:
            terms = self._known[2]
            if terms is None:
                return None
            source = self._source
            twist, moved_square = _since(
                self._known[1], T_target_source, source.centroid, source.gyration_square
            )
            if moved_square < (MOVED_PX * self._reference.footprint) ** 2:
                return terms[0], terms[1] + terms[0] @ twist, terms[2]
        terms = picture_terms(
            self._source, T_target_source, self._reference, self._T_reference,
            gate * self._reference.resolution, step=self._step, coarse=coarse,
        )  # fmt: skip
        self._known = coarse, T_target_source, terms
        return terms


@_kernel
def _since(before: Array, now: Array, centre: Array, radius_square: float) -> tuple[Array, float]:
    """The small left twist (6,) from one pose to another, and the mean square of what it moves points by."""
    twist, R, shift = np.empty(6), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        for j in range(3):
            R[i, j] = now[i, 0] * before[j, 0] + now[i, 1] * before[j, 1] + now[i, 2] * before[j, 2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        twist[i] = 0.5 * (R[k, j] - R[j, k])
        shift[i] = now[i, 3] - R[i, 0] * before[0, 3] - R[i, 1] * before[1, 3] - R[i, 2] * before[2, 3]
    square = radius_square * (twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        twist[3 + i] = shift[i] - 0.5 * (twist[j] * shift[k] - twist[k] * shift[j])
        to = now[i, 0] * centre[0] + now[i, 1] * centre[1] + now[i, 2] * centre[2] + now[i, 3]
        was = before[i, 0] * centre[0] + before[i, 1] * centre[1] + before[i, 2] * centre[2] + before[i, 3]
        square += (to - was) ** 2
    return twist, square


def picture_terms(
    source: Surface,
    T_target_source: Array,
    reference: View,
    T_target_reference: Array,
    gate: float,
    centre: Array | None = None,
    step: int = 1,
    coarse: bool = False,
) -> Terms | None:
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
    if source.picture is None or reference.picture is None:
        return None
    level, own = reference.picture.level(coarse), source.picture.level(coarse)
    if level is None or own is None:
        return None
    about = np.zeros(3) if centre is None else centre
    H, g = np.zeros((6, 6)), np.zeros(6)
    nats = _evidence(
        source.anchors, source.normals, own.shown,
        *parts(T_target_source), *parts(T_target_reference), about,
        reference.depth_map, reference.normal_map, reference.intrinsics, level.values, level.scale, gate,
        step, H, g,
    )  # fmt: skip
    return H, g, nats


@kernel()
def reconcile(
    H: Array, g: Array, H_picture: Array, g_picture: Array, variance: float, centre: Array,
    radius_square: float, least: float,
) -> None:  # fmt: skip
    """Add a picture's information to that of the shape, less of it where the two contradict each other.

    In the directions that shape and picture see independently of each other, both say how far to go and
    how sure they are. Where they differ by more than that, the picture's variance grows by chi-square.
    Where the shape sees next to nothing, what it says is its noise, and contradicts nothing.

    Args:
        H: information (6, 6) on a twist by the shape, in units of 1 / variance; the picture's is added.
        g: gradient (6,) likewise.
        H_picture: the picture's information, 1.
        g_picture: its gradient.
        variance: of the shape's residuals.
        centre: (3,) of the points that are turned.
        radius_square: of these points about it, mean.
        least: of the information on a unit shift that shows how the shape lies.
    """
    both = H + variance * H_picture
    if not np.isfinite(both).all():
        return
    ridge = RIDGE * np.trace(both) / POSE + TINY
    for i in range(POSE):
        both[i, i] += ridge
    L = np.linalg.cholesky(both)
    whiten = np.linalg.inv(L)
    shares, turn = np.linalg.eigh(variance * whiten @ H_picture @ whiten.T)
    T = L @ turn  # both = T Tᵀ, the picture's T diag(shares) Tᵀ
    V = whiten.T @ turn  # twists
    own, seen = V.T @ g, variance * (V.T @ g_picture)
    for k in range(POSE):
        share = min(1 - RIDGE, max(RIDGE, shares[k]))
        off = share * own[k] - (1 - share) * seen[k]
        w0, w1, w2 = V[0, k], V[1, k], V[2, k]
        s0 = V[3, k] + w1 * centre[2] - w2 * centre[1]
        s1 = V[4, k] + w2 * centre[0] - w0 * centre[2]
        s2 = V[5, k] + w0 * centre[1] - w1 * centre[0]
        moved_square = radius_square * (w0 * w0 + w1 * w1 + w2 * w2) + s0 * s0 + s1 * s1 + s2 * s2
        told = 1.0
        if 1 - share > least * moved_square:
            told /= max(1.0, off * off / (share * (1 - share) * variance + TINY))
        for i in range(POSE):
            for j in range(POSE):
                H[i, j] += told * shares[k] * T[i, k] * T[j, k]
            g[i] += told * seen[k] * T[i, k]


@_kernel
def _evidence(
    points: Image, normals: Image, colours: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    about: Array, depth: Image, normal_map: Image, intrinsics: Array, values: Image, scale: float,
    gate: float, step: int, H: Array, g: Array,
) -> float:  # fmt: skip
    """Nats of the points' channels (n, 3) in view j's picture; fills H (6, 6) and g (6,)."""
    most = points.shape[0] // step + 1
    rows, own = np.empty((CHANNELS, COLUMNS, most)), np.empty((CHANNELS, most))
    pixels = np.empty((2, most))
    n = _compare(
        points, normals, colours, R_i, t_i, R_j, t_j, about, depth, normal_map, intrinsics, values,
        scale, gate, step, rows, own, pixels,
    )  # fmt: skip
    if n < FEWEST:
        return 0.0
    trust, left = np.ones((CHANNELS, n)), np.zeros((CHANNELS, n))
    # what no motion explains: until the poses are right the differences hold that, too
    total = _totals(rows, own, trust)
    shown = total > STEP_VARIANCE  # a channel without variance has no correlation, whatever the differences
    if not shown.any():
        return 0.0
    M = _moments(rows, trust, shown)
    _leave(rows, _settled(M, total, trust)[0], shown, left)
    _distrust(left, own, trust)
    M = _moments(rows, trust, shown)
    total = _totals(rows, own, trust)
    x, noise = _settled(M, total, trust)
    _leave(rows, x, shown, left)
    still, nats = np.zeros(UNKNOWNS), 0.0  # of all differences the mean alone is no evidence
    still[POSE:] = _solved(np.ascontiguousarray(M.sum(axis=0)[POSE:, POSE:]))
    for c in range(CHANNELS):
        if not shown[c]:
            continue
        share, count = _share(left[c], trust[c], pixels), trust[c].sum()
        nats -= 0.5 * share * count * np.log(1 - _correlation(_square(M[c], still) / count, total[c]) ** 2)
        M[c] *= share * _weight(noise[c], total[c])
    _reconcile_channels(M)
    A = M[0] + M[1] + M[2]
    # without the offsets, which are nobody's motion
    for c in range(POSE, UNKNOWNS):
        for i in range(COLUMNS):
            if i != c:
                share = A[i, c] / (A[c, c] + TINY)
                for j in range(COLUMNS):
                    A[i, j] -= share * A[c, j]
    for i in range(POSE):
        H[i] = A[i, :POSE]
        g[i] = A[i, UNKNOWNS]
    return nats


@inlined
def _correlation(difference: float, spread: float) -> float:
    """Of two pictures, 0 or more, by the variances of their differences and of one's ratios."""
    return max(0.0, min(MOST_CORRELATED, 1 - (difference + 2 * STEP_VARIANCE) / (2 * spread)))


@inlined
def _weight(difference: float, spread: float) -> float:
    """What differences weigh, as those of pictures that are correlated so."""
    rho = _correlation(difference, spread)
    return rho * rho / ((1 - rho * rho) * spread)


@_kernel
def _moments(rows: Array, trust: Array, shown: NDArray[np.bool_]) -> Array:
    """Weighted products (3, 10, 10) of rows (3, 10, n); 0 of channels that show nothing."""
    M = np.zeros((CHANNELS, COLUMNS, COLUMNS))
    n = trust.shape[1]
    weighted = np.empty(n)
    for c in range(CHANNELS):
        if not shown[c]:
            continue
        for i in range(COLUMNS):
            a = rows[c, i]
            for k in range(n):
                weighted[k] = trust[c, k] * a[k]
            for j in range(i + 1):
                b = rows[c, j]
                total = 0.0
                for k in range(n):
                    total += weighted[k] * b[k]
                M[c, i, j] = M[c, j, i] = total
    return M


@_kernel
def _solved(M: Array) -> Array:
    """Twist and offset (n - 1,) that explain most of the differences, by their moments (n, n); Cholesky."""
    n = len(M) - 1
    L, x = np.empty((n, n)), np.empty(n)
    for i in range(n):
        for j in range(i + 1):
            total = M[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = max(total + RIDGE * M[i, i], TINY) ** 0.5
            else:
                L[i, j] = total / L[j, j]
        total = M[i, n]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@_kernel
def _square(M: Array, x: Array) -> float:
    """Sum of squares of what twist and offsets (9,) leave of the differences with moments (10, 10)."""
    total = M[UNKNOWNS, UNKNOWNS]
    for i in range(UNKNOWNS):
        total -= 2 * x[i] * M[i, UNKNOWNS]
        for j in range(UNKNOWNS):
            total += x[i] * M[i, j] * x[j]
    return max(0.0, total)


@_kernel
def _settled(M: Array, total: Array, trust: Array) -> tuple[Array, Array]:
    """Twist and offsets (9,) by the channels' moments (3, 10, 10); the variance (3,) of what they leave."""
    noise, x = np.ones(CHANNELS), np.zeros(UNKNOWNS)
    W = M.copy()
    for turn in range(ROUNDS):
        x = _solved(W[0] + W[1] + W[2])
        for c in range(CHANNELS):
            noise[c] = _square(M[c], x) / trust[c].sum() + TINY
            W[c] = _weight(noise[c], total[c]) * M[c]
        if turn < ROUNDS - 1:
            _reconcile_channels(W)
    return x, noise


@_kernel
def _reconcile_channels(M: Array) -> None:
    """Lower what a channel weighs by the chi-square with which it contradicts those before it."""
    before = M[0].copy()
    for c in range(1, CHANNELS):
        both = _explained(before) + _explained(M[c]) - _explained(before + M[c])
        M[c] /= max(1.0, both / POSE)
        before += M[c]


@_kernel
def _explained(M: Array) -> float:
    """By how much the best twist and offset lower the sum of squares, by moments (10, 10)."""
    return M[UNKNOWNS, UNKNOWNS] - _square(M, _solved(M))


@_kernel
def _leave(rows: Array, x: Array, shown: NDArray[np.bool_], left: Array) -> None:
    """Fill left (3, n) with what twist and offsets (9,) leave of the differences that are shown."""
    n = left.shape[1]
    for c in range(CHANNELS):
        if not shown[c]:
            continue
        for k in range(n):
            left[c, k] = rows[c, UNKNOWNS, k]
        for i in range(UNKNOWNS):
            for k in range(n):
                left[c, k] -= rows[c, i, k] * x[i]


@_kernel
def _distrust(left: Array, own: Array, trust: Array) -> None:
    """Set the weights (3, n) of differences (3, n) that lie far out: of both colours alike, and of light."""
    n, off, dim, shown = trust.shape[1], 0.0, 0.0, 0.0
    mean = own[LIGHT, :n].mean()
    for k in range(n):
        off += (0.5 * (left[0, k] ** 2 + left[1, k] ** 2)) ** 0.5
        dim += (own[LIGHT, k] - mean) ** 2 * left[LIGHT, k] ** 2
        shown += (own[LIGHT, k] - mean) ** 2
    square = (OUTLYING * MEAN_TO_SIGMA * off / n) ** 2 + TINY
    light = OUTLYING**2 * dim / (shown + TINY) + TINY
    for k in range(n):
        trust[0, k] = trust[1, k] = 1 / (1 + 0.5 * (left[0, k] ** 2 + left[1, k] ** 2) / square) ** 2
        trust[LIGHT, k] = 1 / (1 + left[LIGHT, k] ** 2 / light) ** 2


@_kernel
def _totals(rows: Array, own: Array, trust: Array) -> Array:
    """Variance (3,) of the channels (3, n): across the directions of gloss, along them, of brightness."""
    n, mean, count = trust.shape[1], np.zeros(CHANNELS), np.zeros(CHANNELS)
    for c in range(CHANNELS):
        for k in range(n):
            mean[c] += trust[c, k] * own[c, k]
            count[c] += trust[c, k]
        mean[c] /= count[c]
    # the mean over the points of the variance along each point's direction
    C00, C01, C11, D00, D01, D11, light = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        x, y, d0, d1 = own[0, k] - mean[0], own[1, k] - mean[1], rows[1, POSE, k], rows[1, POSE + 1, k]
        C00 += trust[0, k] * x * x
        C01 += trust[0, k] * x * y
        C11 += trust[0, k] * y * y
        D00 += trust[0, k] * d0 * d0
        D01 += trust[0, k] * d0 * d1
        D11 += trust[0, k] * d1 * d1
        light += trust[LIGHT, k] * (own[LIGHT, k] - mean[LIGHT]) ** 2
    along = (C00 * D00 + 2 * C01 * D01 + C11 * D11) / count[0] ** 2
    return np.array([(C00 + C11) / count[0] - along, along, light / count[LIGHT]]) + TINY


@_kernel
def _share(left: Array, trust: Array, pixels: Array) -> float:
    """What a point counts for, whose difference (n,) is like its neighbour's.

    Neighbours are looked up in a grid of as many cells as there are points, by their pixels (2, n).
    """
    n = len(left)
    u, v = pixels[0, :n], pixels[1, :n]
    u0, u1, v0, v1 = u.min(), u.max(), v.min(), v.max()
    cell = max(1.0, ((u1 - u0 + 1) * (v1 - v0 + 1) / n) ** 0.5)
    columns, rows = int((u1 - u0) / cell) + 2, int((v1 - v0) / cell) + 2
    index = np.full((rows, columns), -1)
    for k in range(n):
        index[int((v[k] - v0) / cell) + 1, int((u[k] - u0) / cell) + 1] = k
    lagged, square = 0.0, TINY
    for row in range(1, rows):
        for column in range(1, columns):
            k = index[row, column]
            for other in (index[row - 1, column], index[row, column - 1]):
                if k >= 0 and other >= 0:
                    both = (trust[k] * trust[other]) ** 0.5
                    lagged += both * left[k] * left[other]
                    square += 0.5 * both * (left[k] ** 2 + left[other] ** 2)
    alike = min(MOST_ALIKE, max(0.0, lagged / square))
    return ((1 - alike) / (1 + alike)) ** 2


@_kernel
def _compare(
    points: Image, normals: Image, colours: Image, R_i: Array, t_i: Array, R_j: Array, t_j: Array,
    about: Array, depth: Image, normal_map: Image, intrinsics: Array, values: Image, scale: float,
    gate: float, step: int, rows: Array, own: Array, pixels: Array,
) -> int:  # fmt: skip
    """Fill the first n of rows (3, 10, most), own (3, most), pixels (2, most); n, of what is compared."""
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    rows_there, columns_there, _ = values.shape
    n = 0
    for k in range(0, points.shape[0], step):
        if colours[k, 0] <= 0:
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
        if u < 1 or v < 1 or u >= columns_there - 1 or v >= rows_there - 1:
            continue
        # known alike in all ratios
        beside = min(values[v, u - 1, 0], values[v, u + 1, 0], values[v - 1, u, 0], values[v + 1, u, 0])
        if min(beside, values[v, u, 0]) <= 0:
            continue
        X0, X1, X2 = X0 - about[0], X1 - about[1], X2 - about[2]
        pixels[0, n], pixels[1, n] = column, row
        for c in range(CHANNELS):
            slope0 = 0.5 * (values[v, u + 1, c] - values[v, u - 1, c])
            slope1 = 0.5 * (values[v + 1, u, c] - values[v - 1, u, c])
            # of the colour there, by a shift of the point: the difference falls by it
            e0, e1 = slope0 * fx / (scale * y2), slope1 * fy / (scale * y2)
            c0, c1, c2 = turned(R_j, -e0, -e1, (e0 * y0 + e1 * y1) / y2)
            rows[c, 0, n], rows[c, 1, n] = X1 * c2 - X2 * c1, X2 * c0 - X0 * c2
            rows[c, 2, n], rows[c, 3, n] = X0 * c1 - X1 * c0, c0
            rows[c, 4, n], rows[c, 5, n] = c1, c2
            for offset in range(CHANNELS):
                rows[c, POSE + offset, n] = 1.0 if offset == c else 0.0
            own[c, n] = colours[k, c]
            rows[c, UNKNOWNS, n] = own[c, n] - (values[v, u, c] + slope0 * (column - u) + slope1 * (row - v))
        _turn(rows, own, n)
        n += 1
    return n


@inlined
def _turn(rows: Array, own: Array, n: int) -> None:
    """Turn a point's two rows into those across and along the direction in which gloss shifts its ratios.

    White light that is added to the mean of both views' colours shifts it so.
    """
    x, y = own[0, n] - 0.5 * rows[0, UNKNOWNS, n] - KNOWN, own[1, n] - 0.5 * rows[1, UNKNOWNS, n] - KNOWN
    red, green, blue = (
        np.exp(-ACROSS * x - BELOW * 0.5 * y), np.exp(ACROSS * x - BELOW * 0.5 * y), np.exp(BELOW * y)
    )  # fmt: skip
    d0, d1 = ACROSS * (red - green), BELOW * (0.5 * (red + green) - blue)
    length = (d0 * d0 + d1 * d1 + TINY) ** 0.5
    d0, d1 = d0 / length, d1 / length
    for i in range(COLUMNS):
        first, second = rows[0, i, n], rows[1, i, n]
        rows[0, i, n], rows[1, i, n] = d0 * second - d1 * first, d0 * first + d1 * second
