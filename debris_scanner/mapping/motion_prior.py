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

"""What is known of the motion when poses are estimated together: a free body's velocities change slowly.

Views of a nearly round target tell little of its turn, and edge-on views of a panel little of anything.
The motion bridges them. Between three poses in a row the mean velocities, seen by the sensor, may differ
as far as an acceleration allows that is normal and white (Anderson and Barfoot 2015):

    w_ab = log(R_bᵀ R_a) / (t_b - t_a)     v_ab = (s_b - s_a) / (t_b - t_a),   s_k = R_kᵀ (c - p_k)
    w_bc - w_ab ~ N(0, (sigma_w h)²)       v_bc - v_ab ~ N(0, (sigma_v h)²),   h = (t_c - t_a) / 2

A tumbling target changes its rate by itself: what a torque-free body does, whose inertia and angular momentum
fit the rates best, is taken off w first, if what is left is likelier by Schwarz's criterion. Such a body is
followed through gaps as well.

R_k, p_k is T_target_sensor. The centre c, the point of the target that moves evenly, is estimated with the
poses; along the axis of a pure spin nothing shows it, and the target's extent holds it near the middle.

Both sigmas are measured on the scan itself, so that a hand or a brake is not smoothed away. The noise of the
poses is in them too. Of the turn it is less over longer spans, and the least of several counts. The centre is
measured between neighbours alone: what the sensor does to a face, again and again as it comes round, looks
like an acceleration over longer spans. A Cauchy weight lets single jumps be, as of a turntable that stops.
"""

import copy
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, exp_so3, hat, log_so3, transform
from debris_scanner.core.rigid_body import DIFFERENCE, bridgeable, fit_rates, inertia, propagate, rates_of

SPANS = (1, 2, 4, 6)  # key frames to either side: over more, a tumbling target's acceleration turns
FEWEST = 6  # triples, of which a sigma is measured
MEDIAN_NORM = 1.54  # of a normal vector (3,), in sigmas
LEAST = 1e-3  # rad/s², and extents/s²: less is not told from none
JUMP = 3.0  # sigmas, where the Cauchy weight falls to a half
LARGEST_TURN = 1.0  # rad, between two poses: beyond, their mean rate says little
UNEVEN = np.radians(5.0)  # nearly a key frame: a jump of the rate that turns the next pose so far
CONTINUED = 12  # poses at the end of a run, of which the rate is taken to continue it
ROUNDS = 10  # of the centre's robust fit
FEWEST_RATES = 12  # of which an inertia is found


class Blocks:
    """Blocks (6, 6) of a normal matrix, by row and column; those at the same place add up."""

    def __init__(self) -> None:
        self._rows: list[NDArray[np.intp]] = []
        self._columns: list[NDArray[np.intp]] = []
        self._values: list[Array] = []

    def add(self, rows: NDArray[np.intp], columns: NDArray[np.intp], values: Array) -> None:
        """Add blocks (m, 6, 6) at rows (m,) and columns (m,)."""
        self._rows.append(rows)
        self._columns.append(columns)
        self._values.append(values)

    def trace(self) -> float:
        """Of the matrix."""
        each = zip(self._rows, self._columns, self._values, strict=True)
        return float(
            sum(values[rows == columns].trace(axis1=1, axis2=2).sum() for rows, columns, values in each)
        )

    def summed(self, n: int) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
        """Blocks (k, 6, 6), their columns (k,), and where each of n rows begins (n + 1,), as in BSR."""
        places = np.concatenate(self._rows) * n + np.concatenate(self._columns)
        order = np.argsort(places, kind='stable')
        places, starts = np.unique(places[order], return_index=True)
        values = np.add.reduceat(np.concatenate(self._values)[order], starts)
        return values, places % n, np.searchsorted(places, n * np.arange(n + 1))


