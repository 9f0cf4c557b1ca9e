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

from itertools import pairwise

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, log_so3, rotation_angle
from debris_scanner.sim.motions import MOTION_NAMES, MotionSettings, clohessy_wiltshire, make_motion
from debris_scanner.sim.targets import make_target

DURATION = {'tumble': 60.0}


def motion(name, **options):
    return make_motion(MotionSettings(name, duration_s=DURATION.get(name, 25.0), **options))


def world_attitude(moving, t):
    return moving.T_sensor_world(t)[:3, :3].T @ moving.T_sensor_target(t)[:3, :3]


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('name', MOTION_NAMES)
def test_the_target_stays_in_the_default_box(name, seed):
    vertices = make_target('shuttle_stack').vertices
    moving = motion(name, seed=seed)
    for t in np.linspace(0, DURATION.get(name, 25.0), 40):
        T = moving.T_sensor_target(t)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        p = vertices @ T[:3, :3].T + T[:3, 3]
        assert np.abs(p[:, :2]).max() <= 0.4 and p[:, 2].min() >= 0.3 and p[:, 2].max() <= 1.2


@pytest.mark.parametrize('name', MOTION_NAMES)
def test_motions_are_seeded_and_smooth(name):
    same, other = motion(name, seed=5), motion(name, seed=6)
    np.testing.assert_array_equal(motion(name, seed=5).T_sensor_target(3.7), same.T_sensor_target(3.7))
    assert not np.allclose(same.T_sensor_target(3.7), other.T_sensor_target(3.7), atol=1e-3)
    for t in np.linspace(0, 20, 50):
        a, b = same.T_sensor_target(t), same.T_sensor_target(t + 0.01)
        assert rotation_angle(a[:3, :3].T @ b[:3, :3]) < 0.01
        assert np.linalg.norm(a[:3, 3] - b[:3, 3]) < 0.003


@pytest.mark.parametrize('rate', [0.5, -0.2, 0.8])
def test_spin_turns_about_a_fixed_tilted_axis_at_its_rate(rate):
    for seed in range(5):
        spin = motion('spin', rate_rad_s=rate, seed=seed)
        R0 = spin.T_sensor_target(0.0)[:3, :3]
        omega = log_so3(spin.T_sensor_target(1.0)[:3, :3] @ R0.T)
        assert np.linalg.norm(omega) == pytest.approx(abs(rate))
        axis = omega / rate
        tilt = np.degrees(np.arccos(axis @ [0, -1, 0]))
        assert 15 <= tilt <= 25
        # the target's own z axis is the spin axis
        np.testing.assert_allclose(R0[:, 2], axis, atol=1e-9)
        np.testing.assert_allclose(spin.T_sensor_target(7.0)[:3, :3], exp_so3(7 * omega) @ R0, atol=1e-9)
        np.testing.assert_array_equal(spin.T_sensor_target(9.0)[:3, 3], spin.T_sensor_target(0.0)[:3, 3])


def test_a_given_axis_and_range_are_kept():
    spin = motion('spin', axis_sensor=(2.0, 1.0, 0.5), range_m=0.65)
    T = spin.T_sensor_target(0.0)
    np.testing.assert_allclose(T[:3, 2], np.array([2.0, 1.0, 0.5]) / np.linalg.norm([2.0, 1.0, 0.5]))
    assert T[2, 3] == 0.65


def test_decaying_spin_stops_after_a_little_more_than_a_turn():
    decaying = motion('decaying_spin')
    times = np.arange(0.0, 60.0, 0.1)
    R = [decaying.T_sensor_target(t)[:3, :3] for t in times]
    steps = np.array([rotation_angle(a.T @ b) for a, b in pairwise(R)])
    assert steps[0] == pytest.approx(0.05, rel=0.01)
    assert 1.05 * 2 * np.pi < steps.sum() < 1.3 * 2 * np.pi
    assert np.all(np.diff(steps) < 1e-9) and steps[-1] < 1e-7


