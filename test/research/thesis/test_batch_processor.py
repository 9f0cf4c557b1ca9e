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

"""The batch processor: transitions, convergence, refusals."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, inverse, log_so3, transform
from debris_scanner.research.thesis.batch_processor import (
    estimate,
    odometry_poses,
    replace_outliers,
    state_transition,
)
from debris_scanner.research.thesis.euler_parameters import RateObservation, left_matrix, of_rate

OMEGA = np.array([0.0, -0.65, 0.0])


def observations(rates, fitness=1e-6, dt_ns=200_000_000):
    fitness = np.broadcast_to(fitness, len(rates))
    return [
        RateObservation((k + 1) * dt_ns, w, float(f))
        for k, (w, f) in enumerate(zip(rates, fitness, strict=True))
    ]


def test_transition_as_printed():
    t, w = 1.3, -0.4
    expected = np.eye(7)
    expected[0, 5] = -0.5 * t * np.sin(0.5 * w * t)
    expected[2, 5] = 0.5 * t * np.cos(0.5 * w * t)
    state = np.array([1, 0, 0, 0, 0.1, w, -0.2])
    assert np.allclose(state_transition(state, t), expected)
    assert np.array_equal(state_transition(state, 0.0), np.eye(7))  # eq. 2.60


def test_transition_about_any_axis_is_the_derivative_of_the_motion():
    state = np.array([0.8, 0.2, -0.4, 0.4, 0.3, -0.5, 0.2])
    t, step = 2.0, 1e-6

    def later(x):
        return np.concatenate([left_matrix(x[:4]) @ of_rate(x[4:], t), x[4:]])

    numeric = np.stack(
        [(later(state + step * e) - later(state - step * e)) / (2 * step) for e in np.eye(7)], 1
    )
    assert np.allclose(state_transition(state, t, planar=False), numeric, atol=1e-8)


def test_constant_rate_is_found_in_two_iterations_whatever_the_prior():
    prior = np.array([1, 0, 0, 0, 0, 0.2795, 0])  # the wrong sign, as in section 4.2
    result = estimate(0, observations([OMEGA] * 30), prior)
    assert result.iterations == 2  # linear in the rates: the second only confirms
    assert np.allclose(result.state[4:], OMEGA, atol=1e-6)
    assert np.abs(result.residuals).max() < 1e-6
    assert np.allclose(log_so3(result.attitude(4_000_000_000)), OMEGA * 4.0, atol=1e-5)


def test_weights_are_the_inverse_fitness():
    rates = [np.array([0, -0.6, 0]), np.array([0, -0.7, 0])]
    result = estimate(0, observations(rates, [1e-6, 3e-6]))
    assert result.state[5] == pytest.approx((-0.6 * 3 - 0.7) / 4, abs=1e-5)
    assert result.residuals[:, 1] == pytest.approx([0.025, -0.075], abs=1e-5)


def test_a_sinusoidal_rate_stays_in_the_residuals():
    t = np.arange(1, 61) * 0.2
    rates = OMEGA + 0.2 * np.sin(2 * np.pi * t / 4.0)[:, None] * [0, 1, 0]
    result = estimate(0, observations(list(rates)))
    assert result.state[5] == pytest.approx(-0.65, abs=0.01)
    assert np.sqrt(np.mean(result.residuals[:, 1] ** 2)) == pytest.approx(0.2 / np.sqrt(2), rel=0.02)


def test_formal_covariance_is_that_of_the_scatter_when_weights_are_true():
    rng = np.random.default_rng(5)
    sigma = 0.03
    errors, formal = [], None
    for _ in range(300):
        rates = OMEGA + sigma * rng.normal(size=(25, 3))
        result = estimate(0, observations(list(rates), sigma**2), prior_covariance=1e4 * np.eye(7))
        errors.append(result.state[4:] - OMEGA)
        formal = result.covariance
    nees = np.mean([e @ np.linalg.solve(formal[4:, 4:], e) for e in errors])
    assert 2.6 < nees < 3.4  # 3 expected; 99.5 % within 0.4


def test_missing_rates_are_skipped_and_none_at_all_refused():
    some = observations([OMEGA, None, OMEGA])
    assert estimate(0, some).stamps == [200_000_000, 600_000_000]
    with pytest.raises(ValueError, match='without a single'):
        estimate(0, observations([None, None]))


def test_off_axis_spin_needs_more_than_the_planar_model():
    omega = np.array([0.2, -0.6, 0.1])
    planar = estimate(0, observations([omega] * 20))
    free = estimate(0, observations([omega] * 20), planar=False)
    t = 3_000_000_000
    assert np.allclose(log_so3(free.attitude(t)), omega * 3, atol=1e-5)
    assert np.allclose(log_so3(planar.attitude(t)), [0, omega[1] * 3, 0], atol=1e-5)


def test_outlier_translations_are_interpolated_and_the_rest_kept():
    rng = np.random.default_rng(3)
    t = np.stack([np.linspace(0, 0.001, 30), np.zeros(30), np.linspace(0.02, 0.019, 30)], 1)
    t += 1e-4 * rng.normal(size=t.shape)
    spoilt = t.copy()
    spoilt[12] += [0.05, 0, 0]
    spoilt[29] -= [0, 0, 0.04]
    fixed, outlier = replace_outliers(spoilt, sigmas=6.0)
    assert outlier.nonzero()[0].tolist() == [12, 29]
    assert np.allclose(fixed[12], (t[11] + t[13]) / 2)
    assert np.allclose(fixed[29], t[28])  # at the end there is one neighbour
    assert np.array_equal(np.delete(fixed, [12, 29], 0), np.delete(t, [12, 29], 0))


def test_poses_chain_to_the_first_frame():
    rng = np.random.default_rng(8)
    truth = [np.eye(4)]
    steps = []
    for _ in range(200):
        step = transform(exp_so3(0.1 * rng.normal(size=3)), 0.01 * rng.normal(size=3))
        steps.append(step)
        truth.append(truth[-1] @ step)
    poses = odometry_poses([T[:3, :3] for T in truth], np.array([s[:3, 3] for s in steps]))
    assert np.allclose(poses[-1], truth[-1], atol=1e-10)
    assert np.allclose(poses[-1] @ inverse(poses[-1]), np.eye(4), atol=1e-12)
    assert np.array_equal(poses[-1][3], [0, 0, 0, 1])  # eq. 2.33 does not happen


def test_translations_that_were_not_measured_are_interpolated():
    t = np.stack([np.linspace(0, 0.001, 12), np.zeros(12), np.zeros(12)], 1)
    holes = t.copy()
    holes[[3, 4, 7]] = np.nan
    fixed, outlier = replace_outliers(holes, sigmas=20.0)
    assert outlier.nonzero()[0].tolist() == [3, 4, 7]
    assert np.allclose(fixed, t, atol=1e-12)
    nothing, all_out = replace_outliers(np.full((4, 3), np.nan))
    assert not nothing.any()
    assert all_out.all()
