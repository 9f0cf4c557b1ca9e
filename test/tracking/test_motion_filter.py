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

"""The motion filter, fed with registrations whose answer is known."""

import numpy as np
import pytest

from debris_scanner.core.geometry import (
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_so3,
    rotation_angle,
    transform,
)
from debris_scanner.core.rigid_body import propagate
from debris_scanner.tracking.motion_filter import (
    ANGULAR_ACC,
    ATTITUDE,
    CENTRE,
    OMEGA,
    PIVOT,
    SIZE,
    VELOCITY,
    MotionFilter,
    MotionSettings,
)

SETTINGS = MotionSettings()
OMEGA_TRUE = np.array([0.1, -0.45, 0.15])
PIVOT_TRUE = np.array([0.02, -0.03, 0.05])  # rotation centre in the target frame
CENTRE_0 = np.array([0.01, -0.02, 0.8])
VELOCITY_TRUE = np.array([0.01, 0.0, -0.005])
DT = 0.1
POINTS = 2000
FOOTPRINT = 0.0015  # m, of a pixel


def true_pose(t):
    R = exp_so3(OMEGA_TRUE * t)
    return transform(R, CENTRE_0 + VELOCITY_TRUE * t - R @ PIVOT_TRUE)


def start():
    """A filter that has the first pose right and everything else to learn."""
    motion = MotionFilter(CENTRE_0 - PIVOT_TRUE, SETTINGS, FOOTPRINT)
    np.testing.assert_allclose(motion.T_sensor_target, true_pose(0), atol=1e-12)
    return motion


def normal_matrix(T_target_sensor, extent=0.1):
    """Information of POINTS surface points around the target, residuals in px, for a twist in its frame."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-extent, extent, (POINTS, 3))
    normals = rng.normal(size=(POINTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    J = np.hstack([np.cross(points, normals), normals])
    return J.T @ J / FOOTPRINT**2


def twist_between(T_from, T_to):
    """Decoupled left twist with exp_se3(twist) @ T_from == T_to, to first order."""
    E = compose(T_to, inverse(T_from))
    return np.concatenate([log_so3(E[:3, :3]), E[:3, 3]])


def update(motion, T_measured, H):
    """The iterated update with a registration that pulls T_target_sensor towards the measured one."""
    prior = motion.copy()
    information = np.linalg.inv(prior.P + 1e-14 * np.eye(SIZE))
    for _ in range(4):
        g = -H @ twist_between(inverse(motion.T_sensor_target), inverse(T_measured))
        motion.update_step(prior, information, H, g)


def run(frames, sigma_scale=0.0, seed=0):
    """Filter after a number of frames, and its error with the covariance of it, frame by frame."""
    rng = np.random.default_rng(seed)
    motion = start()
    H = normal_matrix(np.eye(4))
    noise = np.linalg.inv(H * SETTINGS.information_scale)
    history = []
    for k in range(1, frames + 1):
        motion.predict(DT)
        T = inverse(true_pose(k * DT))
        T = compose(exp_se3(sigma_scale * rng.multivariate_normal(np.zeros(6), noise)), T)
        update(motion, inverse(T), H)
        history.append((motion.copy(), true_pose(k * DT)))
    return motion, history


def test_constant_rate_is_learnt():
    motion, history = run(60)
    np.testing.assert_allclose(motion.omega, OMEGA_TRUE, atol=0.004)
    np.testing.assert_allclose(motion.omega_target, exp_so3(-OMEGA_TRUE * 6) @ OMEGA_TRUE, atol=0.004)
    E = compose(inverse(history[-1][1]), motion.T_sensor_target)
    assert rotation_angle(E[:3, :3]) < np.radians(0.02)
    assert np.linalg.norm(E[:3, 3]) < 1e-4
    # the rate's stated uncertainty has come down from its prior, and the truth lies within it
    assert (motion.omega_sigma < 0.2 * SETTINGS.rate_sigma).all()
    assert (np.abs(motion.omega - OMEGA_TRUE) < 3 * motion.omega_sigma).all()


def test_velocity_is_learnt_though_not_of_which_point():
    """What is seen moving is the target's origin; how that splits into centre and lever stays open."""
    motion, _ = run(60)
    lever = -motion.R @ motion.pivot
    origin = motion.velocity + np.cross(motion.omega, lever)
    R = true_pose(6.0)[:3, :3]
    np.testing.assert_allclose(origin, VELOCITY_TRUE + np.cross(OMEGA_TRUE, -R @ PIVOT_TRUE), atol=1e-3)
    # and the filter says so: the true centre is within what it states
    off = motion.pivot - PIVOT_TRUE
    assert off @ np.linalg.solve(motion.P[PIVOT, PIVOT], off) < 9
    assert (np.abs(motion.velocity - VELOCITY_TRUE) < 3 * np.sqrt(np.diag(motion.P)[VELOCITY])).all()


