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

"""The sensor measured on the scan itself: an error of its depth that stays in the image.

A target that turns shows the same face to many pixels, and the same pixel many faces. So the offset of the
depth (:mod:`debris_scanner.sensing.depth_offset`) and the key frames' poses can be told apart, and are found
together: the poses are eliminated from the normal equations of all pairs, and what is left is the offset's,

    (S + P) c = b,    S = H_cc - H_cx H_xx⁻¹ H_xc.

P is the prior: the offset is smooth, and none is likelier than any. How large it is the scan says as well: of
all amplitudes that under which the residuals are the likeliest (MacKay 1992, the evidence). Without an offset
that is none. An equal share everywhere is another size of everything, which no turn shows: it is none.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from debris_scanner.core.geometry import Array
from debris_scanner.mapping.motion_prior import MotionPrior
from debris_scanner.mapping.relaxation import Edge, Relaxed, compliance
from debris_scanner.registration.offset_terms import OffsetEquations
from debris_scanner.sensing.depth_offset import LARGEST_SHARE, NO_OFFSET, SUPPORT, DepthOffset
from debris_scanner.sensing.views import View

STEPS = 12.0  # of the lattice to the target's extent
MOST_STEPS = 20  # to what it covers, where a small target crosses a large image
LENGTHS = (2.0, 4.0, 8.0, 16.0)  # steps after which an offset forgets, that are tried
STIFFNESSES = 4.0 ** np.arange(-2, 8)  # that are tried; at 1 an offset is about what a pixel resolves
SURE = 3.0  # nats: twenty to one
PINNED = 1e6  # stiffness of an equal share against the stiffest prior


def depth_offset(
    views: Sequence[View],
    edges: Sequence[Edge],
    relaxed: Relaxed,
    prior: MotionPrior,
    gate: float,
    information_scale: float,
    known: DepthOffset,
) -> DepthOffset:
    """The offset that relaxed views show; none where it may be chance.

    Args:
        views: of the key frames, freed from what is known.
        edges: pairs of them.
        relaxed: their poses.
        prior: of the motion.
        gate: largest distance of a match, px.
        information_scale: information of a point with noise of the resolution.
        known: removed already; that of no size if nothing is known.
    """
    offset = _lattice(views, known)
    equations = OffsetEquations(views, relaxed.poses, offset)
    for edge, weight in zip(edges, relaxed.weights, strict=True):
        equations.add_pair(edge.i, edge.j, gate, weight)
    twist, seen = equations.twist, equations.seen
    if not seen.any():
        return known
    resolution = float(np.median([v.resolution for v in views]))
    # every pixel is in many pairs, and says what it says once
    scale = information_scale / resolution**2 * len(views) / (2 * len(edges))
    m = len(seen)
    S = equations.H - twist.reshape(-1, m).T @ compliance(edges, relaxed, prior, twist).reshape(-1, m)
    distance = float(np.median([v.footprint * v.frame.camera.focal for v in views]))
    stiffnesses = np.asarray((distance / resolution) ** 2 * STIFFNESSES, np.float64)
    return _likeliest(scale * S, -scale * equations.g, offset, seen / seen.sum(), stiffnesses)


def _lattice(views: Sequence[View], known: DepthOffset) -> DepthOffset:
    """What is known, on a lattice that covers all views."""
    tangents = [v.points[:, :2] / v.points[:, 2:] for v in views if len(v.points)]
    low = np.min([t.min(axis=0) for t in tangents], axis=0)
    high = np.max([t.max(axis=0) for t in tangents], axis=0)
    if not known.is_none:
        grown = known.covering(low, high)
        if max(grown.coefficients.shape) <= MOST_STEPS + SUPPORT:
            return grown
    extent = float(np.median([np.ptp(t, axis=0).max() for t in tangents]))
    step = max(extent / STEPS, float((high - low).max()) / MOST_STEPS)
    return known.resampled(DepthOffset.none_over(low, high, step))


def _likeliest(S: Array, b: Array, known: DepthOffset, seen: Array, stiffnesses: Array) -> DepthOffset:
    """The offset of the likeliest amplitude and length.

    Args:
        S: information (m, m) on the coefficients.
        b: (m,), its product with the change that the residuals ask for.
        known: removed already.
        seen: (m,) share that each coefficient has in what was seen.
        stiffnesses: of the prior that are tried.
    """
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    S = (vectors * np.maximum(values, 0.0)) @ vectors.T  # thinned, unlike what the poses yield
    columns, rows = known.coefficients.shape
    before = known.coefficients.ravel()
    b, pin = b + S @ before, PINNED * stiffnesses.max()
    pinned = S + pin * np.outer(seen, seen)
    best, most = None, SURE
    for length in LENGTHS:
        prior = _stiffness(columns, rows, length)
        factor = _cholesky(prior)
        square = float(np.sum(_solve_lower(factor, seen) ** 2))
        for stiffness in stiffnesses:
            log_det = len(b) * np.log(stiffness) + _log_det(factor) + np.log1p(pin / stiffness * square)
            L = _cholesky(pinned + stiffness * prior)
            z = _solve_lower(L, b)
            nats = 0.5 * (log_det - _log_det(L) + float(z @ z))
            if nats > most:
                best, most = scipy.linalg.solve_triangular(L.T, z), nats
    if best is None or np.abs(best).max() > LARGEST_SHARE:
        return NO_OFFSET
    found, share = best.reshape(columns, rows), seen.reshape(columns, rows)
    return DepthOffset(known.step, known.first, found, share)


def _cholesky(A: Array) -> Array:
    return np.asarray(scipy.linalg.cholesky(A, lower=True, check_finite=False))


def _solve_lower(L: Array, b: Array) -> Array:
    return np.asarray(scipy.linalg.solve_triangular(L, b, lower=True, check_finite=False))


def _log_det(L: Array) -> float:
    """Of the matrix whose Cholesky factor this is."""
    return 2 * float(np.log(np.diag(L)).sum())


def _stiffness(columns: int, rows: int, length: float) -> Array:
    """Towards a smooth offset, and none: bending energy of coefficients (columns x rows), and a little.

    The less of it, the more steps later an offset forgets; of any length it has the same amplitude.
    """

    def differences(n: int, order: int) -> Array:
        D = np.diff(np.eye(n), order, axis=0)
        return np.asarray(D.T @ D)

    across, down = np.eye(columns), np.eye(rows)
    bending = np.kron(differences(columns, 2), down) + np.kron(across, differences(rows, 2))
    bending += 2 * np.kron(differences(columns, 1), differences(rows, 1))
    return np.asarray(length**2 / 4 * (bending + 1.6 / length**4 * np.eye(columns * rows)))
