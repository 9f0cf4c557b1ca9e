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

"""Points in the box: those that back-projection puts there, borders included."""

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.isolation import points_in_box

CAMERA = Camera(50.0, 60.0, 7.5, 5.5, 16, 12)


def test_the_points_are_those_of_back_projection_that_lie_inside():
    depth = np.random.default_rng(0).uniform(0.1, 1.5, (12, 16)).astype(np.float32)
    depth[3] = 0
    depth[4] = np.nan
    low, high = np.array([-0.05, -0.06, 0.3]), np.array([0.07, 0.08, 1.2])
    points, rows, columns = points_in_box(depth, CAMERA, low, high)
    cloud = CAMERA.back_project(depth)
    inside = ((cloud >= low) & (cloud <= high)).all(axis=-1)
    assert 10 < inside.sum() < 150
    np.testing.assert_array_equal(np.nonzero(inside), [rows, columns])
    np.testing.assert_allclose(points, cloud[inside], atol=1e-6)


def test_the_borders_belong_to_the_box():
    depth = np.array([[0.5, 1.0, 1.0000001]], np.float32)
    _, _, columns = points_in_box(
        depth, Camera(1.0, 1.0, 0.0, 0.0, 3, 1), np.full(3, 0.0), np.array([9, 9, 1.0])
    )
    np.testing.assert_array_equal(columns, [0, 1])
