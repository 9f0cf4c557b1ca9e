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

"""Where the target will be and how it will turn after the last frame, and how well that is known.

A target that is free of torque goes on as the rigid body that was fitted to it (:mod:`.dynamics`). Any other
goes on turning about the same axis, at a rate that falls exponentially if it fell before. Its centre of mass
goes on along its path (:mod:`.centre_of_mass`).

Standard deviations are those of the fitted numbers, carried forward. What drives a target is not known, so
the same forecast is made from earlier parts of the scan as well: by how much it missed what came then, beyond
its standard deviation, grows with time and is added.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
import scipy

from debris_scanner.core.geometry import Array, exp_so3, hat, transform
from debris_scanner.core.results import Forecast, StampedPose
from debris_scanner.core.rigid_body import DIFFERENCE
from debris_scanner.tracking.centre_of_mass import fit_centre, independent_share
from debris_scanner.tracking.dynamics import (
    FEWEST_POSES,
    FIRST_RATE,
    RATE,
    START,
    Dynamics,
    draw,
    fit_dynamics,
    late_rate,
    lately,
    move,
    small_logs,
)
from debris_scanner.tracking.sensor_path import SENSOR, SensorPath

AHEAD_S = 60
KEPT = 3000  # poses of a tracked target: five minutes at 10 Hz
SHARE = 0.02  # of the time that fits of a tracked target take
EARLIER = (1 / 2, 2 / 3, 5 / 6)  # shares of the scan, from which forecasts of the rest are made
WINDOWS = (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1)  # shares of the scan that a damped turn is fitted to
TURN_DAMPING = 6  # of the numbers of a damped turn

# of a forecast: square errors (n,), their expected covariances (n, 3, 3), and seconds (n,) ahead
_Misses = tuple[Array, Array, Array]
# attitudes (n, 3, 3) and rates (n, 3) of a motion's numbers, at some seconds after its start
Moved = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class _Turn:
    """A fitted rotation: numbers with their covariance, and what they mean."""

    move: Moved
    numbers: Array
    covariance: Array
    scatter: float = 0.0  # rad about each axis, of single attitudes about the fitted ones
    drift: float = 0.0  # rad/s about each axis, by which it errs besides

    def at(self, seconds: Array) -> tuple[Array, Array, Array, Array]:
        """Attitudes (n, 3, 3), rates (n, 3), and the covariances (n, 3, 3) of both, target frame."""
        R, omega = self.move(self.numbers, seconds)
        turns, changes = [], []
        for d in DIFFERENCE * np.eye(len(self.numbers)):
            moved, rate = self.move(self.numbers + d, seconds)
            turns.append(small_logs(np.einsum('nji,njk->nik', R, moved)) / DIFFERENCE)
            changes.append((rate - omega) / DIFFERENCE)
        of_R, of_omega = (
            np.einsum('anj,ab,bnk->njk', s, self.covariance, s) for s in (np.array(turns), np.array(changes))
        )
        besides = self.scatter**2 + (self.drift * seconds) ** 2
        return R, omega, of_R + _isotropic(besides), of_omega + self.drift**2 * np.eye(3)


@dataclass(frozen=True)
class Prediction:
    """How a target goes on after its last pose."""

    dynamics: Dynamics
    drift: float  # m/s along each axis, by which the centre leaves its path
    T_sensor_frame: Array  # (4, 4), from the poses' frame to the sensor, which stays where it was last
    _turn: _Turn

    def at(self, stamps_ns: Sequence[int]) -> Forecast:
        """Poses T_sensor_target and rates at stamps after the last pose."""
        begin_ns, centre = self.dynamics.stamp_ns, self.dynamics.centre
        seconds = np.array([(stamp - begin_ns) * 1e-9 for stamp in stamps_ns])
        R, omega, of_R, of_omega = self._turn.at(seconds)
        p, of_p = centre.target_at(begin_ns, seconds, R)
        lever = -R @ hat(centre.point)
        of_p = of_p + lever @ of_R @ lever.transpose(0, 2, 1) + _isotropic((self.drift * seconds) ** 2)
        poses = self.T_sensor_frame @ np.array([transform(*pose) for pose in zip(R, p, strict=True)])
        R_sensor_frame = self.T_sensor_frame[:3, :3]
        of_p = R_sensor_frame @ of_p @ R_sensor_frame.T
        return Forecast(list(stamps_ns), poses, omega, _sigmas(of_p), _sigmas(of_R), _sigmas(of_omega))

    def ahead(self, of_ns: int | None = None) -> Forecast:
        """Each of the next sixty seconds, after a stamp, or after the last pose."""
        begin_ns = self.dynamics.stamp_ns if of_ns is None else of_ns
        return self.at([begin_ns + second * 1_000_000_000 for second in range(1, AHEAD_S + 1)])


def predict(
    dynamics: Dynamics,
    poses: Sequence[StampedPose],
    noise_rad: float,
    extent: float,
    T_sensor_frame: Array | None = None,
) -> Prediction:
    """The motion of a target after its last pose.

    Args:
        dynamics: fitted to the poses.
        poses: T_sensor_target, in order of time.
        noise_rad: standard deviation of a single pose's rotation about each axis.
        extent: of the target, m.
        T_sensor_frame: (4, 4), from the poses' frame to the sensor at the last pose; None of the same.
    """
    poses = lately(poses)
    turn = _of_body(dynamics) if dynamics.explained else _driven(poses, noise_rad)
    drift = _drift_of_centre(poses, noise_rad, extent, dynamics.centre.mean_motion)
    return Prediction(dynamics, drift, np.eye(4) if T_sensor_frame is None else T_sensor_frame, turn)


class Forecaster:
    """The prediction of a target while it is tracked, fitted anew within a share of the time.

    Poses are added in one thread, and fitted in another.

    Args:
        sensor_path: how the sensor moves, where that is known.
        mean_motion: of the orbit, rad/s; 0 for a centre of mass that moves on a straight line.
    """

    def __init__(self, sensor_path: SensorPath | None = None, mean_motion: float = 0.0) -> None:
        self.prediction: Prediction | None = None
        self._sensor_path, self._mean_motion = sensor_path or SensorPath(), mean_motion
        self._frame = SENSOR  # of the prediction's dynamics
        self._poses: deque[StampedPose] = deque(maxlen=KEPT)
        self._sigmas: deque[float] = deque(maxlen=KEPT)  # rad, of the poses' rotation
        self._extent = 0.0
        self._models = 0  # that have come
        self._rested_until = 0.0  # time.monotonic()
        self._lock = Lock()

    def begin(self, poses: Sequence[StampedPose], extent: float) -> None:
        """A model is there: its key frames' poses T_sensor_target, in order of time, and its extent, m."""
        with self._lock:
            self.prediction, self._extent, self._rested_until = None, extent, 0.0
            self._models += 1
            self._sigmas.clear()
            self._poses.clear()
            self._poses.extend(poses)

    def add(self, pose: StampedPose, sigma_rad: float) -> None:
        """A tracked pose, and the standard deviation of its rotation about each axis."""
        with self._lock:
            if not self._poses or pose.stamp_ns > self._poses[-1].stamp_ns:
                self._poses.append(pose)
                self._sigmas.append(sigma_rad)

    def update(self) -> None:
        """Fit anew, unless fits have had their share of the time, or there is too little to fit."""
        with self._lock:
            poses, sigmas, extent = list(self._poses), list(self._sigmas), self._extent
            before, models = self.prediction, self._models
        began, used = time.monotonic(), time.thread_time()
        if began < self._rested_until or not sigmas:
            return
        placed = self._sensor_path.place(poses)
        noise = float(np.hypot(np.median(sigmas), placed.sigma_rad))
        known = None if before is None or placed.frame != self._frame else before.dynamics
        dynamics = fit_dynamics(placed.poses, noise, extent, known, self._mean_motion)
        prediction = None
        if dynamics is not None:
            prediction = predict(dynamics, placed.poses, noise, extent, placed.T_sensor_frame)
            self._frame = placed.frame
        with self._lock:
            self._rested_until = began + (time.thread_time() - used) / SHARE
            if self._models == models:
                self.prediction = prediction or before


