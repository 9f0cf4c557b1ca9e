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

"""Lu-Milios relaxation of the key frames' poses.

Every edge of the pose graph is a spring. Its stiffness is the pair's own registration normal matrix,
linearised anew where the poses move (Lu and Milios 1997; Trowbridge 2014, section 2.2.5). A closure carries a
switch weight that falls when its two views contradict each other (Agarwal 2013). Where views tell little, the
motion joins in (:class:`MotionPrior`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, compose, exp_se3, inverse, log_se3
from debris_scanner.mapping.motion_prior import Blocks, MotionPrior
from debris_scanner.registration.projective import RegistrationStats, linearise_pairs
from debris_scanner.registration.view_table import ViewTable
from debris_scanner.sensing.views import View

Gates = tuple[float, float]
GATES: Gates = (8.0, 5.5)  # px: first and second half of the iterations
SWITCH_CONFLICT_RATIO = 0.05  # a closure beyond these bounds is switched off
SWITCH_RMS = 1.9  # px
PX_PER_RAD = 670.0  # a step of so many pixels counts as one of a radian
MAX_STEP = 0.1  # rad, of one iteration
CONVERGED = 2e-4  # rad, largest step
MOVED = CONVERGED  # relative motion of two views; less changes no match
MOVED_TOGETHER = 5e-3  # rad, common motion: the normal matrix rotates with the target frame's axes
SMOOTHINGS = 5
DAMPING = 1e-6  # of the mean information of the views
PATIENCE = 3  # iterations without a smaller step: matches, and with them poses, may alternate


@dataclass(frozen=True)
class Edge:
    """Two key frames, by index, whose views overlap; a closure may be false."""

    i: int
    j: int
    is_closure: bool


@dataclass
class Relaxed:
    """Result: poses T_target_view, and for each edge its statistics, switch weight and information."""

    poses: list[Array]
    edge_stats: list[RegistrationStats]
    weights: list[float]
    information: list[Array]  # (6, 6), for a twist of view i in the target frame


def relax(
    views: Sequence[View],
    poses: Sequence[Array],
    edges: Sequence[Edge],
    iterations: int = 10,
    gates: Gates = GATES,
    prior: MotionPrior | None = None,
    least_gain: float = 0.0,
    progress: Callable[[], None] | None = None,
) -> Relaxed:
    """Move all poses but the first until the springs are in equilibrium.

    Args:
        views: key frames' views.
        poses: T_target_view (4, 4) of each, the first is held.
        edges: pairs to register; their graph must be connected.
        iterations: upper bound; stops when no pose moves any more.
        gates: largest point-to-plane distance of a match in the first and the second half, px.
        prior: of the motion, added to the springs.
        least_gain: stops, too, when the springs expect no more of a step, m² a view: where they are loose,
            steps stay large.
        progress: called once an iteration.
    """
    moved = [np.array(T) for T in poses]
    unit = np.repeat([1.0, PX_PER_RAD * float(np.median([v.footprint for v in views]))], 3)
    springs, travelled = _Springs(views, moved, edges, unit), np.zeros((len(views), 6))
    least, idle = np.inf, 0
    for k in range(iterations):
        gate = gates[0] if k < iterations // 2 else gates[1]
        blocks, gradient = springs.equations(travelled, gate)
        damping = _damping(blocks, len(views))
        if prior is not None:
            gradient = np.vstack([gradient, np.zeros(6)])
            prior.add(moved, blocks, gradient)
        newton = _solve(blocks, gradient, damping, held=1)
        gain = -0.5 * float(np.sum(gradient * newton)) / len(views)
        step = np.clip(newton, -MAX_STEP * unit, MAX_STEP * unit)
        if prior is not None:
            prior.centre = prior.centre + step[-1, 3:]
            step = step[:-1]
        moved[1:] = [compose(exp_se3(s), T) for s, T in zip(step[1:], moved[1:], strict=True)]
        travelled += step
        if progress:
            progress()
        largest = float(np.abs(step / unit).max())
        idle = 0 if largest < least or k <= iterations // 2 else idle + 1
        least = min(least, largest)
        if largest < CONVERGED or idle >= PATIENCE or gain < least_gain:
            break
    return Relaxed(moved, springs.stats, springs.weights.tolist(), list(springs.H))


def compliance(edges: Sequence[Edge], relaxed: Relaxed, prior: MotionPrior, forces: Array) -> Array:
    """How far relaxed poses give way to forces, the centre of the prior with them.

    Args:
        edges: of the relaxation.
        relaxed: its result.
        prior: of the motion.
        forces: (n, 6, m), on each pose, in the unit of the normal equations.

    Returns:
        (n, 6, m), the twist of each pose; the first is held.
    """
    n = len(relaxed.poses)
    information = np.array(relaxed.information).reshape(-1, 6, 6)
    blocks = _connected(_ends(edges), np.array(relaxed.weights)[:, None, None] * information)
    damping = _damping(blocks, n)
    prior.add(relaxed.poses, blocks, np.zeros((n + 1, 6)))
    m = forces.shape[2]
    forces = np.concatenate([forces[1:].reshape(-1, m), np.zeros((6, m))])
    given = _factorised(blocks, n + 1, damping, held=1).solve(forces)[:-6].reshape(-1, 6, m)
    return np.concatenate([np.zeros((1, 6, m)), given])


def newton_step(pairs: Sequence[tuple[int, int]], H: Array, g: Array, n: int) -> Array:
    """Twists (n, 6) of all poses but the first to where pairs want them.

    Args:
        pairs: of poses, m of them.
        H: (m, 6, 6), information on a twist of the first of each.
        g: (m, 6), gradient of the cost in that twist; the second of each has the other sign.
        n: poses.
    """
    return -given_way(pairs, H, _pulled(np.array(pairs, np.intp).reshape(-1, 2), g, n))


def given_way(pairs: Sequence[tuple[int, int]], H: Array, forces: Array) -> Array:
    """Twists (n, 6) by which poses give way to forces (n, 6); the first is held.

    Args:
        pairs: of poses, m of them.
        H: (m, 6, 6), information on a twist of the first of each.
        forces: on each pose, in the unit of the information times a twist.
    """
    blocks, n = _connected(np.array(pairs, np.intp).reshape(-1, 2), H), len(forces)
    return -_solve(blocks, forces, _damping(blocks, n), held=1)


def smooth(
    poses: Sequence[Array], information: Sequence[Array], prior: MotionPrior, iterations: int = SMOOTHINGS
) -> list[Array]:
    """Poses of frames that were registered one by one, with the motion between them.

    Args:
        poses: T_target_sensor (4, 4) of each.
        information: (6, 6) of each, for a left twist, in the unit that the prior's weight is for.
        prior: of the motion, at the frames' stamps.
        iterations: Gauss-Newton steps; the registrations stay linearised where they are.
    """
    moved, n = [np.array(T) for T in poses], len(poses)
    for _ in range(iterations):
        gradient, blocks = np.zeros((n + 1, 6)), Blocks()
        blocks.add(np.arange(n), np.arange(n), np.array(information))
        for k, H in enumerate(information):
            gradient[k] = H @ log_se3(compose(moved[k], inverse(poses[k])))
        damping = _damping(blocks, n)
        prior.add(moved, blocks, gradient)
        step = _solve(blocks, gradient, damping, held=0)
        moved = [compose(exp_se3(s), T) for s, T in zip(step[:n], moved, strict=True)]
        prior.centre = prior.centre + step[n, 3:]
    return moved


class _Springs:
    """The edges' normal equations, linearised anew where two views moved relative to each other."""

    def __init__(self, views: Sequence[View], poses: list[Array], edges: Sequence[Edge], unit: Array) -> None:
        self._table, self._poses, self._edges = ViewTable(views), poses, edges
        self._unit = unit  # (6,) of a motion: rad, m
        self._ends = _ends(edges)
        self._at, self._gate = np.zeros((len(edges), 2, 6)), 0.0
        self.H, self._g = np.zeros((len(edges), 6, 6)), np.zeros((len(edges), 6))
        self.stats = [RegistrationStats()] * len(edges)
        self.weights = np.ones(len(edges))

    def equations(self, travelled: Array, gate: float) -> tuple[Blocks, Array]:
        """Normal matrix and gradient (m, 6) of all poses, given the motion (m, 6) of each."""
        H, g = self.pull(travelled, gate)
        return _connected(self._ends, H), _pulled(self._ends, g, len(travelled))

    def pull(self, travelled: Array, gate: float) -> tuple[Array, Array]:
        """Weighted normal matrices (n, 6, 6) and gradients (n, 6), given the motion (m, 6) of all poses."""
        since = travelled[self._ends] - self._at
        apart = since[:, 0] - since[:, 1]
        stale = np.abs(apart / self._unit).max(axis=1) > MOVED
        stale |= np.abs(since / self._unit).max(axis=(1, 2)) > MOVED_TOGETHER
        anew = np.flatnonzero(stale | (gate != self._gate))
        self._linearise(anew.tolist(), gate)
        self._at[anew], apart[anew] = travelled[self._ends[anew]], 0.0
        self._gate = gate
        g = self._g + np.einsum('nij,nj->ni', self.H, apart)
        return self.weights[:, None, None] * self.H, self.weights[:, None] * g

    def _linearise(self, chosen: Sequence[int], gate: float) -> None:
        pairs = [(self._edges[n].i, self._edges[n].j) for n in chosen]
        for n, lin in zip(chosen, linearise_pairs(self._table, self._poses, pairs, gate), strict=True):
            self.H[n], self._g[n], self.stats[n] = lin.H, lin.g, lin.stats
            self.weights[n] = _switch(lin.stats) if self._edges[n].is_closure else 1.0


