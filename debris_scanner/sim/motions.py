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

"""Seeded motions of a target in front of the sensor: T_sensor_target as a function of time.

The sensor frame is optical: x right, y down, z forward. Thesis parts T24-T26 and T28.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from debris_scanner.core.geometry import Array, compose, exp_so3, transform
from debris_scanner.core.parameters import did_you_mean
from debris_scanner.sim.gaps import Gaps
from debris_scanner.sim.tumble import TorqueFreeBody

SPIN, DECAYING_SPIN, SWING = 'spin', 'decaying_spin', 'swing'
CLOHESSY_WILTSHIRE, TUMBLE, STILL = 'clohessy_wiltshire', 'tumble', 'still'
STEPS, STOPS, BY_HAND, DZHANIBEKOV = 'steps', 'stops', 'by_hand', 'dzhanibekov'
TUMBLES = (TUMBLE, DZHANIBEKOV)
MOTION_NAMES = (SPIN, DECAYING_SPIN, SWING, CLOHESSY_WILTSHIRE, *TUMBLES, STILL, STEPS, STOPS, BY_HAND)
AHEAD_S = 60.0  # after its end that a motion is known, to judge forecasts by

_TILT_DEG = (15.0, 25.0)  # of a spin axis that was not given, off the image's vertical
_OFFSET_M = 0.012  # how far off the optical axis the target may stand, each way
_DECAY_TURNS = 1.15  # a little more than one turn until friction has stopped the spin
_STEP_RAD = float(
    np.radians(20.0)
)  # of a turntable that turns by steps, and stands still as long as it turns
_STOP_S, _STOP_RAD = 10.0, 2 * np.pi / 3  # of one that stops for long, three times a turn
_HAND_RAD, _HAND_RESTS_S = float(np.radians(30.0)), 2.0  # a hand turns it so far, and leaves it alone
_HAND_MOVES_S = 0.5  # of which it takes to leave, and to come again
_PENDULUM_RAD_S = float(np.sqrt(9.81 / 1.2))  # an observer hung on cables 1.2 m long
_PENDULUM_M = (0.05, 0.012, 0.035)  # amplitudes along x, y and z
_PENDULUM_RAD = 0.025  # how far the observer nods
_PENDULUM_DAMPING_S = 60.0
_ORBIT_RAD_S = 2 * np.pi / 40.0  # the mean motion, scaled from an orbit to the bench
_ORBIT_M = (0.035, 0.025)  # radial and orbit-normal amplitudes; in-track is twice the radial one
_ORBIT_DRIFT_M_S = 0.0008  # secular in-track term
INERTIA = (1.0, 0.8, 0.5)  # about the target's x, y, z: only ratios matter without torque
_OFF_MIDDLE = (0.01, 0.05)  # of the rate: how far Dzhanibekov's spin is off the intermediate axis
_TUMBLE_DRIFT_M_S = 0.0005


# Rotations that bring an axis of the target on to its z axis.
_TO_Z = {'x': np.eye(3)[[1, 2, 0]], 'y': np.eye(3)[[2, 0, 1]], 'z': np.eye(3)}


class Motion(Protocol):
    """A motion: pose of the target, pose of the static world, and visible share of the target."""

    def T_sensor_target(self, t_s: float) -> Array:
        """Pose (4, 4) of the target in the sensor frame, t_s seconds after the start."""

    def T_sensor_world(self, t_s: float) -> Array:
        """Pose (4, 4) of the still surroundings; identity at rest."""

    def visibility(self, t_s: float) -> float:
        """Visible share of the target's silhouette: 1 unless there are gaps."""

    def hand_away(self, t_s: float) -> float:
        """How far the hand that turns the target is away: 0 where it touches it, 1 out of sight."""


@dataclass(frozen=True)
class MotionSettings:
    """Settings of a motion; every random choice follows from the seed."""

    name: str = SPIN
    rate_rad_s: float = 0.5  # negative turns the other way
    axis_sensor: tuple[float, float, float] | None = None  # None: tilted off the vertical by the seed
    range_m: float = 0.8
    seed: int = 0
    duration_s: float = 25.0  # gaps are drawn over this time
    gaps: bool = False
    gaps_from_s: float = 0.0  # no gap begins before
    patchy: bool = False  # now and then partially occluded
    leaves_s: float | None = None  # out of sight for good from then on
    scale: float = 1.0  # of all shifts, which suit a target at 0.8 m
    spin_about: str = 'z'  # which of the target's axes spins
    inertia: tuple[float, float, float] = INERTIA
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, target frame; the target turns about it
    damping_s: float | None = None  # in which friction takes the rate to 1/e of it
    from_above: bool = False  # an axis drawn by the seed leans so that a desk below is seen from above