def test_prediction_runs_ahead_along_the_motion():
    motion, _ = run(60)
    motion.predict(0.5)
    E = compose(inverse(true_pose(6.5)), motion.T_sensor_target)
    assert rotation_angle(E[:3, :3]) < np.radians(0.3)
    assert np.linalg.norm(E[:3, 3]) < 0.003


@pytest.mark.parametrize('dt', [0.01, 0.1, 0.35, 2.0])
def test_covariance_stays_symmetric_and_positive(dt):
    motion = start()
    H = normal_matrix(np.eye(4))
    for _ in range(20):
        motion.predict(dt)
        np.testing.assert_allclose(motion.P, motion.P.T, rtol=1e-6, atol=1e-15)
        assert np.linalg.eigvalsh(motion.P).min() > -1e-12
        update(motion, motion.T_sensor_target, H)
        assert np.linalg.eigvalsh(motion.P).min() > 0
        np.testing.assert_array_equal(motion.P, motion.P.T)


@pytest.mark.parametrize('dt', [3600.0, 86400.0, 1.6e9])
def test_a_gap_without_end_costs_no_more_than_it_tells(dt, monkeypatch):
    """Once every attitude is as likely as any other, time that goes by changes nothing."""
    taken = []
    step = MotionFilter._predict_step
    monkeypatch.setattr(MotionFilter, '_predict_step', lambda self, h: (taken.append(h), step(self, h)))
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), 0.0015)
    motion.omega = np.array([0.1, 0.5, 0.0])
    motion.P[OMEGA, OMEGA] = motion.P[ANGULAR_ACC, ANGULAR_ACC] = 1e-8 * np.eye(3)
    motion.angular_acc_sigma = MotionSettings().least_angular_acc_sigma
    motion.predict(dt)
    assert len(taken) < 1000
    assert np.sqrt(np.diag(motion.P)[:3]).max() > np.pi
    assert np.isfinite(motion.centre).all()
    np.testing.assert_allclose(motion.P @ np.linalg.inv(motion.P), np.eye(len(motion.P)), atol=1e-6)


def test_prediction_forgets_and_measurement_learns():
    motion = start()
    before = np.trace(motion.pose_covariance)
    motion.predict(DT)
    predicted = np.trace(motion.pose_covariance)
    update(motion, motion.T_sensor_target, normal_matrix(np.eye(4)))
    assert before < predicted
    assert np.trace(motion.pose_covariance) < 0.1 * predicted


def test_unconstrained_direction_is_left_to_the_motion_model():
    """A registration that says nothing about one direction must not move it, nor be sure of it."""
    motion, _ = run(40)
    motion.predict(DT)
    before = motion.copy()
    H = normal_matrix(np.eye(4))
    blind = np.eye(6)
    blind[3, 3] = 0  # no stiffness along the target's x
    H = blind @ H @ blind
    off = compose(exp_se3(np.array([0, 0, 0, 0.05, 0, 0.0])), inverse(motion.T_sensor_target))
    update(motion, inverse(off), H)
    x = motion.R[:, 0]
    moved = (motion.T_sensor_target - before.T_sensor_target)[:3, 3]
    assert abs(moved @ x) < 0.005
    sigma = np.sqrt(x @ motion.pose_covariance[3:, 3:] @ x)
    others = np.sqrt(motion.R[:, 1] @ motion.pose_covariance[3:, 3:] @ motion.R[:, 1])
    assert sigma > 5 * others


