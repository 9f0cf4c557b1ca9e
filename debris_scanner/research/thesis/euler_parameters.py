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

"""Euler parameters (b0, b1, b2, b3), scalar first: attitude and rate in the thesis's two estimators (T6).

Trowbridge 2014, eq. 2.41-2.49, 2.57-2.62 and 2.95, section 2.7.1. Everywhere else in this package quaternions
are Hamilton with the scalar last; nothing leaves the estimators in this order.

The angular rate of two aligned frames is rotation angle over elapsed time, about the rotation axis. Eq. 2.42
reverses a rotation by negating the scalar part, which gives minus the conjugate: the same rotation, but taken
literally with an angle of 2 pi minus the wanted one. So the sign is normalised before the angle is computed
(erratum 6).
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array, from_quaternion, to_quaternion

IDENTITY = (1.0, 0.0, 0.0, 0.0)  # erratum 1: eq. 2.58 prints zeros, Tables 4.1-4.3 this
_SMALL = 1e-12


def of_rotation(R: Array) -> Array:
    """Euler parameters (4,), scalar not negative, of a rotation matrix (3, 3); eq. 2.43."""
    x, y, z, w = to_quaternion(R)
    return np.array([w, x, y, z])


def rotation_matrix(beta: Array) -> Array:
    """Rotation matrix (3, 3) of Euler parameters (4,), normalised first."""
    return from_quaternion(np.array([beta[1], beta[2], beta[3], beta[0]]))


def reversed_rotation(beta: Array) -> Array:
    """Euler parameters (4,) of the opposite rotation by negating the scalar part, eq. 2.42."""
    return np.array([-beta[0], beta[1], beta[2], beta[3]])


def rotation_vector(beta: Array) -> Array:
    """Angle times axis (3,), radians, of Euler parameters (4,); angle 0..pi, eq. 2.44-2.47.

    Both signs of the four parameters give the same vector.
    """
    if beta[0] < 0:
        beta = -beta
    sine = float(np.linalg.norm(beta[1:]))
    if sine < _SMALL:
        return np.asarray(2.0 * beta[1:])
    # atan2 instead of eq. 2.47's arccos, which loses half of the digits of a small angle
    return np.asarray(beta[1:] * (2.0 * np.arctan2(sine, beta[0]) / sine))


def of_rate(omega: Array, t: float) -> Array:
    """Euler parameters (4,) of rotating at a constant rate (3,), rad/s, for t seconds; eq. 2.57 for one axis.

    The sign of the scalar is not normalised: it follows the motion through more than one turn.
    """
    half = 0.5 * t
    rate = float(np.linalg.norm(omega))
    # np.sinc(x) is sin(pi x) / (pi x), smooth at rest
    return np.concatenate([[np.cos(rate * half)], omega * half * np.sinc(rate * half / np.pi)])


def rate_jacobian(omega: Array, t: float) -> Array:
    """Derivative (4, 3) of :func:`of_rate` by the rate; its middle column is that of eq. 2.59."""
    half = 0.5 * t
    rate = float(np.linalg.norm(omega))
    J = np.empty((4, 3))
    if rate * abs(half) < 1e-6:
        J[0] = -(half**2) * omega
        J[1:] = half * np.eye(3)
        return J
    axis = omega / rate
    along = np.outer(axis, axis)
    J[0] = -half * np.sin(rate * half) * axis
    J[1:] = np.sin(rate * half) / rate * (np.eye(3) - along) + half * np.cos(rate * half) * along
    return J


def left_matrix(beta: Array) -> Array:
    """G (4, 4) of eq. 2.95: the product beta gamma is ``left_matrix(beta) @ gamma``."""
    b0, b1, b2, b3 = beta
    return np.array([[b0, -b1, -b2, -b3], [b1, b0, -b3, b2], [b2, b3, b0, -b1], [b3, -b2, b1, b0]])


def right_matrix(beta: Array) -> Array:
    """Matrix (4, 4) of the same product by its right factor: gamma beta is ``right_matrix(beta) @ gamma``."""
    b0, b1, b2, b3 = beta
    return np.array([[b0, -b1, -b2, -b3], [b1, b0, b3, -b2], [b2, -b3, b0, b1], [b3, b2, -b1, b0]])


@dataclass(frozen=True)
class RateObservation:
    """Observation of both estimators: the result of frame-to-frame alignment at the newer frame's time."""

    stamp_ns: int
    omega: Array | None  # (3,), rad/s, Y of eq. 2.49; None where the two frames could not be aligned
    fitness: float  # d_k, m²


def angular_rate(R_previous_current: Array, dt: float) -> Array:
    """Observation Y (3,), rad/s: mean rate of the target between two frames, sensor axes, eq. 2.48 and 2.49.

    Args:
        R_previous_current: rotation (3, 3) that aligns the newer frame with the one before, from ICP.
        dt: time between them, seconds.

    A rotation by more than half a revolution between two frames is ambiguous: it is taken for the smaller one
    in the other direction.

    Raises:
        ValueError: no time has passed.
    """
    if not dt > 0:
        raise ValueError(f'frames must be apart in time, not {dt} s')
    return rotation_vector(reversed_rotation(of_rotation(R_previous_current))) / dt
