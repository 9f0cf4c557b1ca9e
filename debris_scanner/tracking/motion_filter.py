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

"""Error-state filter of the target's motion: attitude, centre, rates, accelerations, rotation centre.

The target turns about a point fixed in it while that point drifts past the sensor. Angular and
linear acceleration decay exponentially (Singer 1970), which covers free spin, friction, tumbling and
a swinging observer with one set of numbers. The measurement is the registration itself: its normal
equations enter the iterated update directly (Bell and Cathey 1993), so directions that the surface
does not constrain are left to the motion model.

A target whose inertia J is known accelerates by itself, by Euler's equation J w' = -w x J w; the decaying
acceleration is what comes on top.
"""

from dataclasses import dataclass

import numpy as np

from debris_scanner.core.geometry import (
    Array,
    exp_so3,
    exponential,
    hat,
    inverse,
    log_so3,
    logarithm,
    nearest_rotation,
    project_so3,
    transform,
)
from debris_scanner.core.optional import kernel
from debris_scanner.core.parameters import parameter
from debris_scanner.core.rigid_body import LARGEST_STEP, propagated

ATTITUDE, CENTRE, OMEGA, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
ANGULAR_ACC, LINEAR_ACC, PIVOT = slice(12, 15), slice(15, 18), slice(18, 21)
SIZE = 21
MAX_SUBSTEP = 0.1  # s
MARGIN = 2.0  # expected accelerations over observed ones
FIRST_LINEAR_ACC = 200.0  # px/s², 1 sigma, before any frame
ATTITUDE_UNKNOWN = 3 * np.pi**2  # rad², variance about all axes: every attitude is as likely as any other
CENTRE_NOISE = 0.021  # px, 1 sigma a step: of centre and rotation centre


@dataclass(frozen=True)
class MotionSettings:
    """Prior and process noise of targets on a bench or in orbit; lengths in pixel footprints."""

    rate_sigma: float = parameter(0.7, 'prior standard deviation of each angular rate', 'rad/s', 1e-3, 10.0)
    speed_sigma: float = parameter(100.0, 'prior standard deviation of each velocity', 'px/s', 1.0, 1e5)
    centre_sigma: float = parameter(33.0, 'prior standard deviation of the rotation centre', 'px', 0.1, 1e4)
    angular_acc_sigma: float = parameter(0.25, 'largest angular acceleration, 1 sigma', 'rad/s²', 1e-4, 10.0)
    least_angular_acc_sigma: float = parameter(
        0.01, 'least angular acceleration, of an even turn', 'rad/s²', 1e-4, 10.0
    )
    angular_acc_tau: float = parameter(
        3.0,
        'correlation time of the angular acceleration',
        's',
        0.01,
        100.0,
    )
    linear_acc_sigma: float = parameter(400.0, 'largest linear acceleration, 1 sigma', 'px/s²', 1.0, 1e5)
    least_linear_acc_sigma: float = parameter(
        3.3, 'least linear acceleration, of an even drift', 'px/s²', 0.01, 1e5
    )
    linear_acc_tau: float = parameter(0.6, 'correlation time of the linear acceleration', 's', 0.01, 100.0)
    information_scale: float = parameter(
        0.13, 'information of a point with noise of the resolution: noise is correlated', '', 1e-4, 10.0
    )
    mean_motion: float = parameter(
        0.0,
        'of an orbit, for centre of mass and forecast; 0: a straight line',
        'rad/s',
        0.0,
        10.0,
    )


