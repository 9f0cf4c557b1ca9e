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

"""Rotations and rigid transforms: defining properties over random motions.

The compiled kernels are compared with scipy, also where formulas break down.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from debris_scanner.core.geometry import (
    apply,
    compose,
    exp_se3,
    exp_so3,
    exponential,
    from_pose_vector,
    from_quaternion,
    hat,
    inverse,
    log_so3,
    logarithm,
    nearest_rotation,
    project_so3,
    rotation_angle,
    sphere_directions,
    to_pose_vector,
    to_quaternion,
    transform,
)

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


vectors = arrays(np.float64, 3, elements=st.floats(-1.7, 1.7))  # shorter than pi: the logarithm is unique
twists = arrays(np.float64, 6, elements=st.floats(-1.7, 1.7))


@given(vectors, vectors)
def test_hat_is_the_cross_product(v, x):
    np.testing.assert_allclose(hat(v) @ x, np.cross(v, x), atol=1e-12)


@given(vectors)
def test_logarithm_undoes_exponential(v):
    np.testing.assert_allclose(log_so3(exp_so3(v)), v, atol=1e-9)
    assert rotation_angle(exp_so3(v)) == pytest.approx(np.linalg.norm(v), abs=1e-9)


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(exp_so3(np.array([0, 0, np.pi / 2])) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@given(vectors)
def test_quaternion_round_trip_has_its_scalar_last_and_not_negative(v):
    q = to_quaternion(exp_so3(v))
    assert q[3] >= 0
    np.testing.assert_allclose(q[3], np.cos(np.linalg.norm(v) / 2), atol=1e-12)
    np.testing.assert_allclose(from_quaternion(3 * q), exp_so3(v), atol=1e-12)


@given(vectors, st.floats(0.9, 1.1), st.floats(0.9, 1.1))
def test_projection_takes_the_stretch_out_of_a_rotation(v, a, b):
    R = exp_so3(v)
    np.testing.assert_allclose(project_so3(R @ np.diag([1.0, a, b])), R, atol=1e-9)


@given(arrays(np.float64, (3, 3), elements=st.floats(-5, 5)))
def test_projection_is_a_rotation_even_of_a_reflection(M):
    R = project_so3(M)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1, abs=1e-9)


@given(twists, vectors)
def test_inverse_maps_points_back(twist, x):
    T = exp_se3(twist)
    np.testing.assert_allclose(apply(inverse(T), apply(T, x)), x, atol=1e-9)
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-9)


@given(twists)
def test_twist_is_rotation_then_translation(twist):
    T = exp_se3(twist)
    np.testing.assert_array_equal(T, transform(exp_so3(twist[:3]), twist[3:]))
    np.testing.assert_array_equal(T[:3, 3], twist[3:])


@given(twists, twists, vectors)
def test_composition_applies_the_last_first(a, b, x):
    A, B = exp_se3(a), exp_se3(b)
    np.testing.assert_allclose(apply(compose(A, B), x), apply(A, apply(B, x)), atol=1e-9)


def test_a_long_chain_stays_rigid():
    step = exp_se3(np.array([0.3, -0.2, 0.1, 0.01, 0.0, 0.0]))
    step[:3, :3] *= 1 + 1e-6  # as a float32 estimate would be
    T = np.eye(4)
    for _ in range(1000):
        T = compose(T, step)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(T[3], [0, 0, 0, 1])


def test_apply_keeps_the_shape_of_organised_clouds():
    T = exp_se3(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    cloud = np.random.default_rng(0).uniform(-1, 1, (4, 5, 3)).astype(np.float32)
    moved = apply(T, cloud)
    assert moved.shape == cloud.shape
    np.testing.assert_allclose(moved[2, 3], T[:3, :3] @ cloud[2, 3] + T[:3, 3], atol=1e-6)


@given(arrays(np.float64, 6, elements=st.floats(-3, 3)))
def test_a_pose_in_seven_numbers_comes_back(twist):
    T = exp_se3(twist)
    v = to_pose_vector(T)
    assert v.shape == (7,) and v[6] >= 0
    np.testing.assert_allclose(from_pose_vector(v), T, atol=1e-14)


@pytest.mark.parametrize(
    ('numbers', 'said'),
    [
        ([1, 2, 3], '7 numbers, not 3'),
        ([0, 0, 0, 0, 0, 0, 0], 'unit length'),
        ([0, np.inf, 0, 0, 0, 0, 1], 'not finite'),
    ],
)
def test_seven_numbers_that_are_no_pose(numbers, said):
    with pytest.raises(ValueError, match=said):
        from_pose_vector(np.array(numbers, float))


def test_directions_are_spread_evenly():
    found = sphere_directions(200)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    assert np.linalg.norm(found.mean(axis=0)) < 0.01
    cosines = found @ found.T - 2 * np.eye(200)
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    assert nearest.min() > 10 and nearest.max() < 16  # 200 caps of 8 degrees cover a sphere