@dataclass(frozen=True)
class _Composed:
    """A motion composed of the target's attitude and the observer's path."""

    centre: Array  # (3,) of the target in the world, which is the sensor frame at rest
    attitude: Callable[[float], Array]  # (3, 3) target in the world
    observer: Callable[[float], Array]  # (4, 4) T_sensor_world
    gaps: Gaps
    turning_s: float | None = None  # of the hand that turns the target; None without one
    about: tuple[float, float, float] = (0.0, 0.0, 0.0)  # target frame: the point at the centre
    damping_s: float | None = None

    def T_sensor_target(self, t_s: float) -> Array:
        # friction in proportion to the angular momentum is a clock that slows down
        damped = self.damping_s
        R = self.attitude(t_s if damped is None else -damped * float(np.expm1(-t_s / damped)))
        return compose(self.observer(t_s), transform(R, self.centre - R @ self.about))

    def T_sensor_world(self, t_s: float) -> Array:
        return self.observer(t_s)

    def visibility(self, t_s: float) -> float:
        return self.gaps.visibility(t_s)

    def hand_away(self, t_s: float) -> float:
        if self.turning_s is None:
            return 1.0
        rested = t_s % (_HAND_RESTS_S + self.turning_s)
        if rested >= _HAND_RESTS_S:
            return 0.0
        left, comes = rested if t_s >= _HAND_RESTS_S else np.inf, _HAND_RESTS_S - rested
        return float(min(1.0, left / _HAND_MOVES_S, comes / _HAND_MOVES_S))


def make_motion(settings: MotionSettings) -> Motion:
    """The motion of these settings.

    Spins turn the target about its own z axis, or the one given; in a tumble the axis gives the first
    attitude alone.

    Raises:
        ValueError: unknown name, a zero axis, or an axis along the line of sight, about which a depth
            camera never sees the far side; moments that no body has; damping that is not positive.
    """
    if settings.name not in MOTION_NAMES:
        raise ValueError(
            f'unknown motion {settings.name!r}: choose one of {", ".join(MOTION_NAMES)}'
            f'{did_you_mean(settings.name, MOTION_NAMES)}'
        )
    if settings.spin_about not in _TO_Z:
        raise ValueError(f'a target spins about its x, y or z axis, not {settings.spin_about!r}')
    if settings.damping_s is not None and not 0 < settings.damping_s < np.inf:
        raise ValueError(f'the time of damping must be positive, not {settings.damping_s!r} s')
    if not np.isfinite(settings.centre_of_mass).all():
        raise ValueError(f'the centre of mass {settings.centre_of_mass} is no point')
    rng = np.random.default_rng([settings.seed, 1])
    axis = _axis(settings, rng)
    start = _attitude_about(axis, float(rng.uniform(0, 2 * np.pi))) @ _TO_Z[settings.spin_about]
    offset = settings.scale * rng.uniform(-_OFFSET_M, _OFFSET_M, 2)
    centre = np.array([*offset, settings.range_m])
    attitude = _attitude(settings, axis, start, rng)
    turning = _HAND_RAD / max(abs(settings.rate_rad_s), 1e-9) if settings.name == BY_HAND else None
    return _Composed(
        centre,
        attitude,
        _observer(settings, rng),
        _gaps(settings),
        turning,
        settings.centre_of_mass,
        settings.damping_s,
    )


def _gaps(settings: MotionSettings) -> Gaps:
    gaps = Gaps(())
    if settings.gaps:
        gaps = Gaps.draw(settings.duration_s, settings.seed, settings.gaps_from_s)
    if settings.patchy:
        gaps = gaps.shaded(settings.duration_s, settings.seed)
    return gaps if settings.leaves_s is None else gaps.leaving(settings.leaves_s)


def _axis(settings: MotionSettings, rng: np.random.Generator) -> Array:
    """Unit spin axis in the sensor frame."""
    tilt, azimuth = np.radians(rng.uniform(*_TILT_DEG)), rng.uniform(0, 2 * np.pi)
    if settings.axis_sensor is None:
        up = np.array([0.0, -1.0, 0.0])
        axis = exp_so3(tilt * np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])) @ up
        return axis * [1.0, 1.0, -1.0] if settings.from_above and axis[2] > 0 else axis
    axis = np.asarray(settings.axis_sensor, np.float64)
    length = float(np.linalg.norm(axis))
    if not 0 < length < np.inf:
        raise ValueError(f'the axis {settings.axis_sensor} has no direction')
    axis = axis / length
    if abs(axis[2]) > np.cos(np.radians(10.0)) and settings.name not in TUMBLES:
        raise ValueError(f'the axis {settings.axis_sensor} lies within 10 degrees of the line of sight')
    return axis


def _attitude_about(axis: Array, phase: float) -> Array:
    """Rotation (3, 3) that brings the target's z axis onto axis, turned by phase about it."""
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return exp_so3(phase * axis) @ np.column_stack([side, np.cross(axis, side), axis])