class MotionFilter:
    """State of the target seen by the sensor; ``P`` is the covariance of the (21,) error state.

    The error state is ordered attitude (left, sensor frame), centre, angular rate, velocity, angular
    and linear acceleration (all sensor frame), pivot (rotation centre in the target frame).

    Args:
        centre: (3,) m, sensor frame.
        settings: prior and noise.
        footprint: m, of a pixel at the target: the unit of the settings' lengths.
    """

    def __init__(self, centre: Array, settings: MotionSettings, footprint: float) -> None:
        s = settings
        self.settings = s
        self.footprint = footprint
        self.R = np.eye(3)  # R_sensor_target
        self.centre = centre.copy()
        self.pivot = np.zeros(3)
        self.omega = np.zeros(3)
        self.velocity = np.zeros(3)
        self.angular_acc = np.zeros(3)
        self.linear_acc = np.zeros(3)
        self.angular_acc_sigma = s.angular_acc_sigma  # adapted to what is observed
        self.linear_acc_sigma = s.linear_acc_sigma * footprint
        centre_sigma, speed_sigma = s.centre_sigma * footprint, s.speed_sigma * footprint
        acc = FIRST_LINEAR_ACC * footprint
        sigma = np.repeat([1e-4, centre_sigma, s.rate_sigma, speed_sigma, 0.1, acc, centre_sigma], 3)
        self.P = np.diag(sigma**2)
        # The origin of the target frame is the initial centre, so it is known although the centre is not.
        self.P[CENTRE, PIVOT] = self.P[PIVOT, CENTRE] = np.eye(3) * centre_sigma**2 * (1 - 1e-5)
        self.inertia = np.eye(3)  # target frame, any scale; of a sphere while it is not known

    def released(self) -> 'MotionFilter':
        """The same pose, but of the rates is known no more than in the beginning: a hand or a motor acts.

        What has turned or moved faster than was expected then may stop, or do so again.
        """
        fresh = MotionFilter(self.centre, self.settings, self.footprint)
        other = self.copy()
        for rate, part in ((self.omega, OMEGA), (self.velocity, VELOCITY)):
            fresh.P[part, part] = np.maximum(fresh.P[part, part], np.eye(3) * (rate @ rate))
        moving = slice(OMEGA.start, LINEAR_ACC.stop)
        other.P[moving, :], other.P[:, moving] = 0.0, 0.0
        other.P[moving, moving] = fresh.P[moving, moving]
        other.angular_acc, other.linear_acc = np.zeros(3), np.zeros(3)
        other.angular_acc_sigma, other.linear_acc_sigma = fresh.angular_acc_sigma, fresh.linear_acc_sigma
        return other

    def copy(self) -> 'MotionFilter':
        """Independent copy, to try a hypothesis on."""
        other = object.__new__(MotionFilter)
        other.__dict__ = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in self.__dict__.items()}
        return other

    @property
    def is_finite(self) -> bool:
        """Whether mean and covariance are numbers, so that the pose is one."""
        mean = (self.R, self.centre, self.pivot, self.omega, self.velocity, self.angular_acc, self.linear_acc)
        return all(np.isfinite(values).all() for values in (*mean, self.P))

    @property
    def T_sensor_target(self) -> Array:
        """Pose (4, 4)."""
        return transform(self.R, self.centre - self.R @ self.pivot)

    @property
    def omega_target(self) -> Array:
        """Angular rate (3,), rad/s, in the target frame."""
        return self.R.T @ self.omega

    @property
    def omega_sigma(self) -> Array:
        """Standard deviation (3,) of ``omega_target``, rad/s."""
        return np.sqrt(np.maximum(np.diag(self.R.T @ self.P[OMEGA, OMEGA] @ self.R), 0.0))

    @property
    def pose_covariance(self) -> Array:
        """Covariance (6, 6) of T_sensor_target: rotation (left), translation, sensor frame."""
        G = self.pose_jacobian()
        return G @ self.P @ G.T

    def predict(self, dt: float) -> None:
        """Propagate by dt seconds, or until nothing is known of the attitude: more time tells no more.

        The process noise brings it there within a minute or so, however long a gap is or a clock says it is.
        """
        steps = max(1, int(np.ceil(dt / MAX_SUBSTEP)))
        for _ in range(steps):
            if np.trace(self.P[ATTITUDE, ATTITUDE]) > ATTITUDE_UNKNOWN:
                return
            self._predict_step(dt / steps)

    def predicted(self, dt: float) -> 'MotionFilter':
        """A copy that is propagated by dt seconds."""
        other = self.copy()
        other.predict(dt)
        return other

    def _predict_step(self, h: float) -> None:
        s = self.settings
        drift = (CENTRE_NOISE * self.footprint) ** 2
        noise = np.array([self.angular_acc_sigma, self.linear_acc_sigma, drift])
        decays = np.exp(-h / np.array([s.angular_acc_tau, s.linear_acc_tau]))
        self.R, mean, self.P = _predicted(self.R, self.mean, self.P, self.inertia, h, decays, noise)
        self.set_mean(mean)

    @property
    def mean(self) -> Array:
        """All but the attitude (18,), in the order of the error state."""
        return np.concatenate(
            (self.centre, self.omega, self.velocity, self.angular_acc, self.linear_acc, self.pivot)
        )

    def set_mean(self, mean: Array) -> None:
        """Set ``mean``."""
        self.centre, self.omega, self.velocity, self.angular_acc, self.linear_acc, self.pivot = mean.reshape(
            6, 3
        )

    def _free_acceleration(self, inertia: Array) -> Array:
        """Angular acceleration (3,) without torque, sensor frame."""
        J = self.R @ inertia @ self.R.T
        return np.asarray(np.linalg.solve(J, np.cross(J @ self.omega, self.omega)), np.float64)

    def know_inertia(self, inertia: Array) -> None:
        """From now on the target has this inertia (3, 3), target frame, any scale; that of a sphere: unknown.

        What it accelerates by itself is no part of the acceleration that decays.
        """
        self.angular_acc = self.angular_acc + self._free_acceleration(self.inertia)
        self.inertia = inertia
        self.angular_acc = self.angular_acc - self._free_acceleration(inertia)

    def pose_jacobian(self) -> Array:
        """d(rotation, translation of T_sensor_target) / d(error state), (6, 21)."""
        G = np.zeros((6, SIZE))
        G[:3, ATTITUDE] = np.eye(3)
        G[3:, CENTRE] = np.eye(3)
        G[3:, ATTITUDE] = hat(self.R @ self.pivot)
        G[3:, PIVOT] = -self.R
        return G

    def correct(self, step: Array) -> None:
        """Add an error state (21,) to the mean."""
        self.R = project_so3(exp_so3(step[ATTITUDE]) @ self.R)
        self.centre = self.centre + step[CENTRE]
        self.omega = self.omega + step[OMEGA]
        self.velocity = self.velocity + step[VELOCITY]
        self.angular_acc = self.angular_acc + step[ANGULAR_ACC]
        self.linear_acc = self.linear_acc + step[LINEAR_ACC]
        self.pivot = self.pivot + step[PIVOT]

    def difference(self, other: 'MotionFilter') -> Array:
        """Error state (21,) that leads from ``other`` to this."""
        return np.concatenate(
            [
                log_so3(self.R @ other.R.T),
                self.centre - other.centre,
                self.omega - other.omega,
                self.velocity - other.velocity,
                self.angular_acc - other.angular_acc,
                self.linear_acc - other.linear_acc,
                self.pivot - other.pivot,
            ]
        )

    def update_step(self, prior: 'MotionFilter', prior_information: Array, H: Array, g: Array) -> Array:
        """One Gauss-Newton step of the iterated update.

        Args:
            prior: the predicted filter.
            prior_information: inverse of its covariance, (21, 21).
            H: registration's normal matrix (6, 6) for a twist of T_target_sensor in the target frame, of
                residuals in multiples of the resolution.
            g: its gradient (6,).

        Returns:
            The step (21,), already applied to the mean. Sets ``P`` to the posterior covariance.
        """
        self.R, mean, self.P, step = updated(
            self.R, self.mean, prior.R, prior.mean, prior_information, H, g, self.settings.information_scale
        )
        self.set_mean(mean)
        return step

    def adapt(self, dt: float) -> None:
        """Adapt the process noise to the accelerations of the last dt seconds, after an update.

        A target that moves evenly is then predicted more precisely across a gap, and its rotation centre
        becomes observable: while any acceleration is possible, the target may turn about any point.
        """
        s = self.settings
        share = min(1.0, dt / s.angular_acc_tau)

        def adapted(sigma: float, observed: Array, least: float, most: float) -> float:
            now = float(np.clip(MARGIN * np.sqrt(observed @ observed / 3), least, most))
            # variance grows at once; sigma shrinks by ratios, as the prior is wide by orders of magnitude
            grown = np.sqrt((1 - share) * sigma**2 + share * now**2)
            return float(grown if now > sigma else sigma * (now / sigma) ** share)

        self.angular_acc_sigma = adapted(
            self.angular_acc_sigma, self.angular_acc, s.least_angular_acc_sigma, s.angular_acc_sigma
        )
        self.linear_acc_sigma = adapted(
            self.linear_acc_sigma,
            self.linear_acc,
            s.least_linear_acc_sigma * self.footprint,
            s.linear_acc_sigma * self.footprint,
        )

    def change_target_frame(self, T_new_old: Array) -> None:
        """Express the state in another target frame, such as after a loop closure moved the key frames."""
        T = self.T_sensor_target @ inverse(T_new_old)
        self.R = project_so3(T[:3, :3])
        self.pivot = self.R.T @ (self.centre - T[:3, 3])
        self.inertia = T_new_old[:3, :3] @ self.inertia @ T_new_old[:3, :3].T


