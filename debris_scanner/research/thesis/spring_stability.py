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

"""Will the relaxation converge? Eigenvalues of the spring network's linearised error dynamics (T22).

Trowbridge 2014, section 6.2.1, proposes this and leaves it open: write the errors' rate of change about
the present state as e' = A e, and refuse networks that start near an unstable equilibrium.

Here one unit of time is one relaxation step. A step changes the poses by -G^-1 grad J, where J is the
springs' energy (eq. 2.24) and G its normal matrix as Lu-Milios has it, so that A = -G^-1 H with H the
full second derivative of J, the part included that Lu-Milios leaves out because it vanishes with the
misfit. While all springs nearly fit, H is G and every eigenvalue is -1. A spring between frames turned
against each other by more than a right angle pulls outwards: its eigenvalue passes zero and turns
positive, and at half a turn there is an unstable equilibrium. Below -2 the steps overshoot.

The network is judged by its point pairs. Nearest neighbours lie no further apart than the correspondence
distance, so a false closure looks like one that fits. It shows only in pairs that are taken for the same
points whatever their distance, as from registering the closure by itself. Nearest neighbours do show a weak
constraint: few pairs whose misfit is as large as their spread, as when the centroids of different faces of a
box coincide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from debris_scanner.core.geometry import Array, hat
from debris_scanner.research.thesis.lum import (
    MIN_PAIRS,
    MIN_RESIDUAL,
    RelaxationError,
    Spring,
    linearised,
    pose_matrix,
    require_connected,
)

_LUM_ORDER = [3, 4, 5, 0, 2, 1]  # a twist (rotation, translation) in the order of linearised()


@dataclass(frozen=True)
class Stability:
    """Verdict on a network; ``reason`` is None exactly when it is stable."""

    reason: str | None
    eigenvalues: Array  # of A, (6 (n - 1),), ascending; the last decides. Empty where A does not exist.
    condition: float  # of G with lengths in units of the clouds' size

    @property
    def stable(self) -> bool:
        """Whether the relaxation may be started."""
        return self.reason is None


def assess(
    springs: Sequence[Spring],
    poses: Array,
    stiffness: Sequence[float] | None = None,
    margin: float = 0.1,
    max_condition: float = 1e8,
) -> Stability:
    """Stability of the network at the given poses.

    Args:
        springs: the edges' point pairs, as :func:`lum.find_springs` finds them or from elsewhere.
        poses: (n, 6) where the relaxation would start; the first is held.
        stiffness: of each spring, 1/m²; default the inverse of its residual, as Lu-Milios has it.
        margin: how far below zero, and above -2, every eigenvalue must stay.
        max_condition: a worse conditioned network leaves some direction undetermined.
    """
    none = np.empty(0)
    n = len(poses)
    if stiffness is not None and not all(np.isfinite(k) and k > 0 for k in stiffness):
        return Stability(
            'a spring with a stiffness that is not positive drives its frames apart', none, np.inf
        )
    usable = [k for k, s in enumerate(springs) if s.pairs >= MIN_PAIRS]
    try:
        require_connected(n, [(springs[k].source, springs[k].target) for k in usable])
    except RelaxationError as error:
        return Stability(str(error), none, np.inf)
    if n < 2:
        return Stability(None, none, 1.0)
    transforms = [pose_matrix(p) for p in poses]
    G, H = np.zeros((6 * n, 6 * n)), np.zeros((6 * n, 6 * n))
    for k in usable:
        edge = springs[k]
        T = transforms[edge.source], transforms[edge.target]
        M, z, square = linearised(edge, *T)
        weight = 1.0 / max(square - float(z @ np.linalg.lstsq(M, z)[0]), MIN_RESIDUAL)
        if stiffness is not None:
            weight = stiffness[k]
        rows = np.r_[6 * edge.source : 6 * edge.source + 6, 6 * edge.target : 6 * edge.target + 6]
        block = np.ix_(rows, rows)
        G[block] += weight * np.block([[M, -M], [-M, M]])
        H[block] += weight * curvature(edge, *T)
    return _judge(G[6:, 6:], H[6:, 6:], _size(springs, transforms), margin, max_condition)


def curvature(edge: Spring, T_source: Array, T_target: Array) -> Array:
    """Second derivative (12, 12) of half an edge's summed squared distance, source before target.

    By left twists of the two poses, each ordered as in :func:`linearised`.
    """
    W, count = edge.moments, edge.moments[6, 6]
    A, B = np.zeros((3, 7)), np.zeros((3, 7))
    A[:, :3], A[:, 6] = T_source[:3, :3], T_source[:3, 3]
    B[:, 3:6], B[:, 6] = T_target[:3, :3], T_target[:3, 3]
    s, t = A @ W[:, 6], B @ W[:, 6]
    ss, tt, st = A @ W @ A.T, B @ W @ B.T, A @ W @ B.T
    eye = np.eye(3)

    def block(turns: Array, left: Array, right: Array) -> Array:
        return np.block([[turns, hat(left)], [-hat(right), count * eye]])[np.ix_(_LUM_ORDER, _LUM_ORDER)]

    # d = s - t; the parts with d are what a turn of the lever arm adds to second order
    sd, td = ss - st, st.T - tt
    own_s = np.trace(ss) * eye - ss + 0.5 * (sd + sd.T) - np.trace(sd) * eye
    own_t = np.trace(tt) * eye - tt - 0.5 * (td + td.T) + np.trace(td) * eye
    cross = block(np.trace(st) * eye - st.T, s, t)
    return np.block([[block(own_s, s, s), -cross], [-cross.T, block(own_t, t, t)]])


def _judge(G: Array, H: Array, size: float, margin: float, max_condition: float) -> Stability:
    units = np.tile([1.0, 1, 1, 1 / size, 1 / size, 1 / size], len(G) // 6)
    G, H = units[:, None] * G * units, units[:, None] * H * units
    stiff = np.linalg.eigvalsh(G)
    condition = float(stiff[-1] / stiff[0]) if stiff[0] > 0 else np.inf
    if condition > max_condition:
        undetermined = f'the springs leave a direction undetermined: condition {condition:.1e}'
        return Stability(undetermined, np.empty(0), condition)
    values, vectors = scipy.linalg.eigh(H, G)
    eigenvalues = -values[::-1]
    mode = np.linalg.norm(vectors[:, 0].reshape(-1, 6), axis=1)
    reason: str | None = None
    if eigenvalues[-1] > -margin:
        state = 'unstable' if eigenvalues[-1] >= 0 else 'close to an unstable equilibrium'
        frame = int(mode.argmax()) + 1
        reason = f'the network is {state}: eigenvalue {eigenvalues[-1]:+.2f}, mostly of frame {frame}'
    elif eigenvalues[0] < -2.0 + margin:
        reason = f'relaxation steps overshoot: eigenvalue {eigenvalues[0]:+.2f} is beyond -2'
    return Stability(reason, eigenvalues, condition)


def _size(springs: Sequence[Spring], transforms: Sequence[Array]) -> float:
    """Root mean square distance of the paired points from the origin, metres."""
    total, count = 0.0, 0.0
    for edge in springs:
        R, p = transforms[edge.source][:3, :3], transforms[edge.source][:3, 3]
        A = np.hstack([R, np.zeros((3, 3)), p[:, None]])
        total += float(np.trace(A @ edge.moments @ A.T))
        count += edge.pairs
    return float(np.sqrt(total / max(count, 1.0))) or 1.0
