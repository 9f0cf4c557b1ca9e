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

"""What a scan tells of the target's dynamics: centre of mass, principal axes and inertia ratios.

The final poses of a scan are fitted by a torque-free rigid body (:mod:`.rigid_body`), by nonlinear least
squares from the last pose backwards, over more and more of the scan. Its centre of mass is the point that
moves as a free point does (:mod:`.centre_of_mass`). Three answers are possible:

- ``torque_free``: the body fits, and its inertia ratios are known.
- ``not_observable``: it fits, but it turns about one principal axis, which tells nothing of the ratios.
- ``not_torque_free``: it does not fit as well as the poses are known. Something drives or brakes the target,
  or the sensor itself turns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, exp_so3, log_so3
from debris_scanner.core.results import StampedPose
from debris_scanner.core.rigid_body import DIFFERENCE, bridgeable, fit_rates, inertia, principal, propagate
from debris_scanner.tracking.centre_of_mass import Centre, fit_centre

TORQUE_FREE, NOT_OBSERVABLE, NOT_TORQUE_FREE = 'torque_free', 'not_observable', 'not_torque_free'

MOST_POSES = 150  # that are fitted
FEWEST_POSES = 20
FIRST_RATE = 6  # poses, of which the first guess of the rate is made
LARGEST_TURN = 1.0  # rad, between two poses: beyond, their mean rate says little
ADDED = 20  # poses that each fit has more than the one before, at least
NEAR = 0.5  # rad: a fit finds its way from here
SLOW_SHARES = (0.0, 0.03, 0.1, 0.3, 0.6, 0.9)  # of the errors' variance
SHARED = 0.5  # of a single pose's variance: errors as slow as the scan
SHAPE_SIGMA = 1.0  # prior of the inertia's numbers: moments within a factor of some e² of each other
LARGEST_SHAPE = 2.5
LARGEST_DAMPING = 3.0  # factor of e, by which rates may have fallen in the scan
MISFIT = 4.0  # standard deviations of single poses: beyond, the body is not torque-free
KNOWN_RATIO = 0.1  # standard deviation of an inertia ratio, beyond which it is not known
ROUGHLY = 1e-3  # relative tolerance of fits that only begin the next one
OFF_SPHERE = np.array([0.05, -0.02, 0.0, 0.0, 0.0])  # where nothing tells which way, a shape to begin with
START, RATE, SHAPE, DAMPING = slice(0, 3), slice(3, 6), slice(6, 11), 11
FREE, EVEN = list(range(11)), list(range(6))  # numbers of a body without torque; of an even turn
DAMPED, EVENLY_DAMPED = [*FREE, DAMPING], [*EVEN, DAMPING]


@dataclass(frozen=True)
class Dynamics:
    """A rigid body fitted to a scan. Standard deviations are of one sigma."""

    kind: str  # torque_free, not_observable or not_torque_free
    stamp_ns: int  # of the last pose, where the fitted motion begins
    R: Array  # (3, 3), R_sensor_target there
    # (12,): turn from R, rate in rad/s, shape of the inertia (rigid_body); target frame; damping, 1/s
    numbers: Array
    covariance: Array  # (12, 12), of the numbers
    centre: Centre
    explained: bool = True  # whether the body, its rate falling or not, explains the poses

    @property
    def shape(self) -> Array:
        """Of the inertia (5,): see rigid_body."""
        return np.asarray(self.numbers[SHAPE])

    def _momentum(self, numbers: Array) -> Array:
        """Direction (3,) of the angular momentum, in the frame of the poses."""
        L = self.R @ exp_so3(numbers[START]) @ inertia(numbers[SHAPE]) @ numbers[RATE]
        return np.asarray(L / np.linalg.norm(L))

    def numbers_at(self, pose: StampedPose) -> Array:
        """The numbers (12,) as they are at a pose, T_sensor_target."""
        seconds = np.array([(pose.stamp_ns - self.stamp_ns) * 1e-9])
        R, omega = move(self.numbers, self.R, seconds)
        turn = log_so3(pose.T_sensor_target[:3, :3].T @ R[0])
        shape = self.shape if self.shape.any() else OFF_SPHERE
        return np.concatenate([turn, omega[0], shape, self.numbers[DAMPING:]])

    @property
    def inertia_ratios(self) -> Array:
        """The least and the middle principal moment over the largest, (2,)."""
        return _ratios(inertia(self.shape))

    def mass_properties(self, R_sensor_frame: Array | None = None) -> dict[str, Any]:
        """For summary.json: what is known, with standard deviations; ``observable`` false and why, else.

        All of it is told of a torque-free target alone whose inertia shows.

        Args:
            R_sensor_frame: (3, 3), from the poses' frame to the sensor at the last pose; None of the same.
        """
        told: dict[str, Any] = {'observable': self.kind == TORQUE_FREE, 'why': self.kind}
        if self.kind == TORQUE_FREE:
            _, axes = principal(inertia(self.shape))
            covariance = self.covariance[SHAPE, SHAPE]
            slopes = _slopes(lambda shape: _ratios(inertia(shape)), self.shape)
            turns = _slopes(lambda shape: log_so3(axes.T @ _nearest_axes(inertia(shape), axes)), self.shape)
            momentum = self._momentum(self.numbers)
            if R_sensor_frame is not None:
                momentum = R_sensor_frame @ momentum
            swings = _slopes(self._momentum, self.numbers)
            momentum_sigma = np.sqrt(np.sum(_sigmas(swings, self.covariance) ** 2) / 2)
            told |= {
                'inertia_ratios': self.inertia_ratios.tolist(),
                'inertia_ratios_sigma': _sigmas(slopes, covariance).tolist(),
                'principal_axes': axes.T.tolist(),  # unit vectors, target frame, least moment first
                'principal_axes_sigma_deg': np.degrees(_sigmas(turns, covariance)).tolist(),
                'angular_momentum_sensor': momentum.tolist(),  # unit vector, sensor frame
                'angular_momentum_sigma_deg': float(np.degrees(momentum_sigma)),
                'centre_of_mass_m': self.centre.point.tolist(),
                'centre_of_mass_sigma_m': self.centre.sigma.tolist(),
            }
        return told


def fit_dynamics(
    poses: Sequence[StampedPose],
    noise_rad: float,
    extent: float,
    before: Dynamics | None = None,
    mean_motion: float = 0.0,
) -> Dynamics | None:
    """Dynamics of a target from its final poses; None of too few.

    Args:
        poses: T_sensor_target, in order of time.
        noise_rad: standard deviation of a single pose's rotation about each axis.
        extent: of the target, m: the centre of mass is somewhere inside.
        before: fitted to earlier poses of the same frame, to begin with if it was free of torque.
        mean_motion: of the orbit, rad/s; 0 for a centre that moves on a straight line.
    """
    poses = lately(poses)
    if len(poses) < FEWEST_POSES:
        return None
    noise = max(noise_rad, 1e-5)
    t, R = draw(poses, evenly=True)
    numbers, body, explained = None, None, True
    if before is not None and before.kind != NOT_TORQUE_FREE and before.stamp_ns >= poses[0].stamp_ns:
        numbers = before.numbers_at(poses[-1])
        body = _fit_body(t, R, numbers, noise, FREE)
    if numbers is None or body is None or body.misfit > MISFIT * noise:
        numbers = _grown_fit(*draw(poses), _body_of_rates(poses), noise, FREE)
        body = _fit_body(t, R, numbers, noise, FREE)
    if body.misfit > MISFIT * noise:
        kind = NOT_TORQUE_FREE
        damped = _damped(poses, noise)
        body, explained = damped or body, damped is not None
    else:
        slopes_of_ratios = _slopes(lambda shape: _ratios(inertia(shape)), body.numbers[SHAPE])
        known = _sigmas(slopes_of_ratios, body.covariance[SHAPE, SHAPE]).max() < KNOWN_RATIO
        kind = TORQUE_FREE if known else NOT_OBSERVABLE
    if kind == NOT_OBSERVABLE:
        # an even turn, if that is as likely: an inertia that the noise chose might make it tumble later
        body = _even(t, R, body, noise)
    centre = fit_centre(poses[:: -(-len(poses) // MOST_POSES)], noise, extent, mean_motion)
    return Dynamics(kind, poses[-1].stamp_ns, R[0], body.numbers, body.covariance, centre, explained)


def _damped(poses: Sequence[StampedPose], noise: float) -> '_Body | None':
    """The body whose angular momentum falls exponentially, if it explains the poses."""
    numbers = _grown_fit(*draw(poses), _body_of_rates(poses, damped=True), noise, DAMPED)
    t, R = draw(poses, evenly=True)
    body = _fit_body(t, R, numbers, noise, DAMPED)
    return None if body.misfit > MISFIT * noise else _even(t, R, body, noise)


def _even(t: Array, R: Array, body: '_Body', noise: float) -> '_Body':
    """A turn about one axis in place of a body, if that is as likely by Schwarz's criterion."""
    fitted = EVENLY_DAMPED if body.numbers[DAMPING] else EVEN
    even = _fit_body(t, R, np.where(np.isin(np.arange(12), fitted), body.numbers, 0.0), noise, fitted)
    lost = body.errors.square(even.residuals) - body.errors.square(body.residuals)
    return even if lost < 5 * np.log(3 * len(t)) else body


