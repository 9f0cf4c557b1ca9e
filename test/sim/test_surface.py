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

from debris_scanner.sim.shapes import box, lathe
from debris_scanner.sim.surface import Surface, corner_normals, distance_to_triangles


def test_rays_and_distances_of_a_cube():
    cube = Surface(*box((2, 2, 2)))
    depth, normals = cube.cast(
        np.array([0, 0, -3], np.float32), np.array([[[0, 0, 1], [0, 0, 2], [1, 0, 0]]], np.float32)
    )
    np.testing.assert_allclose(depth, [[2, 1, np.inf]])
    np.testing.assert_allclose(normals[0, 0], [0, 0, -1])
    points = np.array([[0, 0, 0], [0, 0, 1.5], [2, 2, 1], [1, 1, 1]])
    np.testing.assert_allclose(cube.distance(points), [1, 0.5, np.sqrt(2), 0], atol=1e-6)


def test_distances_to_triangles_agree_with_a_dense_sampling():
    rng = np.random.default_rng(0)
    corners, points = rng.normal(size=(40, 3, 3)), 1.5 * rng.normal(size=(40, 3))
    a, b = np.meshgrid(np.linspace(0, 1, 200), np.linspace(0, 1, 200))
    a, b = a[a + b <= 1], b[a + b <= 1]
    weights = np.stack([a, b, 1 - a - b], axis=1)
    brute = np.linalg.norm(weights @ corners - points[:, None], axis=2).min(axis=1)
    found = distance_to_triangles(points, corners)
    assert np.all(found <= brute + 1e-12)
    np.testing.assert_allclose(found, brute, atol=0.02)


def test_a_triangle_without_area_is_a_segment():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], float)
    np.testing.assert_allclose(distance_to_triangles(np.array([[1.5, 1.0, 0.0]]), corners), [1.0])


def test_long_thin_triangles_are_measured_exactly():
    length, angle = 0.3, np.linspace(0, 2 * np.pi, 257)[:-1]
    ring = 0.09 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, high = (np.column_stack([ring, np.full(256, z)]) for z in (0, length))
    k = np.arange(256)
    triangles = np.concatenate([np.stack([k, (k + 1) % 256, k + 256], axis=1)])
    tube = Surface(np.concatenate([low, high]), triangles)
    on_it = (low + np.roll(low, -1, axis=0) + 2 * high) / 4
    assert tube.distance(on_it).max() < 1e-8


def test_a_curved_surface_is_smooth_and_a_crease_is_kept():
    vertices, triangles = lathe([(0.0, -0.1), (0.05, -0.1), (0.05, 0.1), (0.0, 0.1)], 24)
    corners = vertices[triangles].astype(float)
    normals = corner_normals(corners)
    side = np.ptp(corners[..., 2], axis=1) > 1e-4
    radial = corners[side].copy()
    radial[..., 2] = 0
    radial /= np.linalg.norm(radial, axis=-1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((normals[side] * radial).sum(-1), -1, 1))).max() < 4
    assert np.abs(normals[~side][..., :2]).max() < 1e-6