class MotionPrior:
    """Normal equations of the velocities' changes along a chain of poses.

    Args:
        stamps_ns: (n,) of the poses.
        linked: (n - 1,) whether each is tracked on to the next.
        poses: T_target_sensor (4, 4) of each, on which the accelerations are measured.
        middle: (3,) of the target, about which its centre is sought.
        extent: of the target, m.
        weight: information of 1 rad⁻² or m⁻² in the unit of the normal equations that this is added to.
    """

    def __init__(
        self,
        stamps_ns: Sequence[int],
        linked: Sequence[bool],
        poses: Sequence[Array],
        middle: Array,
        extent: float,
        weight: float,
    ) -> None:
        self._chain(stamps_ns, linked, poses)
        self._weight = weight
        self._middle, self._extent = middle, extent
        self._body: Array | None = None  # (8,), shape and angular momentum
        self.angular_sigma = self._measure_turning(poses)  # rad/s²; infinite where it is not known
        found = self._fit_body(poses)
        if found is not None:
            self._body, uncertain = found
            sigma = float(np.hypot(self._measure_turning(poses), uncertain))
            n = 3 * max(len(self._middles(1)), 1)
            # Schwarz: the likelihood must gain more than numbers without meaning would give
            if n * np.log(self.angular_sigma / sigma) > 0.5 * len(self._body) * np.log(n):
                self.angular_sigma = sigma
            else:
                self._body = None
        self.linear_sigma, self.centre = self._measure_drift(poses)  # m/s², and (3,) in the target frame

    @property
    def inertia(self) -> Array:
        """Of the body (3, 3), target frame, any scale; that of a sphere where the rates do not show one."""
        return np.eye(3) if self._body is None else inertia(self._body[:5])

    def resampled(self, stamps_ns: Sequence[int], poses: Sequence[Array]) -> 'MotionPrior':
        """The same motion at other stamps; white noise leaves more of itself in shorter intervals."""
        other = copy.copy(self)
        other._chain(stamps_ns, [True] * (len(stamps_ns) - 1), poses)
        denser = float(np.sqrt(np.median(np.diff(self._t)) / np.median(np.diff(other._t))))
        other.angular_sigma, other.linear_sigma = self.angular_sigma * denser, self.linear_sigma * denser
        return other

    def add(self, poses: Sequence[Array], blocks: Blocks, gradient: Array) -> None:
        """Add to normal equations of n left twists (6,), each of a pose, and of one row more.

        Args:
            poses: T_target_sensor (4, 4), n of them.
            blocks: added to. The last row's second half is the centre; its first is unused.
            gradient: (n + 1, 6).
        """
        n = len(poses)
        last = np.array([n])
        blocks.add(last, last, self._weight * np.eye(6)[None] / self._extent**2)
        gradient[n, 3:] += self._weight * (self.centre - self._middle) / self._extent**2
        middles = self._middles(1) if self._body is None else np.arange(1, n - 1)  # a body bridges gaps
        if not np.isfinite(self.angular_sigma) or not len(middles):
            return
        a, b, c = middles - 1, middles, middles + 1
        dt, turns, m = np.diff(self._t)[:, None], self._unexpected_turns(poses), len(middles)
        R = np.array([T[:3, :3].T for T in poses])
        s = np.einsum('nij,nj->ni', R, self.centre - np.array([T[:3, 3] for T in poses]))
        ds = np.concatenate([R @ hat(self.centre), -R], axis=2)  # by the twist: of its turn, and of its shift
        velocity = np.diff(s, axis=0) / dt
        residuals = np.stack([turns[b] / dt[b] - turns[a] / dt[a], velocity[b] - velocity[a]], axis=1)
        # derivatives of both (m, 2, 3, 6) by the twists of three poses and by the centre
        by = np.zeros((4, m, 2, 3, 6))
        before, after = 1 / dt[a][:, :, None], 1 / dt[b][:, :, None]
        by[0, :, 0, :, :3], by[2, :, 0, :, :3] = -R[b] * before, -R[c] * after
        by[1, :, 0, :, :3] = R[b] * before + R[c] * after
        by[0, :, 1], by[2, :, 1] = ds[a] * before, ds[c] * after
        by[1, :, 1] = -ds[b] * (before + after)
        by[3, :, 1, :, 3:] = -by[:3, :, 1, :, 3:].sum(axis=0)
        h = 0.5 * (dt[a] + dt[b])
        sigma = np.hstack([self.angular_sigma * h, self.linear_sigma * h])
        w = self._weight / (sigma**2 * (1 + (residuals**2).sum(axis=2) / (JUMP * sigma) ** 2))
        slopes = np.einsum('ms,pmsij,msi->mpj', w, by, residuals)
        whole = by.transpose(1, 0, 2, 3, 4).reshape(m, 4, 6, 6)
        weighed = (whole * np.repeat(w, 3, axis=1)[:, None, :, None]).transpose(0, 1, 3, 2)
        products = weighed[:, :, None] @ whole[:, None]
        for p, rows in enumerate((a, b, c, np.full(m, n))):
            np.add.at(gradient, rows, slopes[:, p])
            for q, columns in enumerate((a, b, c, np.full(m, n))):
                blocks.add(rows, columns, products[:, p, q])

    def jumps(self, poses: Sequence[Array]) -> NDArray[np.intp]:
        """Poses, by index, at which the rate changes by so much that the next one lies elsewhere."""
        middles, dt = self._middles(1), np.diff(self._t)
        if len(poses) < FEWEST or not (dt > 0).all():
            return middles[:0]
        unexpected = self._unexpected_turns(poses) / dt[:, None]
        change = np.linalg.norm(unexpected[middles] - unexpected[middles - 1], axis=1)
        return middles[change * np.maximum(dt[middles], dt[middles - 1]) > UNEVEN]

    def evened(self, poses: Sequence[Array]) -> list[Array] | None:
        """The poses as they would be had the target always turned as it did for most of the time.

        Where a nearly round target shows little of its turn, and above all before its rate is known, the
        views may seem to stand still. The other explanation is tried: the longest run without a jump of the
        rate is continued to both sides.

        Returns:
            T_target_sensor (4, 4) of each; None without such a jump, or without a run of more than half.
        """
        n, jumps = len(poses), self.jumps(poses)
        dt = np.diff(self._t)
        if not len(jumps):
            return None
        rate = _turns(poses) / dt[:, None]
        bounds = np.unique(np.concatenate([[0], jumps, np.flatnonzero(~self._linked) + 1, [n]]))
        longest = int(np.argmax(np.diff(bounds)))
        first, last = int(bounds[longest]), int(bounds[longest + 1]) - 1
        if last - first + 1 <= n / 2:
            return None
        seen = np.array([T[:3, :3].T @ (self.centre - T[:3, 3]) for T in poses])
        velocity = np.diff(seen, axis=0) / dt[:, None]
        moved = list(poses)
        for end, near in (
            (first, slice(first, min(last, first + CONTINUED))),
            (last, slice(max(first, last - CONTINUED), last)),
        ):
            w, v = rate[near].mean(axis=0), velocity[near].mean(axis=0)
            for k in range(0, first) if end == first else range(last + 1, n):
                ahead = self._t[k] - self._t[end]
                R = poses[end][:3, :3] @ exp_so3(-w * ahead)
                moved[k] = transform(R, self.centre - R @ (seen[end] + v * ahead))
        return moved

    def _chain(self, stamps_ns: Sequence[int], linked: Sequence[bool], poses: Sequence[Array]) -> None:
        self._t = (np.asarray(stamps_ns, np.int64) - stamps_ns[0]) * 1e-9
        self._linked = np.asarray(linked, bool) & (np.diff(self._t) > 0)
        self._linked &= np.linalg.norm(_turns(poses), axis=1) < LARGEST_TURN

    def _unexpected_turns(self, poses: Sequence[Array]) -> Array:
        """Rotation vectors (n - 1, 3) from each pose to the next, less those of the body without torque."""
        turns = _turns(poses)
        if self._body is None:
            return turns
        dt = np.diff(self._t)
        turns -= dt[:, None] * rates_of(self._body, _midway(poses))
        J = inertia(self._body[:5])
        known = bridgeable(dt)
        turns[~self._linked & ~known] = 0.0  # any turn is as likely
        for k in np.flatnonzero(~self._linked & (dt > 0) & known).tolist():
            # over a gap it is no longer the rate halfway
            R, later = poses[k][:3, :3], poses[k + 1][:3, :3]
            omega: Array = np.asarray(np.linalg.solve(J, R @ self._body[5:]), np.float64)
            expected, _ = propagate(R.T, omega, J, dt[[k]])
            turns[k] = log_so3(later.T @ expected[0].T)
        return turns

    def _fit_body(self, poses: Sequence[Array]) -> tuple[Array, float] | None:
        """A body's shape and angular momentum (8,); sigma, rad/s², of the acceleration that it expects."""
        linked = self._linked
        if linked.sum() < FEWEST_RATES:
            return None
        dt = np.diff(self._t)[linked]
        R, w = _midway(poses), _turns(poses)[linked] / dt[:, None]
        best = fit_rates(R[linked], w, dt / np.median(dt))
        numbers = best.body
        square = 2 * best.cost / max(w.size - 8, 1)
        covariance = square * np.linalg.pinv(best.information, hermitian=True)
        b = self._middles(1)
        h = 0.5 * (self._t[b + 1] - self._t[b - 1])[:, None]

        def expected(numbers: Array) -> Array:
            rates = rates_of(numbers, R)
            return np.asarray((rates[b] - rates[b - 1]) / h)

        here = expected(numbers)
        slopes = np.array([(expected(numbers + d) - here) / DIFFERENCE for d in DIFFERENCE * np.eye(8)])
        variances = np.einsum('anj,ac,cnj->nj', slopes, covariance, slopes)
        return numbers, float(np.sqrt(np.median(variances.sum(axis=1)) / 3)) if len(b) else np.inf

    def _measure_turning(self, poses: Sequence[Array]) -> float:
        """Standard deviation, rad/s², of each component of the angular acceleration."""
        travelled = np.concatenate([np.zeros((1, 3)), np.cumsum(self._unexpected_turns(poses), axis=0)])
        found = [np.inf]
        for span in SPANS:
            b = self._middles(span)
            if len(b) < FEWEST:
                break
            found.append(_sigma(self._change(travelled, b, span)))
        return max(min(found), LEAST)

    def _measure_drift(self, poses: Sequence[Array]) -> tuple[float, Array]:
        """Standard deviation, m/s², of each component of the centre's acceleration, and the centre (3,)."""
        b = self._middles(1)
        if len(b) < FEWEST:
            return np.inf, self._middle
        R = np.array([T[:3, :3].T for T in poses])
        origin = np.array([R_k @ T[:3, 3] for R_k, T in zip(R, poses, strict=True)])
        A, y = self._change(R, b, 1), self._change(origin, b, 1)  # acceleration A c - y
        least = LEAST * self._extent
        centre, sigma, weight = self._middle, np.inf, np.ones(len(b))
        for _ in range(ROUNDS):
            acceleration = A @ centre - y
            sigma = max(_sigma(acceleration), least)
            weight = 1 / (1 + (acceleration**2).sum(axis=1) / (JUMP * sigma) ** 2)
            H = np.einsum('n,nij,nik->jk', weight, A, A) / sigma**2 + np.eye(3) / self._extent**2
            g = np.einsum('n,nij,ni->j', weight, A, y) / sigma**2 + self._middle / self._extent**2
            centre = np.linalg.solve(H, g)
        return sigma, centre

    def _change(self, path: Array, b: NDArray[np.intp], span: int) -> Array:
        """Second derivative (len(b), ...) of a path (n, ...) over so many poses to either side."""
        shape = (-1,) + (1,) * (path.ndim - 1)
        before = (self._t[b] - self._t[b - span]).reshape(shape)
        after = (self._t[b + span] - self._t[b]).reshape(shape)
        change = (path[b + span] - path[b]) / after - (path[b] - path[b - span]) / before
        return np.asarray(change / (0.5 * (before + after)))

    def _middles(self, span: int) -> NDArray[np.intp]:
        """Poses that are linked with so many to either side."""
        n = len(self._t)
        breaks = np.concatenate([[0], np.cumsum(~self._linked)])
        b = np.arange(span, n - span)
        return b[breaks[b + span] == breaks[b - span]]


def _sigma(accelerations: Array) -> float:
    """Standard deviation of each component, from the median norm of (n, 3)."""
    return float(np.median(np.linalg.norm(accelerations, axis=1))) / MEDIAN_NORM


def _midway(poses: Sequence[Array]) -> Array:
    """R_target_sensor (n - 1, 3, 3) halfway from each pose to the next."""
    return np.array([T[:3, :3] @ exp_so3(-0.5 * turn) for T, turn in zip(poses, _turns(poses), strict=False)])


def _turns(poses: Sequence[Array]) -> Array:
    """Rotation vectors (n - 1, 3), rad, of the target from each pose to the next, as the sensor sees them."""
    R = [T[:3, :3] for T in poses]
    return np.array([log_so3(later.T @ earlier) for earlier, later in pairwise(R)]).reshape(-1, 3)
