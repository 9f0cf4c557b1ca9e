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
moves on a straight line. Three answers are possible:

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
from numpy.typing import NDArray
from scipy.optimize import least_squares

from debris_scanner.core.geometry import Array, exp_so3, log_so3
from debris_scanner.core.results import StampedPose
from debris_scanner.tracking.rigid_body import inertia, principal, propagate

TORQUE_FREE, NOT_OBSERVABLE, NOT_TORQUE_FREE = 'torque_free', 'not_observable', 'not_torque_free'

MOST_POSES = 150  # that are fitted, drawn the more densely the later
FEWEST_POSES = 20
FIRST_RATE = 6  # poses, of which the first guess of the rate is made
ADDED = 20  # poses that each fit has more than the one before, over two to three times the time
SHAPE_SIGMA = 1.0  # prior of the inertia's numbers: moments within a factor of some e² of each other
LARGEST_SHAPE = 2.5
MISFIT = 4.0  # standard deviations of single poses: beyond, the body is not torque-free
KNOWN_RATIO = 0.1  # standard deviation of an inertia ratio, beyond which it is not known
DIFFERENCE = 1e-5  # of numbers, for derivatives
START, RATE, SHAPE = slice(0, 3), slice(3, 6), slice(6, 11)


@dataclass(frozen=True)
class Dynamics:
    """A rigid body fitted to a scan. Standard deviations are of one sigma."""

    kind: str  # torque_free, not_observable or not_torque_free
    shape: Array  # (5,), of the inertia: see rigid_body
    shape_covariance: Array  # (5, 5)
    centre: Array  # of mass (3,), target frame, m
    centre_sigma: Array  # (3,) m

    @property
    def inertia_ratios(self) -> Array:
        """The least and the middle principal moment over the largest, (2,)."""
        return _ratios(inertia(self.shape))

    def mass_properties(self) -> dict[str, Any]:
        """For summary.json: what is known, with standard deviations; ``observable`` false and why, else.

        All of it is told of a torque-free target alone whose inertia shows.
        """
        told: dict[str, Any] = {'observable': self.kind == TORQUE_FREE, 'why': self.kind}
        if self.kind == TORQUE_FREE:
            _, axes = principal(inertia(self.shape))
            slopes = _slopes(lambda shape: _ratios(inertia(shape)), self.shape)
            turns = _slopes(lambda shape: log_so3(axes.T @ _nearest_axes(inertia(shape), axes)), self.shape)
            told |= {
                'inertia_ratios': self.inertia_ratios.tolist(),
                'inertia_ratios_sigma': _sigmas(slopes, self.shape_covariance).tolist(),
                'principal_axes': axes.T.tolist(),  # unit vectors, target frame, least moment first
                'principal_axes_sigma_deg': np.degrees(_sigmas(turns, self.shape_covariance)).tolist(),
                'centre_of_mass_m': self.centre.tolist(),
                'centre_of_mass_sigma_m': self.centre_sigma.tolist(),
            }
        return told


