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

"""Torque-free rotation of a rigid body: Euler's equations, integrated numerically (thesis part T28)."""

import numpy as np
import scipy

from debris_scanner.core.geometry import Array, from_quaternion, to_quaternion


class TorqueFreeBody:
    """Attitude and rate of a body without external torque.

    The integration is tight enough (relative 1e-10) that energy and angular momentum stay within
    1e-7 of their start over a minute.
    """

    def __init__(self, inertia: Array, R_world_body: Array, omega_body: Array, duration_s: float) -> None:
        """Integrate once over the whole duration.

        Args:
            inertia: (3,) principal moments about the body's axes, any unit.
            R_world_body: attitude (3, 3) at the start.
            omega_body: (3,) rad/s, body frame, at the start.
            duration_s: how far the attitude is known.

        Raises:
            ValueError: moments that no mass distribution has.
        """
        if inertia.min() <= 0 or 2 * inertia.max() > inertia.sum():
            raise ValueError(f'no rigid body has the principal moments {inertia.tolist()}')
        self._duration_s = max(duration_s, 1e-3)
        solution = scipy.integrate.solve_ivp(
            _derivative,
            (0.0, self._duration_s),
            np.concatenate([to_quaternion(R_world_body), omega_body]),
            method='DOP853',
            rtol=1e-10,
            atol=1e-12,
            dense_output=True,
            args=(inertia,),
        )
        self._state = solution.sol

    def attitude(self, t_s: float) -> Array:
        """R_world_body (3, 3) at t_s, which must lie within the duration."""
        return from_quaternion(self._at(t_s)[:4])

    def rate(self, t_s: float) -> Array:
        """Angular rate (3,), rad/s, body frame, at t_s."""
        return self._at(t_s)[4:]

    def _at(self, t_s: float) -> Array:
        if not 0 <= t_s <= self._duration_s:
            raise ValueError(f'the tumble is known from 0 to {self._duration_s} s, not at {t_s} s')
        return np.asarray(self._state(t_s), np.float64)


def _derivative(_t: float, state: Array, inertia: Array) -> Array:
    """Derivative of (quaternion xyzw world from body, rate in the body frame)."""
    v, w, omega = state[:3], state[3], state[4:]
    q_dot = 0.5 * np.array([*(w * omega + np.cross(v, omega)), -v @ omega])
    return np.concatenate([q_dot, np.cross(inertia * omega, omega) / inertia])
