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

"""Lu-Milios relaxation on point correspondences, in the nested loop of the thesis (T18).

Trowbridge 2014, sections 2.2.5 and 3.2, eq. 2.23-2.25, in the formulation of Borrmann et al. 2008; PCL's LUM
is the reference. An edge is a spring: its stiffness is the normal matrix of its point pairs over their
squared residual. Pose parameters are (x, y, z, roll, pitch, yaw) with R = Rz Ry Rx. As in PCL the
linearisation assumes small angles: poses start at zero, so move the clouds beforehand
(:mod:`frame_registration`).

Three things differ from PCL; none changes a result that PCL gets right:

* As long as the pairs are fixed, everything an edge contributes follows from the second moments of
  its pairs, so an inner iteration costs the same for any number of points.
* The normal equations are solved as sparse ones.
* An edge that already fits to rounding has the stiffness of PCL's limit instead of silently dropping out. A
  graph whose springs do not connect it is refused.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array, apply, inverse, transform

MIN_PAIRS = 3
MIN_RESIDUAL = 1e-13  # m², squared residual of an edge, below which PCL ignores it
Link = tuple[int, int]  # source, target


@dataclass(frozen=True)
class Spring:
    """Point pairs of one edge, condensed: sum of (s, t, 1) (s, t, 1)^T over them, (7, 7)."""

    source: int
    target: int
    moments: Array

    @property
    def pairs(self) -> int:
        """Number of point pairs."""
        return round(float(self.moments[6, 6]))


def pose_matrix(pose: Array) -> Array:
    """Transform (4, 4) of a pose (6,): x, y, z, roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(pose[3:]), np.cos(pose[3:])
    R = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return transform(R, pose[:3])


def spring(source: int, target: int, s: NDArray[np.floating], t: NDArray[np.floating]) -> Spring:
    """Edge of corresponding points s (k, 3) and t (k, 3), each in its own cloud's frame."""
    z = np.hstack([s, t, np.ones((len(s), 1))]).astype(np.float64)
    return Spring(source, target, z.T @ z)


def linearised(edge: Spring, T_source: Array, T_target: Array) -> tuple[Array, Array, float]:
    """Normal matrix (6, 6), right side (6,) and summed squared distance, m², of an edge; Borrmann 2008.

    The parameters are ordered translation, then rotations about x, z and y.
    """
    W = edge.moments
    mean, difference = np.zeros((3, 7)), np.zeros((3, 7))
    mean[:, :3], mean[:, 3:6] = 0.5 * T_source[:3, :3], 0.5 * T_target[:3, :3]
    mean[:, 6] = 0.5 * (T_source[:3, 3] + T_target[:3, 3])
    difference[:, :3], difference[:, 3:6] = T_source[:3, :3], -T_target[:3, :3]
    difference[:, 6] = T_source[:3, 3] - T_target[:3, 3]
    a, d = mean @ W[:, 6], difference @ W[:, 6]
    aa, ad = mean @ W @ mean.T, mean @ W @ difference.T
    M = np.diag([W[6, 6]] * 3 + [aa[1, 1] + aa[2, 2], aa[0, 0] + aa[1, 1], aa[0, 0] + aa[2, 2]])
    upper = {
        (0, 4): -a[1], (0, 5): a[2], (1, 3): -a[2], (1, 4): a[0], (2, 3): a[1], (2, 5): -a[0],
        (3, 4): -aa[0, 2], (3, 5): -aa[0, 1], (4, 5): -aa[1, 2],
    }  # fmt: skip
    for (row, column), value in upper.items():
        M[row, column] = M[column, row] = value
    rotations = [ad[1, 2] - ad[2, 1], ad[0, 1] - ad[1, 0], ad[2, 0] - ad[0, 2]]
    return M, np.array([*d, *rotations]), float(np.trace(difference @ W @ difference.T))


def incidence(pose: Array) -> Array:
    """Matrix (6, 6) between changes of a pose and of the linearised parameters; Borrmann 2008."""
    x, y, z = pose[:3]
    sx, sy = np.sin(pose[3:5])
    cx, cy = np.cos(pose[3:5])
    H = np.eye(6)
    H[0, 4], H[0, 5] = y * sx - z * cx, y * cx * cy + z * sx * cy
    H[1, 3], H[1, 4], H[1, 5] = z, -x * sx, -x * cx * cy + z * sy
    H[2, 3], H[2, 4], H[2, 5] = -y, x * cx, -x * sx * cy - y * sy
    H[3, 5] = sy
    H[4, 4], H[4, 5] = sx, cx * cy
    H[5, 4], H[5, 5] = cx, -sx * cy
    return H


class RelaxationError(ValueError):
    """A spring network without a solution; the message gives the reason."""


@dataclass
class RelaxedNetwork:
    """Poses (n, 6) after relaxation, the first held, and the course of the residuals."""

    poses: Array
    residuals: list[float]  # m², mean squared distance of all pairs as each outer iteration begins
    springs: list[Spring]  # of the last outer iteration


def relax_fixed(
    springs: Sequence[Spring], poses: Array, iterations: int = 40, tolerance: float = 1e-9
) -> Array:
    """Poses (n, 6) after the inner loop, with fixed pairs and the first pose held.

    Args:
        springs: edges of the network.
        poses: (n, 6) to start from.
        iterations: upper bound.
        tolerance: stop when the poses' changes, (6,) norms, fall below this on average.

    Raises:
        RelaxationError: the network is not connected or leaves a pose undetermined.
    """
    poses = np.array(poses, np.float64)
    n = len(poses)
    usable = [s for s in springs if s.pairs >= MIN_PAIRS]
    require_connected(n, [(s.source, s.target) for s in usable])
    if n < 2:
        return poses
    for _ in range(iterations):
        transforms = [pose_matrix(p) for p in poses]
        edges = [linearised(s, transforms[s.source], transforms[s.target]) for s in usable]
        X = _solve(n, usable, edges)
        change = np.zeros_like(poses)
        for k in range(1, n):
            change[k] = -np.linalg.solve(incidence(poses[k]), X[k])
        poses += change
        if np.linalg.norm(change, axis=1).sum() <= tolerance * (n - 1):
            break
    return poses