def test_errors_are_as_large_as_the_covariance_says():
    """Normalised squared error of the pose: 6 on average if noise and covariance match."""
    nees = []
    for seed in range(12):
        _, history = run(30, sigma_scale=1.0, seed=seed)
        for motion, truth in history[10::4]:
            e = np.concatenate(
                [
                    log_so3(motion.R @ truth[:3, :3].T),
                    motion.T_sensor_target[:3, 3] - truth[:3, 3],
                ]
            )
            nees.append(e @ np.linalg.solve(motion.pose_covariance, e))
    # process noise is set for accelerations that this motion does not have, so it errs on the safe side
    assert 2.0 < np.mean(nees) < 8.0


def test_change_of_target_frame_keeps_what_the_sensor_sees():
    motion, _ = run(20)
    changed = motion.copy()
    T_new_old = exp_se3(np.array([0.4, -1.2, 0.7, 0.1, 0.05, -0.2]))
    changed.change_target_frame(T_new_old)
    for dt in (0.0, 0.1, 0.7):
        motion.predict(dt)
        changed.predict(dt)
        np.testing.assert_allclose(changed.omega, motion.omega, atol=1e-12)
        np.testing.assert_allclose(changed.velocity, motion.velocity, atol=1e-12)
        np.testing.assert_allclose(changed.centre, motion.centre, atol=1e-12)
        expected = compose(motion.T_sensor_target, inverse(T_new_old))
        np.testing.assert_allclose(changed.T_sensor_target, expected, atol=1e-9)
    np.testing.assert_allclose(changed.omega_target, T_new_old[:3, :3] @ motion.omega_target, atol=1e-9)


def test_pose_jacobian_is_the_derivative():
    motion, _ = run(5)
    T = motion.T_sensor_target
    for k in range(SIZE):
        step = np.zeros(SIZE)
        step[k] = 1e-6
        moved = motion.copy()
        moved.correct(step)
        E = moved.T_sensor_target
        numeric = np.concatenate([log_so3(E[:3, :3] @ T[:3, :3].T), E[:3, 3] - T[:3, 3]]) / 1e-6
        np.testing.assert_allclose(motion.pose_jacobian()[:, k], numeric, atol=1e-5)


def test_difference_undoes_correction():
    a, _ = run(5)
    b = a.copy()
    step = np.random.default_rng(1).normal(scale=0.05, size=SIZE)
    b.correct(step)
    np.testing.assert_allclose(b.difference(a), step, atol=1e-9)
    assert not np.shares_memory(a.P, b.P)
    assert np.abs(a.difference(a)).max() < 1e-12


def test_start_knows_the_pose_though_not_the_centre():
    motion = start()
    sigma = np.sqrt(np.diag(motion.pose_covariance))
    assert (sigma[:3] < 2e-4).all()
    assert (sigma[3:] < 1e-3).all()
    assert np.sqrt(np.diag(motion.P)[CENTRE]).min() > 0.04
    assert np.sqrt(np.diag(motion.P)[PIVOT]).min() > 0.04
    assert np.sqrt(np.diag(motion.P)[OMEGA]) == pytest.approx(SETTINGS.rate_sigma)


def drifting(seconds, acceleration=None):
    """Filter after so long a drift without noise, the target pushed by an acceleration (3,) if given."""
    motion, H = start(), normal_matrix(np.eye(4))
    push = np.zeros(3) if acceleration is None else acceleration
    for n in range(1, round(seconds / DT) + 1):
        motion.predict(DT)
        T = true_pose(n * DT)
        T[:3, 3] += 0.5 * push * (n * DT) ** 2
        update(motion, T, H)
        motion.adapt(DT)
    return motion


def test_an_even_drift_is_trusted_and_tells_what_the_target_turns_about():
    motion = drifting(25.0)
    assert motion.linear_acc_sigma < 3 * SETTINGS.least_linear_acc_sigma * FOOTPRINT
    assert motion.angular_acc_sigma < 2 * SETTINGS.least_angular_acc_sigma
    across = np.cross(motion.pivot - PIVOT_TRUE, OMEGA_TRUE / np.linalg.norm(OMEGA_TRUE))
    assert np.linalg.norm(across) < 0.2 * np.linalg.norm(np.cross(PIVOT_TRUE, OMEGA_TRUE))
    ahead = motion.copy()
    ahead.predict(3.0)
    assert np.linalg.norm(ahead.T_sensor_target[:3, 3] - true_pose(28.0)[:3, 3]) < 0.01


