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
    lattice = _lattice(views, known)
    equations = OffsetEquations(views, relaxed.poses, lattice)
    for edge, weight in zip(edges, relaxed.weights, strict=True):
        equations.add_pair(edge.i, edge.j, gate, weight)
    twist, seen = equations.twist, equations.seen
    if not seen.any():
        return known
    resolution = float(np.median([v.resolution for v in views]))
    # every pixel is in many pairs, and says what it says once
    scale = information_scale / resolution**2 * len(views) / (2 * len(edges))
    m, shape, before = len(seen), lattice.coefficients.shape, lattice.coefficients.ravel()
    S = equations.H - twist.reshape(-1, m).T @ compliance(edges, relaxed, prior, twist).reshape(-1, m)
    distance = float(np.median([v.footprint * v.frame.camera.focal for v in views]))
    stiffnesses = ((distance / resolution) ** 2 * STIFFNESSES).tolist()
    share = seen / seen.sum()
    evidence = _Evidence(scale * S, -scale * equations.g, before, share, shape, stiffnesses)
    nats, found = evidence.likeliest()
    if nats < SURE or np.abs(found).max() > LARGEST_SHARE:
        return NO_OFFSET
    return DepthOffset(lattice.step, lattice.first, found.reshape(shape), share.reshape(shape))


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


class _Evidence:
    """Of offsets with prior knowledge of their length and stiffness, against none.

    Args:
        S: information (m, m) on the coefficients.
        b: (m,), its product with the change that the residuals ask for.
        before: (m,), coefficients that are removed already.
        seen: (m,) share that each coefficient has in what was seen.
        shape: columns and rows of the lattice.
        stiffnesses: of the prior that may be tried.
    """

    def __init__(
        self,
        S: Array,
        b: Array,
        before: Array,
        seen: Array,
        shape: tuple[int, int],
        stiffnesses: Sequence[float],
    ) -> None:
        values, vectors = np.linalg.eigh(0.5 * (S + S.T))
        S = (vectors * np.maximum(values, 0.0)) @ vectors.T  # thinned, unlike what the poses yield
        self._pin = PINNED * max(stiffnesses)
        self._b, self._pinned = b + S @ before, S + self._pin * np.outer(seen, seen)
        self._stiffnesses = stiffnesses
        self._priors = [_stiffness(*shape, length) for length in LENGTHS]
        factors = [_cholesky(prior) for prior in self._priors]
        self._log_dets = [_log_det(L) for L in factors]
        self._squares = [float(np.sum(_solve_lower(L, seen) ** 2)) for L in factors]
        self._tried = dict[tuple[int, int], tuple[float, Array, Array]]()

    def likeliest(self) -> tuple[float, Array]:
        """Of the likeliest prior: nats, and coefficients (m,).

        The way up begins at the likeliest of every second stiffness.
        """
        best = max(((1, k) for k in range(0, len(self._stiffnesses), 2)), key=self._nats)
        while (better := max(self._around(*best), key=self._nats)) != best:
            best = better
        nats, L, z = self._tried[best]
        return nats, np.asarray(scipy.linalg.solve_triangular(L.T, z))

    def _around(self, length: int, k: int) -> list[tuple[int, int]]:
        """A prior, and those that are next to it."""
        lengths = range(max(0, length - 1), min(len(LENGTHS), length + 2))
        return [(a, b) for a in lengths for b in range(max(0, k - 1), min(len(self._stiffnesses), k + 2))]

    def _nats(self, at: tuple[int, int]) -> float:
        if at not in self._tried:
            length, stiffness = at[0], self._stiffnesses[at[1]]
            log_det = len(self._b) * np.log(stiffness) + self._log_dets[length]
            log_det += np.log1p(self._pin / stiffness * self._squares[length])
            L = _cholesky(self._pinned + stiffness * self._priors[length])
            z = _solve_lower(L, self._b)
            self._tried[at] = 0.5 * (log_det - _log_det(L) + float(z @ z)), L, z
        return self._tried[at][0]


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
