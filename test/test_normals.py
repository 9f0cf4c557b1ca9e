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

"""Normals and smoothed depth of the plane fit in disparity, against exactly known surfaces."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import CAMERA, plane_depth, rays, sphere_depth

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.normals import NormalSettings, fit_normals

SETTINGS = NormalSettings()


def angles(normals, true):
    return np.degrees(np.arccos(np.clip((normals * true).sum(-1), -1, 1)))


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(0.4, 1.0))
def test_planes_are_fitted_exactly(x, y, distance):
    normal = np.array([x, y, -1.0]) / np.linalg.norm([x, y, -1.0])
    camera = Camera(262.5, 262.5, 19.5, 19.5, 40, 40)
    depth = plane_depth(normal, distance, camera)
    # neighbours a jump away count as another surface, so steeper planes have no fit far from the sensor
    fitted, normals = fit_normals(depth, camera, NormalSettings(max_jump=0.2))
    inner = slice(6, -6)
    assert angles(normals, normal)[inner, inner].max() < 0.05
    np.testing.assert_allclose(fitted[inner, inner], depth[inner, inner], rtol=1e-5)


def test_sphere():
    centre, radius = np.array([0.02, -0.01, 0.6]), 0.1
    depth = sphere_depth(centre, radius)
    fitted, normals = fit_normals(depth, CAMERA, SETTINGS)
    points = rays() * depth[..., None]
    true = (points - centre) / radius
    facing = -(true * rays()).sum(-1) / np.linalg.norm(rays(), axis=-1)
    inner = (depth > 0) & (facing > 0.6)
    assert inner.sum() > 1500
    assert angles(normals, true)[inner].max() < 1.5
    assert np.abs(fitted - depth)[inner].max() < 3e-4


def test_normals_are_of_unit_length_and_face_the_sensor(recording):
    for target in recording.targets[::30]:
        fit = target.depth_fit > 0
        assert fit.sum() > 5000
        np.testing.assert_allclose(np.linalg.norm(target.normals[fit], axis=-1), 1, atol=1e-5)
        assert ((target.normals * rays(target.camera)).sum(-1)[fit] < 0).all()
        assert np.all(target.normals[~fit] == 0)


def test_noise_is_averaged_over_the_window():
    rng = np.random.default_rng(2)
    camera = Camera(525.0, 525.0, 79.5, 59.5, 160, 120)
    normal = np.array([0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, -1.0])
    depth = plane_depth(normal, 0.7, camera)
    # a Kinect's disparity: 1/8 px at 75 mm base line
    noisy = 1 / (1 / depth + rng.normal(scale=0.125 / (525 * 0.075), size=depth.shape))
    fitted, normals = fit_normals(noisy.astype(np.float32), camera, SETTINGS)
    inner = (slice(8, -8), slice(8, -8))
    assert np.median(angles(normals, normal)[inner]) < 4
    error = np.abs(fitted - depth)[inner]
    assert np.median(error) < 0.35 * np.median(np.abs(noisy - depth)[inner])


def test_a_step_in_depth_is_not_bridged():
    depth = np.full((60, 80), 0.6, np.float32)
    depth[:, 40:] = 0.6 + 2 * SETTINGS.max_jump
    camera = Camera(262.5, 262.5, 39.5, 29.5, 80, 60)
    fitted, normals = fit_normals(depth, camera, SETTINGS)
    np.testing.assert_allclose(fitted[depth > 0], depth[depth > 0], atol=1e-6)
    assert angles(normals, np.array([0, 0, -1.0])).max() < 0.05
    # below the jump the two sides are one slanted surface
    depth[:, 40:] = 0.6 + 0.5 * SETTINGS.max_jump
    assert angles(fit_normals(depth, camera, SETTINGS)[1], np.array([0, 0, -1.0])).max() > 10


@pytest.mark.parametrize('shape', ['pixel', 'line', 'nothing'])
def test_too_little_surface_has_no_fit(shape):
    depth = np.zeros((40, 40), np.float32)
    if shape == 'pixel':
        depth[20, 20] = 0.7
    elif shape == 'line':
        depth[20] = 0.7
    fitted, normals = fit_normals(depth, Camera(100, 100, 20, 20, 40, 40), SETTINGS)
    assert not fitted.any()
    assert not normals.any()


def test_input_is_left_as_it_was():
    depth = sphere_depth()
    before = depth.copy()
    fit_normals(depth, CAMERA, SETTINGS)
    np.testing.assert_array_equal(depth, before)
