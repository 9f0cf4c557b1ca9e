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

"""The thesis's attitude filter: seven states, Euler parameters and rate, fed by frame-to-frame rates (T9).

Trowbridge 2014, sections 2.6 and 2.8, eq. 2.37-2.40 and 2.62-2.67, and the gate of section 4.3. With the
errata corrected it runs as printed, weaknesses included:

* sigma_u² is a spectral density of angular acceleration, rad²/s³, so that every block of eq. 2.65 has
  the units of what it is added to (erratum 4). d_k, m², serves as variance in (rad/s)² (erratum 5): a
  scale, about a hundred times smaller than what frame-to-frame alignment really scatters, which makes the
  filter follow its observations closely.
* The attitude block of eq. 2.65 is that of an angle, though half an angle is what Euler parameters hold,
  and it is padded to the scalar in the print (I of size 4) but not in the text; the print is followed.
* Eq. 2.62 integrates the rate as if its components were the target's, while eq. 2.48 measures them along
  the sensor's axes. On one fixed axis, the only case the thesis treats, both are the same;
  ``rate_axes='sensor'`` is right for any motion. A forward Euler step (eq. 2.63) turns by the arctangent
  of the wanted half angle; ``propagation='exact'`` does not.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import ParameterError, parameter
from debris_scanner.research.thesis.euler_parameters import (
    RateObservation,
    left_matrix,
    of_rate,
    rate_jacobian,
    right_matrix,
    rotation_matrix,
)

PROPAGATIONS = ('euler', 'exact')
RATE_AXES = ('body', 'sensor')
_H = np.hstack([np.zeros((3, 4)), np.eye(3)])  # eq. 2.51


@dataclass(frozen=True)
class EkfSettings:
    """Prior, process noise and gate; defaults as in Table 4.1 where it prints them."""

    sigma_u2: float = parameter(
        0.1, 'process noise: spectral density of the angular acceleration', 'rad²/s³', 0.0
    )
    gate_sigma: float = parameter(
        2.0, 'observations further than this from the prediction are rejected; 0 accepts all', 'sigma', 0.0
    )
    prior_state: tuple[float, float, float, float, float, float, float] = parameter(
        (1.0, 0.0, 0.0, 0.0, 0.0, 0.2795, 0.0), 'Euler parameters, scalar first, and rate', '1, rad/s'
    )
    prior_variance: tuple[float, float, float, float, float, float, float] = parameter(
        (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), 'diagonal of the prior covariance', '1, (rad/s)²', 0.0
    )
    propagation: str = parameter('euler', 'euler (eq. 2.63) or exact')
    rate_axes: str = parameter('body', 'axes of the rate: body (eq. 2.62 as printed) or sensor')

    def __post_init__(self) -> None:
        if self.propagation not in PROPAGATIONS:
            raise ParameterError(f'propagation {self.propagation!r} is none of {", ".join(PROPAGATIONS)}')
        if self.rate_axes not in RATE_AXES:
            raise ParameterError(f'rate_axes {self.rate_axes!r} is none of {", ".join(RATE_AXES)}')
        if not any(self.prior_state[:4]):
            raise ParameterError('the first four numbers of prior_state are no attitude: all are zero')


@dataclass(frozen=True)
class EkfStep:
    """The filter after one frame."""

    stamp_ns: int
    state: Array  # (7,)
    covariance: Array  # (7, 7), P
    innovation: Array | None  # (3,) rad/s, observed minus predicted; None without observation
    innovation_covariance: Array | None  # (3, 3)
    residual: Array | None  # (3,) rad/s, observed minus estimated: post-fit
    accepted: bool

    @property
    def omega(self) -> Array:
        """Rate (3,), rad/s."""
        return self.state[4:]

    @property
    def three_sigma(self) -> Array:
        """Three standard deviations (3,) of the rate, rad/s."""
        return 3.0 * np.sqrt(np.diag(self.covariance)[4:])

    @property
    def R_sensor_target(self) -> Array:
        """Attitude (3, 3); the target frame is the first frame's."""
        return rotation_matrix(self.state[:4])