def _switch(a: RegistrationStats) -> float:
    """Weight of a closure: 1 within the bounds, falling with the fourth power beyond."""
    excess = max(a.conflict_ratio / SWITCH_CONFLICT_RATIO, a.rms / SWITCH_RMS)
    return 1.0 if excess < 1 else float(excess**-4)


def _ends(edges: Sequence[Edge]) -> NDArray[np.intp]:
    """Views i and j of each edge, (n, 2)."""
    return np.array([(e.i, e.j) for e in edges], np.intp).reshape(-1, 2)


def _connected(ends: NDArray[np.intp], H: Array) -> Blocks:
    """The normal matrices (n, 6, 6) of edges with ends (n, 2), where they belong."""
    (i, j), blocks = ends.T, Blocks()
    for rows, columns, values in ((i, i, H), (j, j, H), (i, j, -H), (j, i, -H)):
        blocks.add(rows, columns, values)
    return blocks


def _pulled(ends: NDArray[np.intp], g: Array, n: int) -> Array:
    """The gradients (m, 6) of edges with ends (m, 2), where they belong, (n, 6)."""
    gradient = np.zeros((n, 6))
    np.add.at(gradient, ends[:, 0], g)
    np.subtract.at(gradient, ends[:, 1], g)
    return gradient


def _damping(blocks: Blocks, n: int) -> float:
    """Holds directions that no view constrains (a sphere, a plane)."""
    return DAMPING * blocks.trace() / (6 * n)


def _solve(blocks: Blocks, gradient: Array, damping: float, held: int) -> Array:
    """Newton step (n, 6) with the first poses held, by sparse factorisation of 6x6 blocks."""
    n = len(gradient)
    step = np.zeros((n, 6))
    if n > held:
        factors = _factorised(blocks, n, damping, held)
        step[held:] = -factors.solve(gradient[held:].ravel()).reshape(-1, 6)
    return step


def _factorised(blocks: Blocks, n: int, damping: float, held: int) -> Any:
    """Factors of the normal matrix of n rows of 6, without the first ones, which are held."""
    A = scipy.sparse.bsr_array(blocks.summed(n), shape=(6 * n, 6 * n)).tocsc()
    A = (A + damping * scipy.sparse.eye_array(6 * n)).tocsc()[6 * held :, 6 * held :]
    return scipy.sparse.linalg.splu(A.tocsc())
