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

"""The prior of slowly changing velocities: what it measures, and what it smooths and leaves."""

from itertools import pairwise

import numpy as np
import pytest

from debris_scanner.core.geometry import (
    apply,
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_se3,
    log_so3,
    rotation_angle,
    transform,
)
from debris_scanner.mapping.motion_prior import LEAST, Blocks, MotionPrior
from debris_scanner.sim.motions import TUMBLE, MotionSettings, make_motion

N, RATE, STEP_S, EXTENT = 40, np.array([0.3, 0.7, 0.1]), 0.2, 0.3
CENTRE = np.array([0.04, -0.02, 0.03])  # that moves evenly, in the target frame
ALL = [True] * (N - 1)
STAMPS = [round(k * STEP_S * 1e9) for k in range(N)]
TIMES = STEP_S * np.arange(N)


def turning(angles, path=None):
    """T_target_sensor of a target that has turned by the angles about RATE, its centre on a path (n, 3)."""
    axis = RATE / np.linalg.norm(RATE)
    path = np.tile([0.0, 0.0, 2.0], (len(angles), 1)) if path is None else path
    R = [exp_so3(a * axis) for a in angles]
    return [inverse(transform(R_k, c - R_k @ CENTRE)) for R_k, c in zip(R, path, strict=True)]


def shaken(poses, degrees, metres=0.0):
    rng = np.random.default_rng(3)
    sigma = np.repeat([np.radians(degrees), metres], 3)
    # about where the target is, as views err
    return [compose(exp_se3(sigma * rng.normal(size=6)), T) for T in poses]


def prior_of(poses, stamps=STAMPS, linked=ALL):
    return MotionPrior(stamps, linked, poses, np.zeros(3), EXTENT, weight=1.0)


def by_place(blocks, n):
    """The blocks of n rows by row and column."""
    values, columns, starts = blocks.summed(n)
    rows = np.repeat(np.arange(n), np.diff(starts))
    return dict(zip(zip(rows.tolist(), columns.tolist(), strict=True), values, strict=True))