def _isotropic(variances: Array) -> Array:
    """Covariances (n, 3, 3) of variances (n,)."""
    return np.asarray(variances[:, None, None] * np.eye(3))


def _sigmas(covariances: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum('nii->ni', covariances)))


def _of_body(dynamics: Dynamics) -> _Turn:
    """The fitted body goes on."""

    def moved(numbers: Array, seconds: Array) -> tuple[Array, Array]:
        return move(numbers, dynamics.R, seconds)

    return _Turn(moved, dynamics.numbers, dynamics.covariance)


def _driven(poses: Sequence[StampedPose], noise_rad: float) -> _Turn:
    """A damped turn about one axis, fitted to as much of the scan as would have forecast the rest best."""
    turns, drifts, scores = _damped(poses, noise_rad), list[float](), list[float]()
    earlier = [(_damped(before, noise_rad), later, seconds) for before, later, seconds in _earlier(poses)]
    for k in range(len(WINDOWS)):
        misses = []
        for guesses, later, seconds in earlier:
            R, _, covariance, _ = guesses[k].at(seconds)
            true = np.array([pose.T_sensor_target[:3, :3] for pose in later])
            between = scipy.spatial.transform.Rotation.from_matrix(np.einsum('nji,njk->nik', R, true))
            angles = between.magnitude()
            misses.append((angles**2, covariance, seconds))
        drifts.append(_drift(misses))
        scores.append(_log_likelihood(misses, drifts[-1]))
    best = int(np.argmax(scores))
    return replace(turns[best], drift=drifts[best])


