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

"""The prior of slowly changing rates: what it measures, and what it smooths and leaves."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, rotation_angle, transform
from debris_scanner.mapping.rate_prior import LEAST, RatePrior

N, RATE, STEP_S = 40, np.array([0.3, 0.7, 0.1]), 0.2
ALL = [True] * (N - 1)
STAMPS = [round(k * STEP_S * 1e9) for k in range(N)]


def turning(angles):
    """T_target_sensor of a target that has turned by the angles about RATE, two metres away."""
    axis = RATE / np.linalg.norm(RATE)
    return [inverse(transform(exp_so3(a * axis), np.array([0.0, 0.0, 2.0]))) for a in angles]


def shaken(poses, degrees):
    rng = np.random.default_rng(3)
    noise = np.radians(degrees) * rng.normal(size=(len(poses), 3))
    return [compose(exp_se3(np.concatenate([n, np.zeros(3)])), T) for n, T in zip(noise, poses, strict=True)]


def smoothed(prior, poses, steps=5):
    """The poses after Gauss-Newton steps on the prior and on each pose's own measurement."""
    start, n = [T.copy() for T in poses], len(poses)
    for _ in range(steps):
        blocks, gradient = {}, np.zeros((n, 6))
        prior.add(poses, blocks, gradient)
        A = np.zeros((6 * n, 6 * n))
        for (i, j), block in blocks.items():
            A[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = block
        for k in range(n):  # a measurement of each pose by itself
            A[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += np.eye(6) / np.radians(1.0) ** 2
            E = compose(poses[k], inverse(start[k]))
            gradient[k, :3] += np.array([E[2, 1], E[0, 2], E[1, 0]]) / np.radians(1.0) ** 2
        step = -np.linalg.solve(A, gradient.ravel()).reshape(n, 6)
        poses = [compose(exp_se3(s), T) for s, T in zip(step, poses, strict=True)]
    return poses


def errors_deg(poses, truth):
    return np.degrees(
        [rotation_angle(compose(T, inverse(P))[:3, :3]) for T, P in zip(poses, truth, strict=True)]
    )


def test_even_turning_is_smoothed():
    truth = turning(0.8 * STEP_S * np.arange(N))
    noisy = shaken(truth, 1.0)
    prior = RatePrior(STAMPS, ALL, noisy, weight=1.0)
    after = smoothed(prior, noisy)
    assert np.median(errors_deg(after, truth)) < 0.6 * np.median(errors_deg(noisy, truth))


def test_a_constant_rate_has_no_acceleration_and_pulls_at_nothing():
    truth = turning(0.8 * STEP_S * np.arange(N))
    prior = RatePrior(STAMPS, ALL, truth, weight=1.0)
    assert prior.sigma == LEAST
    gradient = np.zeros((N, 6))
    prior.add(truth, {}, gradient)
    assert np.abs(gradient).max() < 1e-3


@pytest.mark.parametrize('acceleration', [0.1, 0.5])
def test_an_acceleration_is_measured(acceleration):
    t = STEP_S * np.arange(N)
    # speeds up, then brakes
    angles = 0.2 * t + 0.5 * acceleration * np.where(t < 4, t**2, 8 * t - 16 - (t - 4) ** 2)
    prior = RatePrior(STAMPS, ALL, turning(angles), weight=1.0)
    assert prior.sigma == pytest.approx(acceleration / 1.54, rel=0.1)


def test_a_turntable_that_stops_is_let_be():
    moving = 0.8 * STEP_S * np.minimum(np.arange(N), 20)
    truth = turning(moving)
    noisy = shaken(truth, 0.3)
    after = smoothed(RatePrior(STAMPS, ALL, noisy, weight=1.0), noisy)
    assert errors_deg(after, truth).max() < 1.0


def test_what_is_not_linked_is_not_smoothed():
    poses = turning(0.8 * STEP_S * np.arange(N))
    linked = [k != 19 for k in range(N - 1)]
    prior = RatePrior(STAMPS, linked, shaken(poses, 0.5), weight=1.0)
    blocks = {}
    prior.add(poses, blocks, np.zeros((N, 6)))
    assert (18, 19) in blocks and (20, 21) in blocks
    assert not any(i <= 19 < j for i, j in blocks)


def test_a_few_key_frames_tell_no_rate():
    prior = RatePrior(STAMPS[:5], ALL[:4], turning(0.1 * np.arange(5)), weight=1.0)
    assert prior.sigma == np.inf
    blocks = {}
    prior.add(turning(0.1 * np.arange(5)), blocks, np.zeros((5, 6)))
    assert blocks == {}
