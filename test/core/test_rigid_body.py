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

"""Torque-free motion against the simulator's own integration, and every body that can be."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from debris_scanner.core.geometry import exp_so3, rotation_angle
from debris_scanner.core.rigid_body import _rates_cost, fit_rates, inertia, principal, propagate, rates_of
from debris_scanner.sim.tumble import TorqueFreeBody

MOMENTS = np.array([1.0, 0.8, 0.5])
R_START = exp_so3(np.array([0.2, 0.5, -0.3]))
OMEGA = np.array([0.1, 0.45, 0.12])


def off_deg(found, truth):
    return max(np.degrees(rotation_angle(a.T @ np.asarray(b))) for a, b in zip(found, truth, strict=True))


@pytest.mark.parametrize('interval_s', [0.1, 1.0])
def test_it_turns_as_the_simulator_integrates_it(interval_s):
    seconds = np.arange(interval_s, 60.0, interval_s)
    body = TorqueFreeBody(MOMENTS, R_START, OMEGA, 60.0)
    found, rates = propagate(R_START, OMEGA, np.diag(MOMENTS), seconds)
    assert off_deg(found, [body.attitude(t) for t in seconds]) < 1e-3
    energy = np.einsum('ni,i,ni->n', rates, MOMENTS, rates)
    np.testing.assert_allclose(energy, OMEGA @ (MOMENTS * OMEGA), rtol=1e-6)
    momentum = np.einsum('nij,nj->ni', found, rates * MOMENTS)
    np.testing.assert_allclose(momentum, np.tile(R_START @ (MOMENTS * OMEGA), (len(seconds), 1)), atol=1e-6)


def test_backwards_it_comes_from_where_it_was():
    J = np.diag(MOMENTS)
    there, rates = propagate(R_START, OMEGA, J, np.array([10.0, 30.0]))
    back, rate = propagate(there[-1], rates[-1], J, np.array([-20.0, -30.0]))
    assert off_deg(back, [there[0], R_START]) < 1e-3
    np.testing.assert_allclose(rate[-1], OMEGA, atol=1e-6)


BODY = np.array([0.3, 0.2, -0.2, 0.1, 0.1, 0.1, -0.05, 0.3])


def passed(seconds):
    """Attitudes R_target_sensor that BODY passes."""
    J = inertia(BODY[:5])
    found, _ = propagate(R_START, np.linalg.solve(J, R_START.T @ BODY[5:]), J, seconds)
    return found.transpose(0, 2, 1)


@pytest.mark.parametrize('damping', [(), (0.02,)])
def test_the_gradient_of_the_rates_cost_is_its_differences(damping):
    R, t = np.ascontiguousarray(passed(np.arange(0.0, 10.0, 0.5))), np.arange(-10.0, 0.0, 0.5)
    rates = rates_of(BODY, R) + np.random.default_rng(3).normal(0, 0.05, (len(R), 3))
    body, step = np.append(BODY + 0.1, damping), 1e-6
    given = R, rates, np.linspace(3.0, 9.0, len(R)), t, np.linspace(0.1, 1.0, len(body))
    _, H, g = _rates_cost(*given, body)
    ends = [[_rates_cost(*given, body + d * sign) for sign in (1, -1)] for d in step * np.eye(len(body))]
    np.testing.assert_allclose(g, [(a[0] - b[0]) / (2 * step) for a, b in ends], atol=1e-6)
    assert np.linalg.eigvalsh(H)[0] > 0


def test_a_body_of_rates_is_as_scipy_finds_it():
    R = passed(np.arange(0.0, 40.0, 0.5))
    rates = rates_of(BODY, R) + np.random.default_rng(4).normal(0, 0.02, (len(R), 3))
    found, scale = fit_rates(R, rates, np.ones(len(R))), np.std(rates, axis=0).max()

    def residuals(body):
        return np.append((rates - rates_of(body, R)) / scale, body[:5])

    best = scipy.optimize.least_squares(residuals, found.body + 0.05, loss='soft_l1', xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(found.body, best.x, atol=1e-4)
    assert found.cost == pytest.approx(best.cost, rel=1e-9)
    np.testing.assert_allclose(found.information, best.jac.T @ best.jac, rtol=0.01, atol=0.01)


def test_a_body_is_found_from_rates_with_some_wrong():
    R = passed(np.arange(0.0, 60.0, 0.5))
    rates = rates_of(BODY, R) + np.random.default_rng(3).normal(0, 1e-3, (len(R), 3))
    rates[7] += 0.3
    found = fit_rates(R, rates, np.ones(len(R)))
    np.testing.assert_allclose(found.body, BODY, atol=0.01)


def test_a_falling_momentum_is_found_with_its_body():
    seconds = np.arange(-60.0, 0.0, 0.5)
    J, slowed = inertia(BODY[:5]), -np.expm1(-0.01 * seconds) / 0.01
    found, _ = propagate(R_START, np.linalg.solve(J, R_START.T @ BODY[5:]), J, slowed)
    R = found.transpose(0, 2, 1)
    rates = np.exp(-0.01 * seconds)[:, None] * rates_of(BODY, R)
    body = fit_rates(R, rates, np.ones(len(R)), seconds).body
    np.testing.assert_allclose(body, np.append(BODY, 0.01), atol=0.02)


def test_a_sphere_and_a_resting_body():
    np.testing.assert_allclose(inertia(np.zeros(5)), np.eye(3) * 2 / 3)
    found, rates = propagate(R_START, OMEGA, np.eye(3), np.array([2.0]))
    np.testing.assert_allclose(found[0], R_START @ exp_so3(2.0 * OMEGA), atol=1e-12)
    found, rates = propagate(R_START, np.zeros(3), np.diag(MOMENTS), np.array([5.0]))
    np.testing.assert_array_equal(found[0], R_START)
    assert not rates.any()


@settings(deadline=None)  # a kernel may be compiled meanwhile
@given(st.lists(st.floats(-2.5, 2.5), min_size=5, max_size=5))
def test_all_numbers_are_bodies(shape):
    J = inertia(np.array(shape))
    moments, axes = principal(J)
    assert np.trace(J) == pytest.approx(2.0)
    assert moments[0] > 0 and moments[0] + moments[1] >= moments[2] - 1e-12
    assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, J, atol=1e-9)