def relax(
    clouds: Sequence[NDArray[np.floating]],
    links: Sequence[Link],
    max_distance: float = 0.01,
    outer_iterations: int = 40,
    inner_iterations: int = 40,
    tolerance: float = 1e-9,
    progress: Callable[[], None] | None = None,
) -> RelaxedNetwork:
    """The nested loop: find pairs, relax, move, repeat, with poses that start at zero.

    Args:
        clouds: points (m, 3) of each frame, metres, prealigned.
        links: source and target of each edge.
        max_distance: largest distance of a correspondence, metres.
        outer_iterations: upper bound; ends early when an iteration moves no pose by more than
            ``tolerance``, on average.
        inner_iterations: upper bound of each inner loop.
        tolerance: of both loops.
        progress: called once an outer iteration.

    Raises:
        RelaxationError: as :func:`relax_fixed`.
    """
    trees = [cKDTree(cloud) for cloud in clouds]
    poses = np.zeros((len(clouds), 6))
    residuals: list[float] = []
    springs: list[Spring] = []
    while len(residuals) < outer_iterations:
        springs = find_springs(clouds, trees, links, poses, max_distance)
        residuals.append(mean_square(springs, poses))
        before = poses
        poses = relax_fixed(springs, poses, inner_iterations, tolerance)
        if progress:
            progress()
        moved = np.linalg.norm(poses - before, axis=1).sum()
        if moved <= tolerance * max(1, len(clouds) - 1):
            break
    return RelaxedNetwork(poses, residuals, springs)


def springs_between(
    clouds: Sequence[NDArray[np.floating]], links: Sequence[Link], poses: Array, max_distance: float
) -> list[Spring]:
    """As :func:`find_springs`, building the search trees."""
    return find_springs(clouds, [cKDTree(c) for c in clouds], links, poses, max_distance)


def find_springs(
    clouds: Sequence[NDArray[np.floating]],
    trees: Sequence[cKDTree],
    links: Sequence[Link],
    poses: Array,
    max_distance: float,
) -> list[Spring]:
    """Every link's spring: for each source point the nearest target point, where within ``max_distance``."""
    transforms = [pose_matrix(p) for p in poses]
    springs = []
    for source, target in links:
        # the source is moved into the frame of the target's tree: distances do not depend on the frame
        at_target = apply(inverse(transforms[target]) @ transforms[source], clouds[source])
        distance, nearest = trees[target].query(at_target, distance_upper_bound=max_distance)
        near = np.isfinite(distance)
        springs.append(spring(source, target, clouds[source][near], clouds[target][nearest[near]]))
    return springs


def mean_square(springs: Sequence[Spring], poses: Array) -> float:
    """Mean squared distance of all point pairs at the given poses, m²."""
    transforms = [pose_matrix(p) for p in poses]
    total = sum(linearised(s, transforms[s.source], transforms[s.target])[2] for s in springs if s.pairs)
    return total / max(1, sum(s.pairs for s in springs))


def require_connected(n: int, links: Sequence[Link]) -> None:
    """Raise RelaxationError unless the links join all n frames."""
    if n < 2:
        return
    ends = np.array(links, int).reshape(-1, 2)
    graph = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(n, n))
    parts, label = connected_components(graph, directed=False)
    if parts > 1:
        sizes = sorted(np.bincount(label).tolist(), reverse=True)
        raise RelaxationError(f'the network falls into {parts} parts of {sizes} frames: too few point pairs')


def _solve(n: int, springs: Sequence[Spring], edges: Sequence[tuple[Array, Array, float]]) -> Array:
    """Solution (n, 6) of the network's normal equations; row 0, the held frame, is zero."""
    blocks: dict[tuple[int, int], Array] = {}
    right_side = np.zeros((n, 6))
    for edge, (M, z, square) in zip(springs, edges, strict=True):
        try:
            residual = square - float(z @ np.linalg.solve(M, z))
        except np.linalg.LinAlgError as error:
            raise RelaxationError(
                f'the pairs of frames {edge.source} and {edge.target} fix no pose'
            ) from error
        weight = 1.0 / max(residual, MIN_RESIDUAL)
        for row, column, sign in (
            (edge.source, edge.source, 1), (edge.target, edge.target, 1),
            (edge.source, edge.target, -1), (edge.target, edge.source, -1),
        ):  # fmt: skip
            blocks[row, column] = blocks.get((row, column), 0.0) + sign * weight * M
        right_side[edge.source] += weight * z
        right_side[edge.target] -= weight * z
    order = sorted(blocks)
    data = np.array([blocks[key] for key in order])
    columns = np.array([column for _, column in order])
    starts = np.searchsorted([row for row, _ in order], np.arange(n + 1))
    G = sparse.bsr_array((data, columns, starts), shape=(6 * n, 6 * n)).tocsc()[6:, 6:]
    X = np.zeros((n, 6))
    try:
        X[1:] = splu(G.tocsc()).solve(right_side[1:].ravel()).reshape(-1, 6)
    except RuntimeError as error:
        raise RelaxationError('the network leaves a frame undetermined') from error
    if not np.isfinite(X).all():
        raise RelaxationError('the network leaves a frame undetermined')
    return X
