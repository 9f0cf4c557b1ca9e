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

"""Pinhole camera: there and back, and finding the camera behind a cloud."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from debris_scanner.core.camera import VIRTUAL_CAMERA, Camera, fit_pinhole, rasterise, virtual_camera

CAMERA = Camera(100.0, 110.0, 31.5, 23.0, 64, 48)


def scene(camera, seed=0, hole=0.2):
    """Depth (h, w) of a tilted plane with random holes."""
    v, u = np.mgrid[: camera.height, : camera.width]
    depth = (0.8 + 0.002 * u - 0.001 * v).astype(np.float32)
    depth[np.random.default_rng(seed).random(depth.shape) < hole] = 0
    return depth


def test_a_pixel_looks_along_its_ray():
    points = CAMERA.back_project(np.full((48, 64), 2.0, np.float32))
    np.testing.assert_allclose(points[10, 20], [2 * (20 - 31.5) / 100, 2 * (10 - 23) / 110, 2], rtol=1e-6)


@pytest.mark.parametrize('focal', [0.0, -525.0, float('nan'), float('inf')])
def test_a_camera_without_a_focal_length_is_refused_by_its_values(focal):
    for fx, fy in ((focal, 525.0), (525.0, focal)):
        with pytest.raises(ValueError, match=f'fx {fx:g}, fy {fy:g} px'):
            Camera(fx, fy, 319.5, 239.5, 640, 480)


def test_pixels_without_depth_are_nan():
    depth = scene(CAMERA)
    points = CAMERA.back_project(depth)
    assert points.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(points).all(axis=-1), depth == 0)


@pytest.mark.parametrize('window', [(5, 7, 30, 20), (-4, -6, 80, 60)])
def test_a_window_sees_the_same_points(window):
    u0, v0, width, height = window
    depth = scene(CAMERA, hole=0)
    cropped = CAMERA.crop(u0, v0, width, height)
    assert (cropped.width, cropped.height) == (width, height)
    seen = np.zeros((height, width), np.float32)
    v, u = np.nonzero(depth)
    inside = (u >= u0) & (v >= v0) & (u < u0 + width) & (v < v0 + height)
    seen[v[inside] - v0, u[inside] - u0] = depth[v[inside], u[inside]]
    points, whole = cropped.back_project(seen), CAMERA.back_project(depth)
    np.testing.assert_allclose(points[v[inside] - v0, u[inside] - u0], whole[v[inside], u[inside]], atol=1e-6)


@given(st.floats(50, 900), st.floats(50, 900), st.floats(0, 63), st.floats(0, 47), st.integers(0, 99))
def test_the_camera_behind_a_cloud_is_found(fx, fy, cx, cy, seed):
    camera = Camera(fx, fy, cx, cy, 64, 48)
    found = fit_pinhole(camera.back_project(scene(camera, seed)))
    assert (found.width, found.height) == (64, 48)
    np.testing.assert_allclose(
        [found.fx, found.fy, found.cx, found.cy], [fx, fy, cx, cy], rtol=1e-4, atol=1e-2
    )


def test_clouds_of_no_pinhole_camera_are_refused():
    rng = np.random.default_rng(1)
    azimuth, elevation = np.meshgrid(np.linspace(-1.2, 1.2, 200), np.linspace(-0.3, 0.3, 16))
    r = rng.uniform(2, 5, azimuth.shape)
    lidar = np.stack(
        [
            r * np.sin(azimuth) * np.cos(elevation),
            r * np.sin(elevation),
            r * np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    assert fit_pinhole(lidar.astype(np.float32)) is None
    assert fit_pinhole(rng.uniform(0.5, 1, (48, 64, 3)).astype(np.float32)) is None  # shuffled
    assert fit_pinhole(rng.uniform(0.5, 1, (1, 3000, 3)).astype(np.float32)) is None  # unorganised
    assert fit_pinhole(np.full((48, 64, 3), np.nan, np.float32)) is None


def test_rasterising_undoes_back_projection():
    depth = scene(CAMERA)
    cloud = CAMERA.back_project(depth).reshape(-1, 3)
    shuffled = np.random.default_rng(2).permutation(cloud)
    np.testing.assert_allclose(rasterise(shuffled, CAMERA), depth, atol=1e-6)


def test_the_nearest_point_wins_and_the_invisible_is_left_out():
    ray = np.array([0.085, 0.0, 1.0], np.float32)  # pixel (23, 40)
    behind = np.array([0.0, 0.0, -1.0], np.float32)
    outside = np.array([5.0, 0.0, 1.0], np.float32)
    infinite = np.array([0.0, 0.0, np.inf], np.float32)
    depth = rasterise(np.stack([2 * ray, ray, 3 * ray, behind, outside, infinite]), CAMERA)
    assert depth[23, 40] == 1.0
    assert np.count_nonzero(depth) == 1


def lidar_grid(step_deg, distance=8.0):
    """Points (n, 3) of a regular grid of angles on a wall."""
    angle = np.radians(np.arange(-20, 20, step_deg))
    azimuth, elevation = np.meshgrid(angle, angle)
    ray = np.stack([np.tan(azimuth), np.tan(elevation) / np.cos(azimuth), np.ones_like(azimuth)], axis=-1)
    return (distance * ray.reshape(-1, 3)).astype(np.float32)


@pytest.mark.parametrize('step_deg', [0.1, 0.18, 0.4])
def test_the_virtual_camera_is_as_fine_as_the_cloud(step_deg):
    points = lidar_grid(step_deg)
    camera = virtual_camera(points)
    pixels = camera.focal * np.radians(step_deg)
    assert 0.6 < pixels < 1.15  # a point a pixel, hardly a hole
    seen = rasterise(points, camera) > 0
    v, u = np.nonzero(seen)
    assert seen[v.min() + 2 : v.max() - 1, u.min() + 2 : u.max() - 1].mean() > 0.9


def test_noise_does_not_change_the_virtual_camera():
    points = lidar_grid(0.18)
    noise = np.random.default_rng(0).normal(1, 0.002, (len(points), 1)).astype(np.float32)
    assert virtual_camera(points * noise) == virtual_camera(points)


def test_few_points_are_seen_by_a_kinects_camera():
    assert virtual_camera(lidar_grid(0.18)[:50]) == VIRTUAL_CAMERA
