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

"""The extended Kalman filter: derivatives, gates, consistency."""

import numpy as np
import pytest
from scipy.special import chdtri

from debris_scanner.core.geometry import exp_so3, log_so3, rotation_angle
from debris_scanner.core.parameters import ParameterError
from debris_scanner.research.thesis.attitude_ekf import AttitudeEkf, EkfSettings, process_noise, run
from debris_scanner.research.thesis.euler_parameters import (
    RateObservation,
    left_matrix,
    of_rate,
    right_matrix,
)

OMEGA = np.array([0.0, -0.65, 0.0])
DT_NS = 200_000_000
FITNESS = 2.5e-6  # m²; what a Kinect's clouds leave over at 0.7 m


def observe(rates, fitness=FITNESS):
    return [RateObservation((k + 1) * DT_NS, w, fitness) for k, w in enumerate(rates)]


def settings(**changes):
    base = {'prior_state': (1.0, 0, 0, 0, 0, 0, 0), 'gate_sigma': 0.0}
    return EkfSettings(**base | changes)


def test_constant_rate_is_estimated_and_integrated():
    steps = run(0, observe([OMEGA] * 100), settings(propagation='exact'))
    assert np.allclose(steps[-1].omega, OMEGA, atol=1e-6)
    # the first frame is predicted with the prior rate: a lag of one step stays in the attitude
    lag = log_so3(exp_so3(OMEGA * 20.0).T @ steps[-1].R_sensor_target)
    assert np.linalg.norm(lag) < 0.65 * 0.2 + 1e-3
    assert abs(np.linalg.norm(steps[-1].state[:4]) - 1) < 1e-12


def test_sign_error_in_the_prior_is_overcome_in_two_seconds():
    # Section 4.2: 143 % off, with noise as frame-to-frame alignment has it
    rng = np.random.default_rng(2)
    rates = OMEGA + 0.03 * rng.normal(size=(40, 3))
    config = EkfSettings()  # Table 4.1 with the gate of section 4.3
    assert config.prior_state[5] == 0.2795
    steps = run(0, observe(rates), config)
    assert abs(0.2795 - OMEGA[1]) / 0.65 == pytest.approx(1.43, abs=0.01)
    after = [abs(s.omega[1] - OMEGA[1]) for s in steps if s.stamp_ns >= 2_000_000_000]
    assert max(after) < 0.15


def test_an_outlier_is_gated_and_without_the_gate_it_enters():
    rates = [OMEGA] * 60
    rates[27] = np.array([0.0, 1.2, 0.0])
    gated = run(0, observe(rates), settings(gate_sigma=2.0))
    assert [k for k, s in enumerate(gated) if not s.accepted] == [27]
    assert np.allclose(gated[27].omega, OMEGA, atol=0.01)
    assert gated[27].residual[1] == pytest.approx(1.85, abs=0.01)
    open_ = run(0, observe(rates), settings())
    assert all(s.accepted for s in open_)
    assert open_[27].omega[1] > 1.0


def test_gate_has_the_width_asked_for():
    # Rate variance at the first observation: the prior's 1 plus sigma_u² dt plus d_k.
    s = np.sqrt(1 + 0.1 * 0.2 + FITNESS)
    for gate in (1.0, 2.0, 3.0):
        for factor, accepted in ((0.99, True), (1.01, False)):
            step = AttitudeEkf(0, settings(gate_sigma=gate)).step(
                RateObservation(DT_NS, np.array([0, 0, gate * factor * s]), FITNESS)
            )
            assert step.accepted is accepted


def test_a_gap_widens_the_uncertainty_and_is_recovered_from():
    before = [RateObservation((k + 1) * DT_NS, OMEGA, FITNESS) for k in range(20)]
    slower = OMEGA * 0.5
    blind = RateObservation(before[-1].stamp_ns + 3_000_000_000, None, FITNESS)
    after = [RateObservation(blind.stamp_ns + (k + 1) * DT_NS, slower, FITNESS) for k in range(20)]
    steps = run(0, [*before, blind, *after], settings(gate_sigma=2.0, propagation='exact'))
    gap = steps[20]
    assert not gap.accepted
    assert gap.innovation is None
    assert gap.residual is None
    assert gap.three_sigma[1] == pytest.approx(3 * np.sqrt(0.1 * 3.0), rel=0.01)  # sigma_u² dt dominates
    assert all(s.accepted for s in steps[21:])
    assert np.allclose(steps[-1].omega, slower, atol=1e-3)
    turned = rotation_angle(steps[19].R_sensor_target.T @ gap.R_sensor_target)
    assert turned == pytest.approx(0.65 * 3, abs=1e-3)  # dead reckoning through the gap


def test_missing_alignment_is_no_observation():
    steps = run(0, observe([OMEGA, None, OMEGA]), settings())
    assert [s.accepted for s in steps] == [True, False, True]
    assert steps[1].three_sigma[0] > steps[0].three_sigma[0]
    assert steps[1].innovation is None