def _damped(poses: Sequence[StampedPose], noise_rad: float) -> list[_Turn]:
    """Fits of a damped turn to the latest part of a scan, a longer one each time."""
    noise = max(noise_rad, 1e-5)
    numbers = np.concatenate([np.zeros(3), late_rate(poses[-FIRST_RATE:]), [0.0]])
    last = poses[-1].T_sensor_target[:3, :3]
    turns = []

    def move(numbers: Array, seconds: Array) -> tuple[Array, Array]:
        damping = max(float(numbers[TURN_DAMPING]), 1e-9)
        turned = -np.expm1(-damping * seconds) / damping
        each = scipy.spatial.transform.Rotation.from_rotvec(np.outer(turned, numbers[RATE])).as_matrix()
        return last @ exp_so3(numbers[START]) @ each, np.outer(np.exp(-damping * seconds), numbers[RATE])

    for window in WINDOWS:
        t, R = draw(poses[-max(FEWEST_POSES, round(window * len(poses))) :], evenly=True)

        def residuals(numbers: Array, t: Array = t, R: Array = R) -> Array:
            found, _ = move(numbers, t)
            logs = small_logs(np.einsum('nji,njk->nik', found, R))
            # the rate falls by no more than some factor of e in what is looked at
            return np.append(logs.ravel() / noise, numbers[TURN_DAMPING] * t[-1])

        highest = np.append(np.full(6, np.inf), 3.0 / -t[-1])
        lowest = np.append(-highest[:6], -1e-9)
        start = np.clip(numbers, lowest, 0.99 * highest)
        solution = scipy.optimize.least_squares(
            residuals, start, bounds=(lowest, highest), x_scale='jac', loss='soft_l1', max_nfev=60
        )
        numbers = solution.x
        here = residuals(numbers)
        slopes = np.array([residuals(numbers + d) - here for d in DIFFERENCE * np.eye(7)]) / DIFFERENCE
        apart = here[:-1].reshape(-1, 3)
        square = max(float(np.mean(apart**2)), 1e-12)
        information = independent_share(apart) / square * slopes[:, :-1] @ slopes[:, :-1].T
        information += np.outer(slopes[:, -1], slopes[:, -1])
        covariance = np.asarray(np.linalg.pinv(information, hermitian=True))
        turns.append(_Turn(move, numbers, covariance, noise * float(np.sqrt(square))))
    return turns


def _drift_of_centre(
    poses: Sequence[StampedPose], noise_rad: float, extent: float, mean_motion: float
) -> float:
    """Speed, m/s along each axis, by which the centre has left its path before."""
    misses = []
    for before, later, seconds in _earlier(poses):
        centre = fit_centre(before, noise_rad, extent, mean_motion)
        true = np.array([pose.T_sensor_target for pose in later])
        p, covariance = centre.target_at(before[-1].stamp_ns, seconds, true[:, :3, :3])
        apart = ((true[:, :3, 3] - p) ** 2).sum(axis=1)
        misses.append((apart, covariance, seconds))
    return _drift(misses)


def _earlier(
    poses: Sequence[StampedPose],
) -> Iterator[tuple[Sequence[StampedPose], Sequence[StampedPose], Array]]:
    """Earlier parts of a scan, what followed, and how many seconds later."""
    for share in EARLIER:
        cut = round(share * len(poses))
        before, later = poses[:cut], poses[cut::5]
        if cut >= FEWEST_POSES and later:
            yield before, later, np.array([(p.stamp_ns - before[-1].stamp_ns) * 1e-9 for p in later])


def _drift(misses: Sequence[_Misses]) -> float:
    """Error about or along each axis for each second ahead, beyond what was expected."""
    beyond = sum(np.sum(squares - np.einsum('nii->n', covariance)) for squares, covariance, _ in misses)
    return float(np.sqrt(max(beyond, 0.0) / max(sum(np.sum(3 * s**2) for *_, s in misses), 1e-9)))


def _log_likelihood(misses: Sequence[_Misses], drift: float) -> float:
    """Of the errors, nats."""
    total = 0.0
    for squares, covariance, seconds in misses:
        variance = np.einsum('nii->n', covariance) / 3 + (drift * seconds) ** 2
        total -= float(np.sum(1.5 * np.log(variance) + squares / (2 * variance)))
    return total