def _attitude(
    settings: MotionSettings, axis: Array, start: Array, rng: np.random.Generator
) -> Callable[[float], Array]:
    rate = settings.rate_rad_s
    if settings.name == STILL:
        return lambda t: start
    if settings.name in TUMBLES:
        return _tumbling(settings, start, rng)
    if settings.name == DECAYING_SPIN:
        # rate that falls evenly to zero: the turn is rate * stop / 2
        stop = 2 * _DECAY_TURNS * 2 * np.pi / max(abs(rate), 1e-9)
        return lambda t: exp_so3(axis * rate * (min(t, stop) - 0.5 * min(t, stop) ** 2 / stop)) @ start
    if settings.name in (STEPS, STOPS):
        angle, still = (_STEP_RAD, None) if settings.name == STEPS else (_STOP_RAD, _STOP_S)
        return lambda t: exp_so3(axis * np.sign(rate) * _turned(t, abs(rate), angle, still)) @ start
    if settings.name == BY_HAND:
        rests = _HAND_RESTS_S
        return lambda t: (
            exp_so3(axis * np.sign(rate) * _turned(max(t - rests, 0.0), abs(rate), _HAND_RAD, rests)) @ start
        )
    return lambda t: exp_so3(axis * rate * t) @ start


def _turned(t: float, rate: float, angle: float, still_s: float | None) -> float:
    """Angle after t seconds of a turntable that turns by ``angle`` and then stands still, again and again."""
    turning = angle / max(rate, 1e-9)
    done, since = divmod(t, turning + (turning if still_s is None else still_s))
    return angle * (done + min(since / turning, 1.0))


def _tumbling(settings: MotionSettings, start: Array, rng: np.random.Generator) -> Callable[[float], Array]:
    # mostly about the intermediate axis, whose rotation is unstable: the body turns over again and again
    direction = rng.choice([-1.0, 1.0], 3) * rng.uniform((0.15, 0.8, 0.15), (0.4, 1.0, 0.4))
    inertia = np.asarray(settings.inertia, np.float64)
    if settings.name == DZHANIBEKOV:
        # so nearly about it that the body seems to spin, and then turns over at once
        middle = int(np.argsort(inertia)[1])
        direction = np.sign(direction) * rng.uniform(*_OFF_MIDDLE, 3)
        direction[middle] = np.sign(direction[middle])
    omega = settings.rate_rad_s * direction / np.linalg.norm(direction)
    body = TorqueFreeBody(inertia, start, omega, settings.duration_s + AHEAD_S)
    return body.attitude


def _observer(settings: MotionSettings, rng: np.random.Generator) -> Callable[[float], Array]:
    if settings.name == SWING:
        return _pendulum(rng, settings.scale)
    if settings.name == CLOHESSY_WILTSHIRE:
        return _clohessy_wiltshire(rng, settings.scale)
    if settings.name in TUMBLES:
        drift = settings.scale * rng.uniform(-_TUMBLE_DRIFT_M_S, _TUMBLE_DRIFT_M_S, 3)
        return lambda t: transform(np.eye(3), drift * t)
    return lambda t: np.eye(4)


def _pendulum(rng: np.random.Generator, scale: float) -> Callable[[float], Array]:
    """T_sensor_world of an observer swinging on cables: a closed, slowly shrinking helix (thesis 4.4)."""
    phase = rng.uniform(0, 2 * np.pi, 3)

    def observer(t: float) -> Array:
        swing = np.exp(-t / _PENDULUM_DAMPING_S) * np.sin(_PENDULUM_RAD_S * t + phase)
        # the cables keep the sensor nearly level; the height changes at twice the pendulum's rate
        height = np.exp(-t / _PENDULUM_DAMPING_S) * np.sin(2 * _PENDULUM_RAD_S * t + phase[1])
        offset = np.array([_PENDULUM_M[0] * swing[0], _PENDULUM_M[1] * height, _PENDULUM_M[2] * swing[2]])
        nod = _PENDULUM_RAD * np.array([swing[2], 0.0, swing[0]])
        return transform(exp_so3(nod), scale * offset)

    return observer


def clohessy_wiltshire(t: float, position: Array, velocity: Array, mean_motion: float) -> Array:
    """Relative position (3,) radial, in-track, orbit-normal after t seconds (thesis eq. 2.34-2.36)."""
    n = mean_motion
    (x, y, z), (vx, vy, vz) = position, velocity
    s, c = np.sin(n * t), np.cos(n * t)
    return np.array(
        [
            vx / n * s - (3 * x + 2 * vy / n) * c + (4 * x + 2 * vy / n),
            (6 * x + 4 * vy / n) * s + 2 * vx / n * c - (6 * n * x + 3 * vy) * t + y - 2 * vx / n,
            z * c + vz / n * s,
        ]
    )


def _clohessy_wiltshire(rng: np.random.Generator, scale: float) -> Callable[[float], Array]:
    """T_sensor_world of an observer on a relative orbit, pointing the same way throughout."""
    n = _ORBIT_RAD_S
    radial = rng.choice([-1.0, 1.0]) * _ORBIT_M[0]
    drift = rng.uniform(-_ORBIT_DRIFT_M_S, _ORBIT_DRIFT_M_S)
    position = np.array([radial, 0.0, rng.uniform(-1, 1) * _ORBIT_M[1]])
    velocity = np.array([0.0, -2 * n * radial - drift / 3, n * _ORBIT_M[1] * rng.uniform(-1, 1)])

    def observer(t: float) -> Array:
        x, y, z = clohessy_wiltshire(t, position, velocity, n)
        # radial along the line of sight, in-track across the image, orbit normal down it
        return transform(np.eye(3), scale * np.array([y, z, x]))

    return observer