def lately(poses: Sequence[StampedPose]) -> Sequence[StampedPose]:
    """The poses since the last gap that no motion leads across."""
    if len(poses) < 2:
        return poses
    gaps = np.flatnonzero(~bridgeable(np.diff([pose.stamp_ns for pose in poses])))
    return poses[int(gaps[-1]) + 1 :] if len(gaps) else poses


def draw(poses: Sequence[StampedPose], evenly: bool = False) -> tuple[Array, Array]:
    """Some poses backwards, the more densely the later: seconds (n,) from the last, attitudes (n, 3, 3)."""
    spaced = np.linspace if evenly else np.geomspace
    chosen = np.unique(spaced(1, len(poses), MOST_POSES).round().astype(int))
    t = np.array([(poses[-k].stamp_ns - poses[-1].stamp_ns) * 1e-9 for k in chosen])
    return t, np.array([poses[-k].T_sensor_target[:3, :3] for k in chosen])


def late_rate(poses: Sequence[StampedPose]) -> Array:
    """Mean rate (3,), rad/s, target frame, of neighbours: between drawn poses a fast target turns too far."""
    turns = [
        log_so3(a.T_sensor_target[:3, :3].T @ b.T_sensor_target[:3, :3]) / ((b.stamp_ns - a.stamp_ns) * 1e-9)
        for a, b in pairwise(poses)
    ]
    return np.asarray(np.mean(turns, axis=0))


