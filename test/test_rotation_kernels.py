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

"""The compiled rotations against scipy's, near and at the places where formulas break down."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from debris_scanner.core.geometry import exponential, logarithm, nearest_rotation

directions = arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 0.1)
angles = st.one_of(st.floats(0, np.pi), st.sampled_from([0.0, 1e-12, 1e-6, 1e-4, 1.01e-4, np.pi - 1e-9]))


@given(directions, angles)
def test_exponential_and_logarithm_are_scipys(direction, angle):
    v = direction / np.linalg.norm(direction) * angle
    R = Rotation.from_rotvec(v).as_matrix()
    np.testing.assert_allclose(exponential(v), R, atol=1e-14)
    np.testing.assert_allclose(exponential(logarithm(R)), R, atol=1e-14)
    assert np.linalg.norm(logarithm(R)) == pytest.approx(angle, abs=1e-12)


@pytest.mark.parametrize('axis', np.eye(3))
def test_half_a_turn_has_a_logarithm(axis):
    R = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(np.abs(logarithm(R)), np.pi * axis, atol=1e-15)


@given(directions, angles, arrays(np.float64, (3, 3), elements=st.floats(-0.1, 0.1)))
def test_nearest_rotation_is_that_of_the_singular_values(direction, angle, error):
    M = Rotation.from_rotvec(direction * angle).as_matrix() + error
    R, found = nearest_rotation(M)
    U, _, Vt = np.linalg.svd(M)
    assert found
    np.testing.assert_allclose(R, U @ Vt, atol=1e-13)


def test_a_reflection_has_none():
    assert not nearest_rotation(np.diag([1.0, 1.0, -1.0]))[1]
    assert not nearest_rotation(np.zeros((3, 3)))[1]
    assert not nearest_rotation(np.full((3, 3), np.nan))[1]