@pytest.mark.parametrize('axes', ['body', 'sensor'])
@pytest.mark.parametrize('propagation', ['euler', 'exact'])
def test_transition_is_the_derivative_of_the_propagation(axes, propagation):
    config = settings(
        prior_state=(0.8, 0.2, -0.4, 0.4, 0.3, -0.5, 0.2), rate_axes=axes, propagation=propagation
    )
    dt, h = 0.2, 1e-6

    def raw(x):
        """Propagated Euler parameters before renormalisation, as the transition is documented."""
        product, omega = np.array(x[:4]), np.array(x[4:])
        matrix = left_matrix(product) if axes == 'body' else right_matrix(product)
        if propagation == 'euler':
            return np.concatenate([product + 0.5 * dt * matrix @ [0, *omega], omega])
        return np.concatenate([matrix @ of_rate(omega, dt), omega])

    ekf = AttitudeEkf(0, config)
    x = ekf.state.copy()
    numeric = np.stack([(raw(x + h * e) - raw(x - h * e)) / (2 * h) for e in np.eye(7)], 1)
    assert np.allclose(ekf.transition(dt), numeric, atol=1e-8)
    step = ekf.step(RateObservation(DT_NS, None, 0.0))
    expected = raw(x)[:4]
    assert np.allclose(step.state[:4], expected / np.linalg.norm(expected))


def test_forward_euler_lags_by_the_arctangent():
    wanted = 0.65 * 0.2
    config = settings(prior_state=(1.0, 0, 0, 0, 0, -0.65, 0))
    step = AttitudeEkf(0, config).step(RateObservation(DT_NS, None, 0.0))
    assert rotation_angle(step.R_sensor_target) == pytest.approx(2 * np.arctan(wanted / 2), abs=1e-12)


def test_rate_axes_agree_on_one_fixed_axis_and_only_sensor_axes_follow_a_moving_one():
    def attitude(axes, omegas):
        config = settings(rate_axes=axes, propagation='exact')
        ekf = AttitudeEkf(0, config)
        for k, w in enumerate(omegas):
            ekf.state[4:] = w  # a perfect rate for the coming step
            step = ekf.step(RateObservation((k + 1) * DT_NS, None, 0.0))
        return step.R_sensor_target

    fixed = [OMEGA] * 50
    assert np.allclose(attitude('body', fixed), attitude('sensor', fixed))
    moving = [exp_so3(np.array([0, 0, 0.05 * k])) @ OMEGA for k in range(50)]
    truth = np.eye(3)
    for w in moving:
        truth = exp_so3(w * 0.2) @ truth
    assert np.allclose(attitude('sensor', moving), truth, atol=1e-9)
    assert rotation_angle(attitude('body', moving).T @ truth) > 0.5


def test_process_noise_as_printed():
    Q = process_noise(0.2, 3e-6, 0.5)
    assert np.allclose(np.diag(Q)[:4], 3e-6 * 0.2 + 0.5 * 0.2**3 / 3)  # padded to the scalar, as printed
    assert np.allclose(np.diag(Q)[4:], 0.5 * 0.2)
    assert np.allclose(np.diag(Q[1:4, 4:]), 0.5 * 0.5 * 0.2**2)
    assert np.array_equal(Q, Q.T)
    assert np.count_nonzero(Q) == 13
    assert np.linalg.eigvalsh(Q).min() > 0


def test_rate_covariance_is_consistent_where_the_model_is_exact():
    """NEES and NIS over 200 runs: a rate that wanders as sigma_u² says, observed with variance d_k."""
    runs, frames, sigma_u2, fitness = 200, 40, 0.02, 4e-3
    rng = np.random.default_rng(17)
    config = settings(sigma_u2=sigma_u2)
    nees, nis = np.zeros((runs, frames)), np.zeros((runs, frames))
    for r in range(runs):
        omega = rng.normal(size=3)  # as the prior: mean 0, variance 1
        truth, rates = [], []
        for _ in range(frames):
            omega = omega + np.sqrt(sigma_u2 * 0.2) * rng.normal(size=3)
            truth.append(omega)
            rates.append(omega + np.sqrt(fitness) * rng.normal(size=3))
        for k, step in enumerate(run(0, observe(rates, fitness), config)):
            error = step.omega - truth[k]
            nees[r, k] = error @ np.linalg.solve(step.covariance[4:, 4:], error)
            nis[r, k] = step.innovation @ np.linalg.solve(step.innovation_covariance, step.innovation)
    low, high = chdtri(3 * runs, [1 - 5e-4, 5e-4]) / runs
    for k in (0, 1, 5, 20, 39):
        assert low < nees[:, k].mean() < high
        assert low < nis[:, k].mean() < high
    # innovations of an exact filter are white, so their sum over all frames is chi-square as well
    low, high = chdtri(3 * runs * frames, [1 - 5e-4, 5e-4]) / (runs * frames)
    assert low < nis.mean() < high


def test_unusable_settings_and_order_are_refused():
    with pytest.raises(ParameterError, match='propagation'):
        settings(propagation='runge')
    with pytest.raises(ParameterError, match='rate_axes'):
        settings(rate_axes='north')
    with pytest.raises(ParameterError, match='no attitude'):  # erratum 1
        settings(prior_state=(0.0, 0, 0, 0, 0, 1, 0))
    with pytest.raises(ValueError, match='not later'):
        AttitudeEkf(DT_NS, settings()).step(RateObservation(DT_NS, OMEGA, 1e-6))