def test_still_is_still():
    still = motion('still')
    np.testing.assert_array_equal(still.T_sensor_target(0.0), still.T_sensor_target(20.0))


@pytest.mark.parametrize(('name', 'least'), [('swing', 0.05), ('clohessy_wiltshire', 0.08)])
def test_moving_observers_move_while_the_target_spins_evenly(name, least):
    moving = motion(name)
    centres = np.array([moving.T_sensor_target(t)[:3, 3] for t in np.arange(0, 25, 0.1)])
    assert np.ptp(centres, axis=0).max() > least
    first = world_attitude(moving, 0.0)
    assert rotation_angle(world_attitude(moving, 2.0) @ first.T) == pytest.approx(1.0)


def test_clohessy_wiltshire_solves_hills_equations():
    n, h = 0.15, 1e-3
    start = (np.array([0.03, -0.02, 0.01]), np.array([0.002, -0.004, 0.003]))

    def at(t):
        return clohessy_wiltshire(t, *start, n)

    np.testing.assert_allclose(at(0.0), start[0], atol=1e-12)
    np.testing.assert_allclose((at(h) - at(-h)) / (2 * h), start[1], atol=1e-7)
    for t in (0.0, 10.0, 40.0):
        velocity = (at(t + h) - at(t - h)) / (2 * h)
        acceleration = (at(t + h) - 2 * at(t) + at(t - h)) / h**2
        x, _, z = at(t)
        expected = [3 * n**2 * x + 2 * n * velocity[1], -2 * n * velocity[0], -(n**2) * z]
        np.testing.assert_allclose(acceleration, expected, atol=1e-7)


@pytest.mark.parametrize('seed', range(4))
def test_a_tumble_shows_the_target_from_many_sides(seed):
    tumble = motion('tumble', seed=seed)
    # the line of sight in the target frame: a spin would trace one circle
    views = np.array([tumble.T_sensor_target(t)[2, :3] for t in np.arange(0, 60, 0.1)])
    assert np.ptp(views, axis=0).min() > 0.6
    assert np.linalg.svd(views - views.mean(axis=0), compute_uv=False)[-1] > 3
    assert np.linalg.eigvalsh(np.cov(views.T))[0] > 0.01


def test_gaps_hide_only_when_asked_for():
    times = np.arange(0, 25, 0.1)
    assert all(motion('spin').visibility(t) == 1 for t in times)
    hidden = [motion('spin', gaps=True).visibility(t) == 0 for t in times]
    assert 15 <= sum(hidden) <= 100


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'name': 'wobble'}, r"'wobble'.*decaying_spin.*tumble"),
        ({'axis_sensor': (0.0, 0.0, 0.0)}, 'no direction'),
        ({'axis_sensor': (0.05, 0.0, -1.0)}, 'line of sight'),
    ],
)
def test_bad_settings_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        make_motion(MotionSettings(**options))


def turned_by(moving, a, b):
    return np.degrees(rotation_angle(moving.T_sensor_target(a)[:3, :3].T @ moving.T_sensor_target(b)[:3, :3]))


def test_a_turntable_that_steps_stands_still_as_long_as_it_turns():
    moving, turning = motion('steps'), np.radians(20.0) / 0.5
    assert turned_by(moving, 0.0, turning) == pytest.approx(20.0)
    assert turned_by(moving, turning, 2 * turning - 1e-6) == pytest.approx(0.0, abs=1e-6)
    assert turned_by(moving, 0.0, 8.2 * turning) == pytest.approx(84.0)


def test_a_turntable_that_stops_goes_on_after_ten_seconds():
    moving, turning = motion('stops'), np.radians(120.0) / 0.5
    assert turned_by(moving, turning, turning + 9.99) == pytest.approx(0.0, abs=1e-6)
    assert turned_by(moving, turning + 10.0, turning + 10.0 + turning / 2) == pytest.approx(60.0)