@kernel()
def _predicted(
    R: Array, mean: Array, P: Array, inertia: Array, h: float, decays: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Attitude (3, 3), mean (18,) and covariance (21, 21) after h seconds.

    ``noise``: the sigmas of angular and linear acceleration, and the variance of the drift.
    """
    omega, velocity, alpha, beta = mean[3:6], mean[6:9], mean[9:12], mean[12:15]
    J = R @ inertia @ R.T
    J_inverse = np.linalg.inv(J)
    momentum = J @ omega
    acceleration = J_inverse @ np.cross(momentum, omega)
    by_omega = J_inverse @ (_hat(momentum) - _hat(omega) @ J)
    by_attitude = by_omega @ _hat(omega) - _hat(acceleration)
    rate = float((omega @ omega) ** 0.5)
    inertia_inverse = np.ascontiguousarray(np.linalg.inv(inertia))
    attitudes, rates = propagated(
        R, R.T @ omega, inertia, inertia_inverse, np.array([h]), LARGEST_STEP / max(rate, 1e-3)
    )
    freely = attitudes[0]
    turn = exponential(0.5 * alpha * h * h) @ freely @ R.T
    F = np.eye(SIZE)
    F[0:3, 0:3] = turn
    for i in range(3):
        for j in range(3):
            F[6 + i, j] = by_attitude[i, j] * h
            F[6 + i, 6 + j] += by_omega[i, j] * h
        F[i, 6 + i], F[i, 12 + i] = h, h * h / 2
        F[6 + i, 12 + i], F[12 + i, 12 + i] = h, decays[0]
        F[3 + i, 9 + i], F[3 + i, 15 + i] = h, h * h / 2
        F[9 + i, 15 + i], F[15 + i, 15 + i] = h, decays[1]
    after = mean.copy()
    after[0:3] += velocity * h + 0.5 * beta * h * h
    after[3:6] = freely @ rates[0] + alpha * h
    after[6:9] += beta * h
    after[9:12] *= decays[0]
    after[12:15] *= decays[1]
    Q = F @ P @ F.T
    for i in range(3):
        Q[i, i] += 1e-8
        Q[3 + i, 3 + i] += noise[2]
        Q[6 + i, 6 + i] += 1e-4 * h
        Q[12 + i, 12 + i] += noise[0] ** 2 * (1 - decays[0] ** 2)
        Q[15 + i, 15 + i] += noise[1] ** 2 * (1 - decays[1] ** 2)
        Q[18 + i, 18 + i] += noise[2]
    return _rotation(turn @ R), after, Q


@kernel()
def updated(
    R: Array, mean: Array, prior_R: Array, prior_mean: Array, information: Array, H: Array, g: Array,
    scale: float,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Attitude, mean, covariance and step (21,) of :meth:`MotionFilter.update_step`."""
    lever = _hat(R @ mean[15:18])
    J = np.zeros((6, SIZE))  # twist of T_target_sensor per error state
    across = np.ascontiguousarray(-R.T)
    J[:3, 0:3], J[3:, 3:6] = across, across
    J[3:, 0:3] = across @ lever
    for i in range(3):
        J[3 + i, 18 + i] = 1.0
    off = np.empty(SIZE)
    off[:3], off[3:] = logarithm(R @ prior_R.T), mean - prior_mean
    JT = np.ascontiguousarray(J.T)
    A = information + JT @ (H * scale) @ J
    P = np.linalg.inv(A)
    P = 0.5 * (P + P.T)
    step = -(P @ (JT @ g * scale + information @ off))
    return _rotation(exponential(step[:3]) @ R), mean + step[3:], P, step


@kernel()
def _hat(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@kernel()
def _rotation(M: Array) -> Array:
    """The rotation nearest to M (3, 3), which is next to one; NaN of what is none."""
    R, found = nearest_rotation(np.ascontiguousarray(M))
    return R if found else np.full((3, 3), np.nan)