def fit_dynamics(poses: Sequence[StampedPose], noise_rad: float, extent: float) -> Dynamics | None:
    """Dynamics of a target from its final poses; None of too few.

    Args:
        poses: T_sensor_target, in order of time.
        noise_rad: standard deviation of a single pose's rotation about each axis.
        extent: of the target, m: the centre of mass is somewhere inside.
    """
    if len(poses) < FEWEST_POSES:
        return None
    chosen = np.unique(np.geomspace(1, len(poses), MOST_POSES).round().astype(int))
    drawn = [poses[-k] for k in chosen]  # backwards
    t = np.array([(p.stamp_ns - drawn[0].stamp_ns) * 1e-9 for p in drawn])
    R = np.array([p.T_sensor_target[:3, :3] for p in drawn])
    noise = max(noise_rad, 1e-5)
    # of all poses, for between drawn ones a fast target turns too far
    steps = list(pairwise(poses[-FIRST_RATE:]))
    rate = np.mean([_rate(a, b) for a, b in steps], axis=0)
    numbers, slopes, residuals = _fit_body(t, R, rate, noise)
    misfit = float(np.sqrt(np.mean(residuals**2)))
    # neighbours err alike, and count for less
    alike = np.clip(np.mean(residuals[1:] * residuals[:-1]) / max(misfit**2, 1e-18), 0.0, 0.98)
    information = slopes.T @ slopes * (noise / max(misfit, 1e-6)) ** 2 * (1 - alike) / (1 + alike)
    information[SHAPE, SHAPE] += np.eye(5) / SHAPE_SIGMA**2
    covariance = np.linalg.pinv(information, hermitian=True)[SHAPE, SHAPE]
    if misfit > MISFIT * noise:
        kind = NOT_TORQUE_FREE
    else:
        slopes_of_ratios = _slopes(lambda shape: _ratios(inertia(shape)), numbers[SHAPE])
        known = _sigmas(slopes_of_ratios, covariance).max() < KNOWN_RATIO
        kind = TORQUE_FREE if known else NOT_OBSERVABLE
    return Dynamics(
        kind, numbers[SHAPE], covariance, *_fit_centre(poses[:: -(-len(poses) // MOST_POSES)], noise, extent)
    )


def _rate(a: StampedPose, b: StampedPose) -> Array:
    """Mean rate (3,) between two poses, rad/s, target frame."""
    turn = log_so3(a.T_sensor_target[:3, :3].T @ b.T_sensor_target[:3, :3])
    return turn / ((b.stamp_ns - a.stamp_ns) * 1e-9)


def _fit_body(t: Array, R: Array, rate: Array, noise: float) -> tuple[Array, Array, Array]:
    """Numbers (11,) of the body; derivatives (3 n, 11) of its residuals in sigmas; residuals (n, 3), rad."""

    def residuals(numbers: Array, count: int) -> Array:
        found, _ = propagate(
            R[0] @ exp_so3(numbers[START]), numbers[RATE], inertia(numbers[SHAPE]), t[:count]
        )
        apart = np.einsum('nji,njk->nik', found, R[:count])
        return np.concatenate([_small_logs(apart).ravel() / noise, numbers[SHAPE] / SHAPE_SIGMA])

    # off the sphere, where nothing tells which way
    numbers = np.concatenate([np.zeros(3), rate, [0.05, -0.02, 0.0, 0.0, 0.0]])
    bounds = np.repeat([1.0, 20.0, LARGEST_SHAPE], [3, 3, 5])
    for count in (*range(FEWEST_POSES, len(t), ADDED), len(t)):
        solution = least_squares(
            residuals,
            np.clip(numbers, -0.99 * bounds, 0.99 * bounds),
            bounds=(-bounds, bounds),
            args=(count,),
            x_scale='jac',
            loss='soft_l1',
            max_nfev=60,
        )
        numbers = solution.x
    at = residuals(numbers, len(t))
    slopes = np.empty((len(at), len(numbers)))
    for k in range(len(numbers)):
        moved = numbers.copy()
        moved[k] += DIFFERENCE
        slopes[:, k] = (residuals(moved, len(t)) - at) / DIFFERENCE
    return numbers, slopes[:-5], noise * at[:-5].reshape(-1, 3)


def _fit_centre(poses: Sequence[StampedPose], noise_rad: float, extent: float) -> tuple[Array, Array]:
    """Centre of mass (3,) and its sigmas: R c + p is on a straight line x + v t.

    Errors of the attitudes look like information on the centre, as much as they would move it; that much does
    not count. Along the axis of a pure spin nothing is left, and a prior of the target's extent holds it.
    """
    t = np.array([(pose.stamp_ns - poses[0].stamp_ns) * 1e-9 for pose in poses])
    R = np.array([pose.T_sensor_target[:3, :3] for pose in poses])
    p = np.array([pose.T_sensor_target[:3, 3] for pose in poses])
    basis = np.column_stack([np.ones(len(t)), t])  # of what moves evenly
    fixed = basis @ np.linalg.pinv(basis)
    A, y = R - np.einsum('ij,jkl->ikl', fixed, R), fixed @ p - p  # A c = y where the line is taken out
    seen, along = np.einsum('nij,nik->jk', A, A), np.einsum('nij,ni->j', A, y)
    values, axes = np.linalg.eigh(seen)
    values = np.maximum(values - len(t) * (MISFIT * noise_rad) ** 2, 0.0)
    seen_surely: Array = axes @ np.diag(values) @ axes.T
    centre: Array = np.zeros(3)
    sigma = 0.01 * extent
    for _ in range(5):
        residuals = A @ centre - y
        sigma = max(float(np.sqrt(np.mean(residuals**2))), 1e-5 * extent) if centre.any() else sigma
        alike = np.clip(np.mean(residuals[1:] * residuals[:-1]) / sigma**2, 0.0, 0.98)
        weight = (1 - alike) / (1 + alike) / sigma**2
        information = weight * seen_surely + np.eye(3) / extent**2
        known = axes @ np.diag(values > 0) @ axes.T
        centre = np.asarray(np.linalg.solve(information, weight * known @ along))
    return centre, np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


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


def _small_logs(rotations: NDArray[np.float64]) -> Array:
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
