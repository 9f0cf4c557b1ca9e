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

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.sim.tumble import TorqueFreeBody

INERTIA = np.array([1.0, 0.8, 0.5])
START = exp_so3(np.array([0.3, -0.5, 0.2]))
OMEGA = np.array([0.2, 0.5, -0.3])


@pytest.fixture(scope='module')
def body():
    return TorqueFreeBody(INERTIA, START, OMEGA, 60.0)


def test_energy_and_angular_momentum_stay(body):
    def momentum(t):
        return body.attitude(t) @ (INERTIA * body.rate(t))

    def energy(t):
        return 0.5 * INERTIA @ body.rate(t) ** 2

    for t in np.linspace(0, 60, 50):
        np.testing.assert_allclose(momentum(t), momentum(0.0), atol=1e-7)
        assert energy(t) == pytest.approx(energy(0.0), rel=1e-7)
    # and something did happen: the body rates changed a lot
    assert max(np.linalg.norm(body.rate(t) - OMEGA) for t in range(60)) > 0.3


def test_attitude_follows_the_rate(body):
    h = 1e-4
    for t in (1.0, 17.3, 42.0):
        step = body.attitude(t - h).T @ body.attitude(t + h)
        turned = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]]) / 2
        np.testing.assert_allclose(turned / (2 * h), body.rate(t), atol=1e-5)


def test_attitudes_are_rotations(body):
    for t in (0.0, 30.0, 60.0):
        R = body.attitude(t)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(body.attitude(0.0), START, atol=1e-12)


def test_spin_about_a_principal_axis_is_steady():
    body = TorqueFreeBody(INERTIA, np.eye(3), np.array([0.0, 0.0, 0.5]), 20.0)
    np.testing.assert_allclose(body.attitude(20.0), exp_so3(np.array([0, 0, 10.0])), atol=1e-8)


def test_impossible_bodies_and_times_are_refused(body):
    with pytest.raises(ValueError, match='principal moments'):
        TorqueFreeBody(np.array([1.0, 0.2, 0.2]), START, OMEGA, 1.0)
    with pytest.raises(ValueError, match=r'61\.0 s'):
        body.attitude(61.0)
