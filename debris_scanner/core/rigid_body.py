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

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel

DIFFERENCE = 1e-5  # of a body's numbers, for derivatives
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


def fit_rates(
    R: Array, rates: Array, weights: Array, seconds: Array | None = None
) -> 'scipy.optimize.OptimizeResult':
    """The body (8,) that turns at these rates: the likeliest by a soft loss, from several starts.

    No motion is integrated, so a long scan has no more local minima than a short one.

    Args:
        R: R_target_sensor (n, 3, 3).
        rates: (n, 3) in the sensor frame, rad/s.
        weights: (n,) of each, about one.
        seconds: (n,) of each, if the angular momentum may fall exponentially; none at time zero.

    Returns:
        as SciPy's; its residuals are the weighted rates' in their spread, and the five numbers of the shape.
        With ``seconds`` a ninth number is the damping, 1/s, and a last residual is it over the whole time.
    """
    scale = max(float(np.std(rates, axis=0).max()), 1e-6)  # most of a tumble about the middle axis is even
    weight = weights[:, None] / scale

    t = np.zeros(len(R)) if seconds is None else seconds
    fitted = 8 if seconds is None else 9
    prior = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, np.ptp(t)])[[*range(5), *range(8, fitted)]]

    def whole(some: Array) -> Array:
        return np.append(some, np.zeros(9 - fitted))

    def residuals(some: Array) -> Array:
        body = whole(some)
        falls = np.exp(-body[8] * t)[:, None]
        return np.append((weight * (rates - falls * rates_of(body[:8], R))).ravel(), prior @ body)

    def slopes(some: Array) -> Array:
        body = whole(some)
        of_damping = -t[:, None, None] * rates_of(body[:8], R)[:, :, None]
        of_rates = np.concatenate([_rate_slopes(body[:8], R), of_damping], axis=2)
        of_rates *= -weight[:, :, None] * np.exp(-body[8] * t)[:, None, None]
        return np.concatenate([of_rates.reshape(-1, 9), prior])[:, :fitted]

    starts = [np.append(s, inertia(np.array(s)) @ np.median(rates, axis=0)) for s in SHAPES]
    found = [
        scipy.optimize.least_squares(
            residuals, np.append(s, np.zeros(fitted - 8)), slopes, loss='soft_l1', x_scale='jac', max_nfev=50
        )
        for s in starts
    ]
    return min(found, key=lambda each: float(each.cost))


def _rate_slopes(body: Array, R: Array) -> Array:
    """Derivatives (n, 3, 8) of ``rates_of`` by shape and angular momentum; of the inertia by differences."""
    J_inverse = np.linalg.inv(inertia(body[:5]))
    steps = DIFFERENCE * np.eye(5)
    by_shape = [(inertia(body[:5] + d) - inertia(body[:5] - d)) / (2 * DIFFERENCE) for d in steps]
    of_inverse = np.array([-J_inverse @ dJ @ J_inverse for dJ in by_shape])
    back = R.transpose(0, 2, 1)
    shape = back @ np.einsum('kij,nj->nik', of_inverse, R @ body[5:])
    return np.concatenate([shape, back @ J_inverse @ R], axis=2)


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
    return _propagate(*arrays, h)


@kernel()
def _propagate(
    R: Array, omega: Array, J: Array, J_inv: Array, seconds: Array, largest: float
) -> tuple[Array, Array]:
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