def test_acceleration_that_is_seen_is_expected():
    pushed = drifting(8.0, acceleration=np.array([0.0, 0.1, 0.0]))
    assert pushed.linear_acc_sigma > 5 * drifting(8.0).linear_acc_sigma


def test_released_it_keeps_the_pose_and_what_is_rigid_and_forgets_the_motion():
    motion = drifting(8.0)
    released = motion.released()
    np.testing.assert_array_equal(released.T_sensor_target, motion.T_sensor_target)
    np.testing.assert_array_equal(released.pose_covariance, motion.pose_covariance)
    np.testing.assert_array_equal(released.P[PIVOT, PIVOT], motion.P[PIVOT, PIVOT])
    assert np.sqrt(np.diag(released.P)[OMEGA]) == pytest.approx(SETTINGS.rate_sigma)
    assert released.angular_acc_sigma == SETTINGS.angular_acc_sigma > motion.angular_acc_sigma
    assert np.linalg.eigvalsh(released.P).min() > 0
    released.predict(DT)
    assert np.sqrt(np.diag(released.pose_covariance)[:3]) == pytest.approx(SETTINGS.rate_sigma * DT, rel=0.1)


INERTIA = np.diag([1.0, 0.8, 0.5])


def tumbling():
    """A filter that knows a tumbling body, at some attitude."""
    motion = start()
    motion.R = exp_so3(np.array([0.4, -1.0, 0.7]))
    motion.omega = motion.R @ np.array([0.2, 0.5, -0.3])
    motion.angular_acc = np.zeros(3)
    motion.know_inertia(INERTIA)
    motion.angular_acc = np.zeros(3)
    return motion


def test_a_known_body_is_followed_through_a_gap():
    known = tumbling()
    R, rates = propagate(known.R, known.omega_target, INERTIA, np.array([3.0]))
    unknown = known.copy()
    unknown.know_inertia(np.eye(3))
    known.predict(3.0)
    unknown.predict(3.0)
    assert np.degrees(rotation_angle(known.R.T @ R[0])) < 0.01
    np.testing.assert_allclose(known.omega_target, rates[0], atol=1e-4)
    assert np.degrees(rotation_angle(unknown.R.T @ R[0])) > 1.0


@pytest.mark.parametrize('part', [ATTITUDE, OMEGA])
def test_what_a_body_does_spreads_as_its_covariance_says(part):
    motion = tumbling()
    motion.P = np.zeros((SIZE, SIZE))
    step = np.zeros(SIZE)
    step[part] = [0.003, -0.001, 0.002]
    motion.P += np.outer(step, step)
    other = motion.copy()
    other.correct(step)
    nothing = motion.copy()
    nothing.P[:] = 0.0
    for each in (motion, other, nothing):
        each.predict(1.0)
    spread = motion.P - nothing.P  # without the process noise
    moved = other.difference(motion)
    np.testing.assert_allclose(
        spread[: OMEGA.stop, : OMEGA.stop],
        np.outer(moved, moved)[: OMEGA.stop, : OMEGA.stop],
        atol=0.1 * moved @ moved,
    )


def test_knowing_the_inertia_changes_nothing_that_was_observed():
    motion = start()
    motion.omega, motion.angular_acc = OMEGA_TRUE.copy(), np.array([0.02, -0.01, 0.03])
    before, known = motion.copy(), motion.copy()
    known.know_inertia(INERTIA)
    again = known.copy()
    again.know_inertia(np.eye(3))
    np.testing.assert_allclose(again.angular_acc, before.angular_acc, atol=1e-12)
    assert np.linalg.norm(known.angular_acc - before.angular_acc) > 0.01
    before.predict(0.01)
    known.predict(0.01)
    np.testing.assert_allclose(known.omega, before.omega, atol=2e-6)


def test_inertia_moves_with_the_target_frame():
    T_new_old = transform(exp_so3(np.array([0.3, -0.2, 1.0])), np.array([0.01, 0.02, -0.03]))
    here, there = tumbling(), tumbling()
    there.change_target_frame(T_new_old)
    here.predict(2.0)
    there.predict(2.0)
    np.testing.assert_allclose(there.T_sensor_target @ T_new_old, here.T_sensor_target, atol=1e-9)
