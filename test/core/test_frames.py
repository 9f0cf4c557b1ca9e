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

"""Every input becomes a depth frame."""

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import VIRTUAL_CAMERA, DepthFrame, FrameRejected, KeyFrame, TargetFrame

CAMERA = Camera(100.0, 100.0, 31.5, 23.5, 64, 48)


def organised():
    depth = np.linspace(0.5, 0.9, 64 * 48, dtype=np.float32).reshape(48, 64)
    depth[5:9, 5:9] = 0
    return depth, CAMERA.back_project(depth)


def test_an_organised_cloud_gives_back_its_depth_image():
    depth, points = organised()
    rgb = np.zeros((48, 64, 3), np.uint8)
    frame = DepthFrame.from_cloud(42, points, rgb)
    np.testing.assert_array_equal(frame.depth, depth)
    assert frame.stamp_ns == 42
    assert frame.rgb is rgb
    np.testing.assert_allclose([frame.camera.fx, frame.camera.cx], [100, 31.5], rtol=1e-5)


def test_points_that_are_invalid_in_any_coordinate_have_no_depth():
    depth, points = organised()
    points[20, 20, 0] = np.nan
    points[21, 21, 1] = np.inf
    points[22, 22, 2] = -1.0
    frame = DepthFrame.from_cloud(0, points)
    assert [frame.depth[k, k] for k in (20, 21, 22)] == [0, 0, 0]
    assert frame.depth[23, 23] == depth[23, 23]


def test_an_unordered_cloud_is_looked_at_through_a_virtual_camera():
    _, points = organised()
    cloud = np.random.default_rng(0).permutation(points.reshape(-1, 3))
    frame = DepthFrame.from_cloud(7, cloud, np.zeros((len(cloud), 3), np.uint8))
    assert frame.camera == VIRTUAL_CAMERA
    assert frame.depth.shape == (480, 640)
    assert frame.rgb is None
    seen = frame.depth[frame.depth > 0]
    assert len(seen) > 2000
    assert seen.min() >= 0.5
    assert seen.max() <= 0.9


def test_a_rejection_names_its_reason():
    assert str(FrameRejected('no_target', '3 points')) == 'no_target: 3 points'
    assert str(FrameRejected('no_target')) == FrameRejected('no_target').reason == 'no_target'


def test_a_key_frame_is_known_by_its_stamp():
    empty = np.zeros((2, 2), np.float32)
    frame = TargetFrame(99, CAMERA, empty, empty, np.zeros((2, 2, 3), np.float32))
    a, b = KeyFrame(frame, np.eye(4), 0.0), KeyFrame(frame, np.eye(4), 0.0)
    assert a.stamp_ns == 99
    a.covariance[0, 0] = 5.0
    assert b.covariance[0, 0] == 1e-8
