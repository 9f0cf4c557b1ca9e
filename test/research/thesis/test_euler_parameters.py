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

"""Euler parameters, their derivatives, and the rate of two aligned frames."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.research.thesis.euler_parameters import (
    angular_rate,
    left_matrix,
    of_rate,
    of_rotation,
    rate_jacobian,
    reversed_rotation,
    right_matrix,
    rotation_matrix,
    rotation_vector,
)

RNG = np.random.default_rng(11)


def test_scalar_comes_first():
    beta = of_rotation(exp_so3(np.array([0, 0, 0.6])))
    assert np.allclose(beta, [np.cos(0.3), 0, 0, np.sin(0.3)])


def test_negated_scalar_part_is_the_opposite_rotation():
    # Erratum 6: minus the conjugate. Taken literally its angle would be 2 pi - 0.3.
    R = exp_so3(np.array([0.1, 0.2, -0.2]))
    backwards = reversed_rotation(of_rotation(R))
    assert np.allclose(rotation_matrix(backwards), R.T)
    assert np.allclose(rotation_vector(backwards), [-0.1, -0.2, 0.2])


def test_both_signs_of_the_parameters_are_one_rotation():
    beta = of_rotation(exp_so3(np.array([1.0, -2.0, 0.5])))
    assert beta[0] >= 0
    assert np.allclose(rotation_vector(beta), [1.0, -2.0, 0.5])
    assert np.allclose(rotation_vector(-beta), [1.0, -2.0, 0.5])


def test_products_are_those_of_the_rotations():
    a, b = exp_so3(RNG.normal(size=3)), exp_so3(RNG.normal(size=3))
    beta, gamma = of_rotation(a), of_rotation(b)
    assert np.allclose(rotation_matrix(left_matrix(beta) @ gamma), a @ b)
    assert np.allclose(left_matrix(beta) @ gamma, right_matrix(gamma) @ beta)


@pytest.mark.parametrize('rate', [0.0, 1e-9, 0.3, 3.0])
def test_constant_rate_and_its_derivatives(rate):
    omega, t = rate * np.array([0.6, -0.64, 0.48]), 1.7
    assert np.allclose(rotation_matrix(of_rate(omega, t)), exp_so3(omega * t))
    step = 1e-6
    for k, e in enumerate(np.eye(3)):
        numeric = (of_rate(omega + step * e, t) - of_rate(omega - step * e, t)) / (2 * step)
        assert np.allclose(rate_jacobian(omega, t)[:, k], numeric, atol=1e-8)


@pytest.mark.parametrize('seed', range(20))
def test_a_constant_rate_is_recovered_from_attitudes_at_any_time(seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    omega = axis / np.linalg.norm(axis) * rng.uniform(0.01, 3.0)
    dt = rng.uniform(0.03, 1.0)
    for k in range(0, 60, 7):  # several turns, so that the attitudes themselves wrap
        before, after = exp_so3(omega * dt * k), exp_so3(omega * dt * (k + 1))  # R_sensor_target
        R_previous_current = before @ after.T
        assert np.allclose(angular_rate(R_previous_current, dt), omega, atol=1e-10)


@pytest.mark.parametrize('angle', [1e-13, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7])
def test_no_digit_is_lost_at_small_angles_nor_near_half_a_turn(angle):
    omega = np.array([0.0, -angle, 0.0])
    assert np.allclose(angular_rate(exp_so3(-omega), 1.0), omega, rtol=1e-8, atol=0)


def test_beyond_half_a_turn_the_shorter_way_is_seen():
    rate = angular_rate(exp_so3(np.array([0.0, -(np.pi + 0.2), 0.0])), 1.0)
    assert np.allclose(rate, [0, -(np.pi - 0.2), 0])


def test_time_must_pass():
    with pytest.raises(ValueError, match='apart in time'):
        angular_rate(np.eye(3), 0.0)