def _body_of_rates(poses: Sequence[StampedPose], damped: bool = False) -> Array:
    """Numbers (12,) at the last pose of the body that turns at the rates between neighbours."""
    T = np.array([pose.T_sensor_target for pose in poses])
    t = np.array([(pose.stamp_ns - poses[-1].stamp_ns) * 1e-9 for pose in poses])
    dt = np.diff(t)
    turns = small_logs(np.einsum('nji,njk->nik', T[:-1, :3, :3], T[1:, :3, :3]))
    halfway = T[:-1, :3, :3] @ scipy.spatial.transform.Rotation.from_rotvec(0.5 * turns).as_matrix()
    rates = np.einsum('nij,nj->ni', halfway, turns / dt[:, None])
    weights = (np.linalg.norm(turns, axis=1) < LARGEST_TURN) * np.minimum(dt / np.median(dt), 1.0)
    body = fit_rates(halfway.transpose(0, 2, 1), rates, weights, t[:-1] + 0.5 * dt if damped else None).body
    J, last = inertia(body[:5]), T[-1, :3, :3]
    damping = body[8] if damped else 0.0
    return np.concatenate([np.zeros(3), np.linalg.solve(J, last.T @ body[5:8]), body[:5], [damping]])


@dataclass(frozen=True)
class _Errors:
    """Errors of poses about each axis: white ones, and slow ones whose correlation decays exponentially."""

    factor: Array  # (n, n), Cholesky's of their covariance

    def square(self, residuals: Array) -> float:
        """Sum of squares of residuals (n, 3), in standard deviations of independent errors."""
        return float(np.sum(scipy.linalg.solve_triangular(self.factor, residuals, lower=True) ** 2))


@dataclass(frozen=True)
class _Body:
    """A fitted body: its numbers (12,), and how well they are known."""

    numbers: Array
    covariance: Array
    residuals: Array  # (n, 3) rad
    errors: _Errors

    @property
    def misfit(self) -> float:
        """Root mean square of the residuals, rad."""
        return float(np.sqrt(np.mean(self.residuals**2)))


