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

"""Torque-free motion of a rigid body: its inertia up to scale, and where it turns from here.

Without torque only the ratios of the moments of inertia matter. Those of a real body are sums of two second
moments each, which are positive, so that the inertia is J = tr(S) 1 - S with S = L Lᵀ and tr(S) = 1. Five
numbers of a Cholesky factor give every such body and no other (Tweddle 2013; Wensing et al. 2018).

Euler's equations J w' = -w x J w are integrated by Runge and Kutta's fourth order, the attitude by the
exponential of the step's mean rate, corrected for the change of its direction (Magnus, fourth order).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import inlined, kernel

DIFFERENCE = 1e-5  # of a body's numbers, for derivatives
MOST_STEPS = 200  # of a fit
CONVERGED = 1e-10  # of the cost, that a step may still gain
LARGEST_STEP = 0.2  # rad, that a body turns in one step: 2e-4 degrees off after a minute

SHAPES = (
    (0.05, -0.02, 0.0, 0.0, 0.0),
    (-0.4, 0.3, 0.2, -0.2, 0.2),
    (0.3, 0.3, -0.2, 0.2, 0.2),
)  # to begin fits with


def inertia(shape: Array) -> Array:
    """Inertia (3, 3) of trace 2 in the target frame, from five numbers; zeros make a sphere."""
    a, b, c, d, e = shape
    L = np.array([[np.exp(a), 0.0, 0.0], [c, np.exp(b), 0.0], [d, e, np.exp(-a - b)]])
    S = L @ L.T
    return np.asarray(np.eye(3) - S / np.trace(S))


def principal(J: Array) -> tuple[Array, Array]:
    """Principal moments (3,), least first, and axes (3, 3), right-handed columns, of an inertia (3, 3)."""
    moments, axes = np.linalg.eigh(J)
    return moments, axes * np.array([1.0, 1.0, np.linalg.det(axes)])


def rates_of(body: Array, R: Array) -> Array:
    """Rates (n, 3) in the sensor frame, rad/s, of a torque-free body at the attitudes that it passes.

    Args:
        body: (8,), shape of the inertia, and angular momentum in the sensor frame.
        R: R_target_sensor (n, 3, 3).
    """
    J_inverse = np.linalg.inv(inertia(body[:5]))
    return np.asarray(np.einsum('nij,ni->nj', R, np.einsum('ij,nj->ni', J_inverse, R @ body[5:])))


@dataclass(frozen=True)
class FittedRates:
    """A body that turns at given rates."""

    body: Array  # (8,), shape of the inertia and angular momentum in the sensor frame; a ninth: damping, 1/s
    cost: float  # half of the soft squares of the weighted residuals in the rates' spread, and of the prior
    information: Array  # on these numbers: second derivatives of the cost


def fit_rates(R: Array, rates: Array, weights: Array, seconds: Array | None = None) -> FittedRates:
    """The body that turns at these rates: the likeliest by a soft loss, from several starts.

    No motion is integrated, so a long scan has no more local minima than a short one. Each number of the
    shape is taken for normal about zero, with the spread one; the damping over the whole time as well.

    Args:
        R: R_target_sensor (n, 3, 3).
        rates: (n, 3) in the sensor frame, rad/s.
        weights: (n,) of each, about one.
        seconds: (n,) of each, if the angular momentum may fall exponentially; none at time zero.
    """
    scale = max(float(np.std(rates, axis=0).max()), 1e-6)  # most of a tumble about the middle axis is even
    t = np.zeros(len(R)) if seconds is None else np.asarray(seconds, np.float64)
    count = 8 if seconds is None else 9
    prior = np.array([1.0] * 5 + [0.0] * 3 + [np.ptp(t)])[:count]
    arrays = [np.ascontiguousarray(a, np.float64) for a in (R, rates, weights / scale, t, prior)]
    starts = [np.append(s, inertia(np.array(s)) @ np.median(rates, axis=0)) for s in SHAPES]
    found = [_fit_rates(*arrays, np.append(s, np.zeros(count - 8))) for s in starts]
    return FittedRates(*min(found, key=lambda each: float(each[1])))


@kernel()
def _fit_rates(
    R: Array, rates: Array, weights: Array, t: Array, prior: Array, start: Array
) -> tuple[Array, float, Array]:
    """Levenberg and Marquardt's steps from a start; numbers, cost, and information, as FittedRates has."""
    body = start
    cost, H, g = _rates_cost(R, rates, weights, t, prior, body)
    scale, damping, growth = np.diag(H).copy(), 1e-3, 2.0
    for _ in range(MOST_STEPS):
        scale = np.maximum(np.maximum(scale, np.diag(H)), 1e-12)
        step = -np.linalg.solve(H + damping * np.diag(scale), g)
        there, H_there, g_there = _rates_cost(R, rates, weights, t, prior, body + step)
        expected = -0.5 * (step @ g - damping * (step * scale) @ step)
        gained = cost - there
        if gained > 0:
            body, cost, H, g = body + step, there, H_there, g_there
            damping, growth = damping * max(1 / 3, 1 - (2 * gained / expected - 1) ** 3), 2.0
        else:
            damping, growth = damping * growth, 2 * growth
        if expected < CONVERGED * cost or not np.isfinite(damping):
            break
    return body, cost, H


