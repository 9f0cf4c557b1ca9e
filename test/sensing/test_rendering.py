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

"""A mesh as a camera sees it, against what geometry says."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.sensing.rendering import MeshImages
from debris_scanner.sim.shapes import box, sphere

CAMERA = Camera(200.0, 200.0, 49.5, 39.5, 100, 80)


def test_a_sphere_has_the_depth_and_the_normals_of_a_sphere():
    vertices, triangles = sphere(4)
    vertices = 0.1 * vertices
    frame = MeshImages(vertices, triangles).frame(CAMERA, transform(np.eye(3), np.array([0.0, 0.0, 0.8])), 7)
    assert frame.stamp_ns == 7
    points = CAMERA.back_project(frame.depth)[frame.depth > 0]
    np.testing.assert_allclose(np.linalg.norm(points - [0, 0, 0.8], axis=1), 0.1, atol=5e-4)
    outward = (points - [0, 0, 0.8]) / 0.1
    assert (frame.normals[frame.depth > 0] * outward).sum(axis=1).min() > 0.99
    assert (frame.normals[frame.depth == 0] == 0).all()
    radius_px = np.sqrt(np.count_nonzero(frame.depth) / np.pi)
    assert radius_px == pytest.approx(200 * 0.1 / np.sqrt(0.8**2 - 0.1**2), abs=0.5)


def test_a_pose_moves_the_mesh():
    vertices, triangles = box((0.1, 0.1, 0.1))
    R = exp_so3(np.array([0.0, np.pi / 4, 0.0]))
    frame = MeshImages(vertices, triangles).frame(CAMERA, transform(R, np.array([0.05, 0.0, 1.0])))
    v, u = np.unravel_index(np.argmin(np.where(frame.depth > 0, frame.depth, 9)), frame.depth.shape)
    assert frame.depth[v, u] == pytest.approx(1 - 0.05 * np.sqrt(2), abs=2e-3)
    assert (u - CAMERA.cx) / CAMERA.fx == pytest.approx(0.05 / 0.93, abs=0.01)


def test_what_fills_a_gap_and_what_is_seen_from_inside_is_no_surface():
    vertices, triangles = box((0.1, 0.1, 0.1))
    facing = np.cross(
        vertices[triangles][:, 1] - vertices[triangles][:, 0],
        vertices[triangles][:, 2] - vertices[triangles][:, 0],
    )
    front = facing[:, 2] < -1e-9  # towards a camera on the -z side
    T = transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    whole = MeshImages(vertices, triangles).frame(CAMERA, T)
    assert whole.depth_fit.any()
    for images in (MeshImages(vertices, triangles, ~front), MeshImages(vertices, triangles[~front])):
        frame = images.frame(CAMERA, T)
        assert not frame.depth_fit.any() and not frame.normals.any()
        np.testing.assert_array_equal(frame.depth > 0, whole.depth > 0)


def test_colours_of_vertices_are_seen():
    vertices, triangles = sphere(4)
    rgb = np.rint(127.5 * (vertices + 1)).astype(np.uint8)
    T = transform(np.eye(3), np.array([0.0, 0.0, 0.8]))
    assert MeshImages(vertices * 0.1, triangles).frame(CAMERA, T).rgb is None
    frame = MeshImages(vertices * 0.1, triangles, rgb=rgb).frame(CAMERA, T)
    on = frame.depth > 0
    points = CAMERA.back_project(frame.depth)[on] - [0, 0, 0.8]
    assert np.abs(frame.rgb[on] - 127.5 * (points / 0.1 + 1)).max() < 3
    assert not frame.rgb[~on].any()