class AttitudeEkf:
    """State X (7,) and covariance P (7, 7); ``step`` takes one frame."""

    def __init__(self, start_ns: int, settings: EkfSettings | None = None) -> None:
        self.settings = settings or EkfSettings()
        self.stamp_ns = start_ns
        self.state = np.array(self.settings.prior_state)
        self.state[:4] /= np.linalg.norm(self.state[:4])
        self.covariance = np.diag(self.settings.prior_variance)

    def step(self, observation: RateObservation) -> EkfStep:
        """Predict to the observation's time and correct by it, unless it is missing or gated.

        Raises:
            ValueError: if the observation is not later than the last one.
        """
        dt = (observation.stamp_ns - self.stamp_ns) * 1e-9
        if not dt > 0:
            raise ValueError(f'observation {observation.stamp_ns} is not later than {self.stamp_ns}')
        self.stamp_ns = observation.stamp_ns
        self._predict(dt, observation.fitness)
        innovation = covariance = residual = None
        accepted = False
        if observation.omega is not None:
            innovation = observation.omega - self.state[4:]
            covariance = _H @ self.covariance @ _H.T + observation.fitness * np.eye(3)  # eq. 2.64
            accepted = self._within_gate(innovation, covariance)
            if accepted:
                self._correct(innovation, covariance, observation.fitness)
            residual = observation.omega - self.state[4:]
        return EkfStep(
            self.stamp_ns,
            self.state.copy(),
            self.covariance.copy(),
            innovation,
            covariance,
            residual,
            accepted,
        )

    def _within_gate(self, innovation: Array, covariance: Array) -> bool:
        gate = self.settings.gate_sigma
        return gate == 0 or bool((np.abs(innovation) <= gate * np.sqrt(np.diag(covariance))).all())

    def _predict(self, dt: float, fitness: float) -> None:
        Phi = self.transition(dt)
        beta, omega = self.state[:4], self.state[4:]
        if self.settings.propagation == 'euler':
            beta = beta + dt * 0.5 * self._product(beta)[:, 1:] @ omega  # eq. 2.62 and 2.63
        else:
            beta = self._product(beta) @ of_rate(omega, dt)
        self.state[:4] = beta / np.linalg.norm(beta)
        self.covariance = Phi @ self.covariance @ Phi.T + process_noise(dt, fitness, self.settings.sigma_u2)

    def transition(self, dt: float) -> Array:
        """Derivative (7, 7) of the propagated state by the present one, renormalisation left aside."""
        beta, omega = self.state[:4], self.state[4:]
        other = right_matrix if self.settings.rate_axes == 'body' else left_matrix
        Phi = np.eye(7)
        if self.settings.propagation == 'euler':
            Phi[:4, :4] += dt * 0.5 * other(np.array([0.0, *omega]))
            Phi[:4, 4:] = dt * 0.5 * self._product(beta)[:, 1:]
        else:
            Phi[:4, :4] = other(of_rate(omega, dt))
            Phi[:4, 4:] = self._product(beta) @ rate_jacobian(omega, dt)
        return Phi

    def _product(self, beta: Array) -> Array:
        """Matrix (4, 4) by which the attitude takes a further turn: on its right about body axes."""
        return left_matrix(beta) if self.settings.rate_axes == 'body' else right_matrix(beta)

    def _correct(self, innovation: Array, covariance: Array, fitness: float) -> None:
        P = self.covariance
        K = np.linalg.solve(covariance, _H @ P).T
        self.state = self.state + K @ innovation
        self.state[:4] /= np.linalg.norm(self.state[:4])
        left = np.eye(7) - K @ _H
        P = left @ P @ left.T + fitness * K @ K.T  # Joseph: stays positive definite
        self.covariance = 0.5 * (P + P.T)


def process_noise(dt: float, fitness: float, sigma_u2: float) -> Array:
    """Q (7, 7) of eq. 2.65 with sigma_v² = d_k."""
    Q = np.zeros((7, 7))
    Q[:4, :4] = (fitness * dt + sigma_u2 * dt**3 / 3.0) * np.eye(4)
    Q[1:4, 4:] = Q[4:, 1:4] = 0.5 * sigma_u2 * dt**2 * np.eye(3)
    Q[4:, 4:] = sigma_u2 * dt * np.eye(3)
    return Q


def run(
    start_ns: int, observations: Iterable[RateObservation], settings: EkfSettings | None = None
) -> list[EkfStep]:
    """The filter over all observations, in order of time."""
    ekf = AttitudeEkf(start_ns, settings)
    return [ekf.step(observation) for observation in observations]