def _fitted_errors(t: Array, residuals: Array, slopes: Array, prior: Array) -> tuple[Array, _Errors]:
    """Covariance (p, p) of fitted numbers, and the likeliest errors of the poses.

    How slow the errors are is not known: a grid of possibilities, each as likely as its restricted likelihood
    says, which allows for what the fit has followed (Harville 1977). The covariance is the mean of theirs.

    Args:
        t: (n,) s.
        residuals: (n, 3) rad.
        slopes: (n, 3, p), their derivatives.
        prior: (p, p), information on the numbers.
    """
    n, _, count = slopes.shape
    apart = np.abs(t[:, None] - t)
    shortest, longest = float(np.median(np.abs(np.diff(t)))), 0.5 * float(np.ptp(t))
    J, e = slopes.reshape(n, -1), residuals
    square = max(float(np.mean(e**2)), 1e-14)
    found = []
    for tau in np.geomspace(shortest, longest, 8):
        alike = np.exp(-apart / tau)
        for slow in SLOW_SHARES:
            factor = np.linalg.cholesky(slow * alike + (1 - slow) * np.eye(n))
            white_J = scipy.linalg.solve_triangular(factor, J, lower=True).reshape(-1, count)
            white_e = scipy.linalg.solve_triangular(factor, e, lower=True).ravel()
            normal = white_J.T @ white_J + square * prior
            step = -np.linalg.solve(normal, white_J.T @ white_e)
            variance = max(float(white_e @ (white_e + white_J @ step)), 1e-14) / (3 * n - count)
            likelihood = -3 * np.log(np.diag(factor)).sum() - 0.5 * np.linalg.slogdet(normal)[1]
            likelihood -= 0.5 * (3 * n - count) * np.log(variance)
            covariance = np.linalg.inv(normal / variance + prior * (1 - square / variance))
            found.append((likelihood, covariance, np.sqrt(variance) * factor))
    weights = np.exp(np.array([f[0] for f in found]) - max(f[0] for f in found))
    weights /= weights.sum()
    mean = sum((w * f[1] for w, f in zip(weights, found, strict=True)), np.zeros((count, count)))
    return mean, _Errors(found[int(np.argmax(weights))][2])


def _of_shared_errors(t: Array, slopes: Array, prior: Array, noise: float) -> Array:
    """Covariance (p, p) that errors as slow as the scan leave in fitted numbers.

    All poses share the attitude of the target frame and any bend round the loop. The fit follows those, so
    its residuals do not show them. Arguments as above, and the standard deviation of a single pose, rad.
    """
    n, _, count = slopes.shape
    J = slopes.reshape(n * 3, count)
    gains = np.linalg.solve(J.T @ J + noise**2 * prior, J.T).reshape(count, n, 3)
    alike = np.exp(-np.abs(t[:, None] - t) / np.ptp(t))
    return np.asarray(SHARED * noise**2 * np.einsum('ank,nm,bmk->ab', gains, alike, gains, optimize=True))


def move(numbers: Array, R: Array, seconds: Array) -> tuple[Array, Array]:
    """Attitudes (n, 3, 3) and rates (n, 3) of a body, whose numbers (12,) begin at R (3, 3).

    With all rates falling exponentially, Euler's equations are those without torque in a time that slows
    down.
    """
    damping = float(numbers[DAMPING])
    slowed = -np.expm1(-damping * seconds) / damping if damping else seconds
    found, omega = propagate(R @ exp_so3(numbers[START]), numbers[RATE], inertia(numbers[SHAPE]), slowed)
    return found, omega * np.exp(-damping * seconds)[:, None]


def _apart(numbers: Array, t: Array, R: Array) -> Array:
    """Rotation vectors (n, 3) from a body's attitudes to those that were seen, R (n, 3, 3)."""
    found, _ = move(numbers, R[0], t)
    return small_logs(np.einsum('nji,njk->nik', found, R))


def _grown_fit(t: Array, R: Array, numbers: Array, noise: float, fitted: Sequence[int]) -> Array:
    """Numbers (12,) of the body, from the last poses backwards, over more and more of them.

    Each fit takes in what the one before it comes near to. A few poses tell little of the inertia, and
    their errors would spoil what the rates of the whole scan have told. Its bounds are those of all of them:
    what a few seconds allow, carried back to the first pose, would be a rate beyond all measure.
    """
    span, count = float(np.ptp(t)), 0
    numbers = np.clip(numbers, *_bounds(span))
    while count < len(t):
        astray = np.linalg.norm(_apart(numbers, t, R), axis=1) > NEAR
        near = int(np.argmax(astray)) if astray.any() else len(t)
        count = min(max(near, count + ADDED), len(t))
        numbers = _least_squares(t[:count], R[:count], numbers, noise, fitted, span, ROUGHLY)
    return numbers