def smoothed(prior, poses, degrees, metres=0.01, steps=5):
    """The poses after Gauss-Newton steps on the prior and on each pose's own measurement."""
    start, n = [T.copy() for T in poses], len(poses)
    sigmas = np.column_stack([np.broadcast_to(v, n) for v in (np.radians(degrees), metres)]).repeat(3, axis=1)
    for _ in range(steps):
        summed, gradient = Blocks(), np.zeros((n + 1, 6))
        prior.add(poses, summed, gradient)
        blocks = by_place(summed, n + 1)
        A = np.zeros((6 * n + 6, 6 * n + 6))
        for (i, j), block in blocks.items():
            A[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = block
        for k in range(n):
            measured = np.diag(sigmas[k] ** -2)
            A[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += measured
            gradient[k] += measured @ log_se3(compose(poses[k], inverse(start[k])))
        step = -np.linalg.solve(A, gradient.ravel()).reshape(n + 1, 6)
        poses = [compose(exp_se3(s), T) for s, T in zip(step[:n], poses, strict=True)]
        prior.centre = prior.centre + step[n, 3:]
    return poses


def errors_deg(poses, truth):
    return np.degrees(
        [rotation_angle(compose(T, inverse(P))[:3, :3]) for T, P in zip(poses, truth, strict=True)]
    )


def shifts(poses, truth):
    """How far each pose sees the target's centre beside the truth, m."""
    return np.array(
        [
            np.linalg.norm(apply(inverse(T), CENTRE) - apply(inverse(P), CENTRE))
            for T, P in zip(poses, truth, strict=True)
        ]
    )


def test_derivatives_are_those_of_the_residuals():
    """The gradient along any motion is the slope of the cost, which is half of the gradient's own sum."""
    poses = shaken(turning(0.8 * TIMES[:9]), 1.0, 0.003)
    prior = prior_of(poses, STAMPS[:9], ALL[:8])
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(9, 6))

    def gradient(size):
        g = np.zeros((10, 6))
        prior.add(
            [compose(exp_se3(size * d), T) for d, T in zip(directions, poses, strict=True)], Blocks(), g
        )
        return g

    summed, at = Blocks(), np.zeros((10, 6))
    prior.add(poses, summed, at)
    blocks = by_place(summed, 10)
    step = 1e-6
    slope = (gradient(step) - gradient(-step)) / (2 * step)
    predicted = np.zeros((10, 6))
    for (i, j), block in blocks.items():
        if j < 9:
            predicted[i] += block @ directions[j]
    # Gauss-Newton leaves out second derivatives, and how the robust weight changes
    cosine = (slope * predicted).sum() / (np.linalg.norm(slope) * np.linalg.norm(predicted))
    assert cosine > 0.9


def test_even_turning_is_smoothed():
    truth = turning(0.8 * TIMES)
    noisy = shaken(truth, 1.0)
    after = smoothed(prior_of(noisy), noisy, 1.0)
    assert np.median(errors_deg(after, truth)) < 0.6 * np.median(errors_deg(noisy, truth))


def test_a_drifting_centre_is_found_and_smoothed():
    truth = turning(0.8 * TIMES, np.outer(TIMES, [0.05, 0.0, -0.02]) + [0.0, 0.0, 2.0])
    rng = np.random.default_rng(4)
    noisy = [compose(T, transform(np.eye(3), 0.005 * rng.normal(size=3))) for T in truth]
    prior = prior_of(noisy)
    across = np.eye(3) - np.outer(RATE, RATE) / (RATE @ RATE)  # along the axis nothing shows it
    assert np.linalg.norm(across @ (prior.centre - CENTRE)) < 0.5 * np.linalg.norm(across @ CENTRE)
    after = smoothed(prior, noisy, 0.5, 0.005)
    assert np.median(shifts(after, truth)) < 0.7 * np.median(shifts(noisy, truth))


def test_even_motion_has_no_acceleration_and_pulls_at_nothing():
    truth = turning(0.8 * TIMES)
    prior = prior_of(truth)
    assert prior.angular_sigma == LEAST and prior.linear_sigma == LEAST * EXTENT
    gradient = np.zeros((N + 1, 6))
    prior.add(truth, Blocks(), gradient)
    along = RATE / np.linalg.norm(RATE)
    assert np.abs(gradient[:, :3]).max() < 1.0  # of a weight of up to 1e8 a radian
    np.testing.assert_allclose(np.cross(prior.centre - CENTRE, along), 0.0, atol=1e-3)


@pytest.mark.parametrize('acceleration', [0.1, 0.5])
def test_an_acceleration_is_measured(acceleration):
    # speeds up, then brakes
    t = TIMES
    angles = 0.2 * t + 0.5 * acceleration * np.where(t < 4, t**2, 8 * t - 16 - (t - 4) ** 2)
    assert prior_of(turning(angles)).angular_sigma == pytest.approx(acceleration / 1.54, rel=0.1)


def test_a_turntable_that_stops_is_let_be():
    truth = turning(0.8 * STEP_S * np.minimum(np.arange(N), 20))
    noisy = shaken(truth, 0.3)
    assert errors_deg(smoothed(prior_of(noisy), noisy, 1.0), truth).max() < 1.0


def test_what_is_not_linked_is_not_smoothed():
    poses = turning(0.8 * TIMES)
    summed = Blocks()
    prior = prior_of(shaken(poses, 0.5), linked=[k != 19 for k in range(N - 1)])
    prior.add(poses, summed, np.zeros((N + 1, 6)))
    blocks = by_place(summed, N + 1)
    assert (18, 19) in blocks and (20, 21) in blocks
    assert not any(i <= 19 < j < N for i, j in blocks)


def test_a_few_key_frames_tell_no_motion():
    poses = turning(0.1 * np.arange(5))
    prior = prior_of(poses, STAMPS[:5], ALL[:4])
    assert prior.angular_sigma == prior.linear_sigma == np.inf
    summed = Blocks()
    prior.add(poses, summed, np.zeros((6, 6)))
    blocks = by_place(summed, 6)
    assert set(blocks) == {(5, 5)}  # the centre alone is held


def test_denser_stamps_leave_more_of_the_noise():
    prior = prior_of(shaken(turning(0.8 * TIMES), 0.3))
    dense = np.arange(0, STAMPS[-1], round(STEP_S * 1e9) // 4)
    other = prior.resampled([int(t) for t in dense], turning(0.8e-9 * dense))
    assert other.angular_sigma == pytest.approx(2 * prior.angular_sigma)
    assert other.linear_sigma == pytest.approx(2 * prior.linear_sigma)


def test_a_slip_before_the_rate_was_known_has_an_even_rival():
    """It stood still for the first fifth, as it seemed: the rival turned evenly from the start."""
    still = 1.2 * STEP_S * np.maximum(np.arange(N) - 8, 0)
    path = np.outer(TIMES, [0.02, 0.0, 0.01]) + [0.0, 0.0, 2.0]
    rival = prior_of(turning(still, path)).evened(turning(still, path))
    truth = turning(1.2 * STEP_S * (np.arange(N) - 8), path)
    assert errors_deg(rival, truth).max() < 2.0
    assert errors_deg(rival[8:], truth[8:]).max() < 1e-6


@pytest.mark.parametrize(
    'angles',
    [
        0.8 * TIMES,
        0.2 * TIMES + 0.05 * TIMES**2,  # speeds up
        0.9 * STEP_S * np.cumsum(np.arange(N) % 2),  # steps: no long run
    ],
)
def test_without_a_long_even_run_beside_a_jump_there_is_no_rival(angles):
    poses = turning(angles)
    assert prior_of(poses).evened(poses) is None


def tumbling(degrees, seed=1):
    """T_target_sensor of a tumble, true and shaken, with its stamps."""
    motion = make_motion(MotionSettings(TUMBLE, duration_s=30.0, seed=seed))
    seconds = np.arange(0.0, 30.0, 0.25)
    truth = [inverse(motion.T_sensor_target(t)) for t in seconds]
    return truth, shaken(truth, degrees, 0.001), [round(t * 1e9) for t in seconds]


@pytest.mark.parametrize('seed', range(3))
def test_a_tumble_turns_as_its_inertia_says(seed):
    """Its acceleration is expected; what is left is that of the noise, far less than the tumble's own."""
    _, poses, stamps = tumbling(0.05, seed)
    linked = [True] * (len(poses) - 1)
    prior = prior_of(poses, stamps, linked)
    rates = (
        np.diff(np.array([log_so3(b[:3, :3].T @ a[:3, :3]) for a, b in pairwise(poses)]), axis=0) / 0.25**2
    )
    assert prior.angular_sigma < 0.2 * np.median(np.linalg.norm(rates, axis=1))


@pytest.mark.parametrize(('seed', 'spacing'), [(6, 4), (3, 6)])
def test_a_tumble_is_no_uneven_turn(seed, spacing):
    """Its rate changes as that of the body does, however far apart the key frames are."""
    _, poses, stamps = tumbling(0.05, seed)
    some = slice(None, None, spacing)
    prior = prior_of(poses[some], stamps[some], [True] * (len(poses[some]) - 1))
    assert prior.evened(poses[some]) is None


def test_a_tumble_is_bridged_where_nothing_shows():
    truth, poses, stamps = tumbling(0.05)
    linked = [True] * (len(poses) - 1)
    hidden = range(50, 62)  # three seconds, in which it turns by 86 degrees
    prior = prior_of(poses, stamps, linked)
    lost = [
        T if k not in hidden else compose(exp_se3(np.radians([2, -3, 2, 0, 0, 0])), T)
        for k, T in enumerate(poses)
    ]
    found = smoothed(prior, lost, np.where(np.isin(np.arange(len(poses)), list(hidden)), 30.0, 0.05))
    assert errors_deg(found, truth)[list(hidden)].max() < 0.3


@pytest.mark.parametrize('seed', range(3))
def test_a_tumble_is_followed_through_a_gap(seed):
    """Three seconds out of sight, then 1 degree off, which its rate before does not allow."""
    truth, poses, stamps = tumbling(0.05, seed)
    seen = [k for k in range(len(poses)) if not 60 <= k < 72]
    later = np.array(seen) >= 72
    off = exp_se3(np.radians([0.5, -0.75, 0.5, 0.0, 0.0, 0.0]))
    start = [compose(off, poses[k]) if k >= 72 else poses[k] for k in seen]
    linked = [b == a + 1 for a, b in pairwise(seen)]
    prior = prior_of(start, [stamps[k] for k in seen], linked)
    sigma = np.where(later, 1000.0, 0.05)  # what the views say of the later part is not worth much
    found = smoothed(prior, start, sigma, np.where(later, 100.0, 0.001), steps=30)
    errors = errors_deg(found, [truth[k] for k in seen])
    assert errors[later][:4].max() < 0.7


@pytest.mark.parametrize('jump_s', [86400, 1_600_000_000])
def test_nothing_is_expected_across_a_clock_that_was_set(jump_s):
    _, poses, stamps = tumbling(0.05)
    stamps = [s if k < 60 else s + jump_s * 10**9 for k, s in enumerate(stamps)]
    linked = [k != 59 for k in range(len(poses) - 1)]
    prior = prior_of(poses, stamps, linked)
    found = smoothed(prior, poses, np.full(len(poses), 0.05), np.full(len(poses), 0.001))
    assert errors_deg(found, poses).max() < 0.3


def test_blocks_at_one_place_add_up():
    rng, blocks, whole = np.random.default_rng(6), Blocks(), np.zeros((4, 4, 6, 6))
    for _ in range(3):
        (rows, columns), values = rng.integers(0, 4, (2, 5)), rng.normal(size=(5, 6, 6))
        blocks.add(rows, columns, values)
        np.add.at(whole, (rows, columns), values)
    for (i, j), block in by_place(blocks, 4).items():
        np.testing.assert_allclose(block, whole[i, j])
        whole[i, j] = 0
        if i == j:
            assert block.any()
    assert not whole.any()


def test_the_trace_of_blocks_is_that_of_the_diagonal():
    blocks = Blocks()
    blocks.add(np.array([0, 1, 1]), np.array([0, 1, 0]), np.eye(6) * np.array([1.0, 2.0, 9.0])[:, None, None])
    assert blocks.trace() == pytest.approx(18.0)