def test_a_hand_turns_the_target_only_while_it_touches_it():
    moving, turning = motion('by_hand'), np.radians(30.0) / 0.5
    assert moving.hand_away(0.0) == 1.0 and turned_by(moving, 0.0, 2.0) == pytest.approx(0.0, abs=1e-6)
    for k in range(3):
        touches = 2.0 + k * (2.0 + turning)
        assert moving.hand_away(touches + turning / 2) == 0.0
        assert turned_by(moving, touches, touches + turning) == pytest.approx(30.0)
        assert moving.hand_away(touches + turning + 0.25) == pytest.approx(0.5)
        assert moving.hand_away(touches + turning + 1.0) == 1.0
    assert motion('spin').hand_away(3.0) == 1.0


def body_rate(moving, t, h=1e-3):
    """Rate (3,) in the target's own frame, rad/s."""
    before, after = (moving.T_sensor_target(t + d)[:3, :3] for d in (-h, h))
    return log_so3(before.T @ after) / (2 * h)


@pytest.mark.parametrize(('axis', 'unit'), zip('xyz', np.eye(3), strict=True))
def test_any_of_the_targets_axes_spins(axis, unit):
    moving = motion('spin', spin_about=axis)
    np.testing.assert_allclose(body_rate(moving, 1.0), 0.5 * unit, atol=1e-6)
    # the same axis before the sensor whichever of the target's it is
    about = log_so3(world_attitude(moving, 0.1) @ world_attitude(moving, 0.0).T)
    same = log_so3(world_attitude(motion('spin'), 0.1) @ world_attitude(motion('spin'), 0.0).T)
    np.testing.assert_allclose(about, same, atol=1e-9)


@pytest.mark.parametrize('name', ['spin', 'tumble'])
def test_the_target_turns_about_its_centre_of_mass(name):
    centre = np.array([0.02, -0.01, 0.015])
    at = [motion(name, centre_of_mass=tuple(centre)).T_sensor_target(t) for t in (0.0, 4.0, 8.0)]
    still = [motion(name).T_sensor_target(t) for t in (0.0, 4.0, 8.0)]
    for T, S in zip(at, still, strict=True):
        np.testing.assert_allclose(T[:3, :3] @ centre + T[:3, 3], S[:3, 3], atol=1e-12)


def test_friction_takes_the_rate_and_leaves_the_path():
    damped, free = (motion('tumble', damping_s=s) for s in (20.0, None))
    ratio = np.linalg.norm(body_rate(damped, 20.0)) / np.linalg.norm(body_rate(free, 20.0 * (1 - np.exp(-1))))
    assert ratio == pytest.approx(np.exp(-1), rel=1e-4)


def test_dzhanibekovs_target_spins_evenly_and_then_turns_over():
    moving = motion('dzhanibekov', rate_rad_s=1.0)
    rates = np.array([body_rate(moving, t) for t in np.arange(0.1, 60.0, 0.5)])
    middle = rates[:, 1] / np.linalg.norm(rates, axis=1)  # moments 1, 0.8, 0.5: y is the middle one
    assert (np.abs(middle) > 0.95).mean() > 0.5
    assert middle.max() > 0.95 and middle.min() < -0.95


def test_a_motion_is_known_for_a_minute_after_its_end():
    short, long = (make_motion(MotionSettings('tumble', duration_s=s)) for s in (10.0, 70.0))
    np.testing.assert_allclose(short.T_sensor_target(69.0), long.T_sensor_target(69.0), atol=1e-6)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'spin_about': 'w'}, 'x, y or z'),
        ({'damping_s': 0.0}, 'damping'),
        ({'centre_of_mass': (np.nan, 0.0, 0.0)}, 'centre of mass'),
        ({'name': 'tumble', 'inertia': (1.0, 0.2, 0.2)}, 'principal moments'),
    ],
)
def test_bodies_that_cannot_be_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        make_motion(MotionSettings(**options))