@kernel()
def _rates_cost(
    R: Array, rates: Array, weights: Array, t: Array, prior: Array, body: Array
) -> tuple[float, Array, Array]:
    """The cost of a body, its second derivatives by Gauss and Newton, and its gradient."""
    count = len(body)
    a, b, c, d, e = body[:5]
    L = np.array([[np.exp(a), 0.0, 0.0], [c, np.exp(b), 0.0], [d, e, np.exp(-a - b)]])
    dL = np.zeros((5, 3, 3))
    dL[0, 0, 0], dL[1, 1, 1] = L[0, 0], L[1, 1]
    dL[0, 2, 2] = dL[1, 2, 2] = -L[2, 2]
    dL[2, 1, 0] = dL[3, 2, 0] = dL[4, 2, 1] = 1.0
    S = L @ L.T
    total = np.trace(S)
    cost, H, g = np.inf, np.zeros((count, count)), np.zeros(count)
    if not np.isfinite(S).all() or not np.linalg.det(np.eye(3) - S / total) > 0:
        return cost, H, g  # a rod without thickness
    J_inverse = np.linalg.inv(np.eye(3) - S / total)
    slopes = np.empty((5, 3, 3))  # of the inertia's inverse
    for k in range(5):
        dS = dL[k] @ L.T + L @ dL[k].T
        slopes[k] = J_inverse @ (dS / total - S * (np.trace(dS) / total**2)) @ J_inverse
    falling = body[8] if count == 9 else 0.0
    cost = 0.0
    J, turned, momentum, rate = np.empty(count), np.empty((8, 3)), np.empty(3), np.empty(3)
    for n in range(len(R)):  # without small matrices, which would be allocated
        left = np.exp(-falling * t[n])
        for i in range(3):
            momentum[i] = R[n, i, 0] * body[5] + R[n, i, 1] * body[6] + R[n, i, 2] * body[7]
        for i in range(3):
            rate[i] = _row_times(J_inverse, i, momentum)
            for k in range(5):
                turned[k, i] = _row_times(slopes[k], i, momentum)
            for k in range(3):  # the inverse is symmetric
                turned[5 + k, i] = _row_times(J_inverse, i, R[n, :, k])
        for i in range(3):
            seen = weights[n] * left * (R[n, 0, i] * rate[0] + R[n, 1, i] * rate[1] + R[n, 2, i] * rate[2])
            for k in range(8):
                along = R[n, 0, i] * turned[k, 0] + R[n, 1, i] * turned[k, 1] + R[n, 2, i] * turned[k, 2]
                J[k] = -weights[n] * left * along
            if count == 9:
                J[8] = t[n] * seen
            cost += _add_soft(weights[n] * rates[n, i] - seen, J, H, g)
    for k in range(count):
        J[:] = 0.0
        J[k] = prior[k]
        cost += _add_soft(prior[k] * body[k], J, H, g)
    return cost, H, g


@inlined
def _row_times(A: Array, i: int, x: Array) -> float:
    """Component i of A x, of three."""
    return float(A[i, 0] * x[0] + A[i, 1] * x[1] + A[i, 2] * x[2])


@kernel()
def _add_soft(residual: float, J: Array, H: Array, g: Array) -> float:
    """Half the soft square of a residual with the slopes J; H and g are added to."""
    root = np.sqrt(1 + residual * residual)
    for k in range(len(J)):
        g[k] += J[k] * residual / root
        for m in range(len(J)):
            H[k, m] += J[k] * J[m] / root**3
    return root - 1


def bridgeable(intervals: Array) -> NDArray[np.bool_]:
    """Which of the times (n,) between the poses of a motion are no longer than all usual ones together.

    Nothing tells how a target went on for longer than it was seen, or for how long a clock jumped.
    """
    return np.asarray(intervals <= len(intervals) * np.median(intervals))


def propagate(R: Array, omega: Array, J: Array, seconds: Array) -> tuple[Array, Array]:
    """Attitudes (n, 3, 3) and rates (n, 3) of a torque-free body.

    Args:
        R: R_sensor_target (3, 3) at time zero; the sensor does not turn.
        omega: (3,) rad/s, target frame, at time zero.
        J: inertia (3, 3), target frame, any scale.
        seconds: (n,), in order away from zero, later or earlier.
    """
    h = LARGEST_STEP / max(float(np.linalg.norm(omega)), 1e-3)
    arrays = (np.ascontiguousarray(a, np.float64) for a in (R, omega, J, np.linalg.inv(J), seconds))
    return propagated(*arrays, h)


@kernel()
def propagated(
    R: Array, omega: Array, J: Array, J_inv: Array, seconds: Array, largest: float
) -> tuple[Array, Array]:
    """As :func:`propagate`, in steps of at most so many seconds."""
    n = len(seconds)
    attitudes, rates = np.empty((n, 3, 3)), np.empty((n, 3))
    R, w, now = R.copy(), omega.copy(), 0.0
    for k in range(n):
        steps = max(1, int(np.ceil(abs(seconds[k] - now) / largest)))
        h = (seconds[k] - now) / steps
        for _ in range(steps):
            k1 = _acceleration(w, J, J_inv)
            k2 = _acceleration(w + 0.5 * h * k1, J, J_inv)
            k3 = _acceleration(w + 0.5 * h * k2, J, J_inv)
            k4 = _acceleration(w + h * k3, J, J_inv)
            after = w + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            middle = 0.5 * (w + after) + h / 8 * (k1 - _acceleration(after, J, J_inv))
            turn = h / 6 * (w + 4 * middle + after) + h * h / 12 * _cross(w, after)
            R, w = R @ _exponential(turn), after
        now = seconds[k]
        attitudes[k], rates[k] = R, w
    return attitudes, rates


@kernel()
def _acceleration(w: Array, J: Array, J_inv: Array) -> Array:
    return J_inv @ _cross(J @ w, w)


@kernel()
def _cross(a: Array, b: Array) -> Array:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@kernel()
def _exponential(v: Array) -> Array:
    angle = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-9:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * (K @ K)