def _least_squares(
    t: Array,
    R: Array,
    numbers: Array,
    noise: float,
    fitted: Sequence[int],
    span: float,
    tolerance: float = 1e-8,
) -> Array:
    """Fit some of a body's numbers to poses of a scan that lasts for a span, s; the others stay."""
    low, high = (bound[fitted] for bound in _bounds(span))

    def whole(some: Array) -> Array:
        moved = numbers.copy()
        moved[fitted] = some
        return moved

    def residuals(some: Array) -> Array:
        apart = _apart(whole(some), t, R).ravel() / noise
        return np.concatenate([apart, np.sqrt(_prior(t)) * whole(some)])

    solution = scipy.optimize.least_squares(
        residuals,
        np.clip(numbers[fitted], 0.99 * low, 0.99 * high),
        bounds=(low, high),
        x_scale='jac',
        loss='soft_l1',
        max_nfev=60,
        ftol=tolerance,
        xtol=tolerance,
    )
    return whole(solution.x)


def _bounds(span: float) -> tuple[Array, Array]:
    """Least and largest numbers (12,): rates fall, if at all, for no friction drives a body."""
    high = np.repeat([1.0, 20.0, LARGEST_SHAPE, LARGEST_DAMPING / span], [3, 3, 5, 1])
    return np.append(-high[:DAMPING], 0.0), high


def _prior(t: Array) -> Array:
    """Information (12,) on a body's numbers before anything was seen."""
    return np.repeat([0.0, SHAPE_SIGMA**-2, np.ptp(t) ** 2], [6, 5, 1])


def _fit_body(t: Array, R: Array, numbers: Array, noise: float, fitted: Sequence[int]) -> _Body:
    """Fit some of the numbers to all of these poses, and tell how well they are known."""
    numbers = _least_squares(t, R, numbers, noise, fitted, float(np.ptp(t)))
    residuals = _apart(numbers, t, R)
    slopes = np.empty((len(t), 3, len(fitted)))
    for column, k in enumerate(fitted):
        moved = numbers.copy()
        moved[k] += DIFFERENCE
        slopes[:, :, column] = (_apart(moved, t, R) - residuals) / DIFFERENCE
    prior = np.diag(_prior(t)[fitted])
    known, errors = _fitted_errors(t, residuals, slopes, prior)
    covariance = np.zeros((12, 12))
    covariance[np.ix_(fitted, fitted)] = known + _of_shared_errors(t, slopes, prior, noise)
    return _Body(numbers, covariance, residuals, errors)


def _ratios(J: Array) -> Array:
    moments, _ = principal(J)
    return np.asarray(moments[:2] / moments[2])


def _nearest_axes(J: Array, axes: Array) -> Array:
    """Principal axes (3, 3) of J in the order and with the signs of others."""
    _, found = principal(J)
    return np.asarray(found * np.sign(np.einsum('ij,ij->j', found, axes)))


def _slopes(function: Callable[[Array], Array], at: Array) -> Array:
    """Derivatives (len(at), m) of a function (m,) of some numbers."""
    step = 1e-4
    here = function(at)
    return np.array([(function(at + d) - here) / step for d in step * np.eye(len(at))])


def _sigmas(slopes: Array, covariance: Array) -> Array:
    """Standard deviations (m,) of what has these derivatives (n, m) by numbers of that covariance."""
    return np.sqrt(np.maximum(np.diag(slopes.T @ covariance @ slopes), 0.0))


def small_logs(rotations: NDArray[np.float64]) -> Array:
    """Rotation vectors (n, 3) of rotations (n, 3, 3) that are no half turns."""
    axis = 0.5 * np.stack(
        [
            rotations[:, 2, 1] - rotations[:, 1, 2],
            rotations[:, 0, 2] - rotations[:, 2, 0],
            rotations[:, 1, 0] - rotations[:, 0, 1],
        ],
        axis=1,
    )
    sine = np.linalg.norm(axis, axis=1)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1)
    angle = np.arctan2(sine, cosine)
    return np.asarray(axis * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None])
