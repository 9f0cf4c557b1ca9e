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
import pytest

from debris_scanner.core.camera import VIRTUAL_CAMERA, Camera
from debris_scanner.core.frames import (
    NO_FOOTPRINT,
    DepthFrame,
    FrameRejected,
    KeyFrame,
    TargetFrame,
    point_spacing,
)
from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.voxel_grid import voxel_grid
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import CLOUD_SPACING

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
    # as fine as the cloud, to half an octave, and as wide as a Kinect
    assert 0.75 * CAMERA.fx < frame.camera.fx < 1.05 * CAMERA.fx
    scale = frame.camera.fx / VIRTUAL_CAMERA.fx
    assert frame.camera.fx == frame.camera.fy
    assert frame.depth.shape == (frame.camera.height, frame.camera.width)
    assert frame.depth.shape == (round(480 * scale), round(640 * scale))
    assert frame.rgb.shape == (*frame.depth.shape, 3)
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


def shown(depth, camera=CAMERA):
    """A target frame of a depth image (h, w) without planes."""
    return TargetFrame(0, camera, depth, np.zeros_like(depth), np.zeros((*depth.shape, 3), np.float32))


def test_the_footprint_is_what_a_pixel_covers_at_the_middle_of_the_target():
    depth = np.zeros((48, 64), np.float32)
    depth[10:40, 10:50] = 0.8
    depth[10:12, 10:50] = 0.5  # a mast in front of it
    assert shown(depth).footprint == pytest.approx(0.008)
    kinect = Camera(525.0, 525.0, 31.5, 23.5, 64, 48)
    assert shown(depth, kinect).footprint == pytest.approx(0.8 / 525)
    assert shown(2 * depth, kinect).footprint == pytest.approx(2 * 0.8 / 525)
    # pixels that are not square: the side of a square of the same area
    assert shown(depth, Camera(400.0, 100.0, 31.5, 23.5, 64, 48)).footprint == pytest.approx(0.8 / 200)
    # the window makes no difference
    window = shown(depth[8:44, 8:54], CAMERA.crop(8, 8, 46, 36))
    assert window.footprint == shown(depth).footprint


@pytest.mark.parametrize('pixel', [(1, 1), (2, 1), (0, 0)])
def test_a_single_pixel_has_a_footprint(pixel):
    depth = np.zeros((4, 4), np.float32)
    depth[pixel] = 2.0
    assert shown(depth).footprint == pytest.approx(0.02)


@pytest.mark.parametrize('shape', [(4, 4), (1, 1), (0, 0)])
def test_an_empty_frame_has_a_footprint_that_divides(shape):
    assert shown(np.zeros(shape, np.float32)).footprint == NO_FOOTPRINT > 0


def surface(kind, size, rng):
    """Dense points (n, 3) of a surface so large, m."""
    if kind == 'ball':
        p = rng.normal(size=(60_000, 3))
        return p * (size / 2 / np.linalg.norm(p, axis=1, keepdims=True))
    p = np.zeros((60_000, 3))
    p[:, :2] = rng.uniform(-size / 2, size / 2, (60_000, 2))
    return p @ exp_so3(np.array([0.5, 0.3, 0.2])).T


@pytest.mark.parametrize('edge', [0.0005, 0.002, 0.1])
@pytest.mark.parametrize('kind', ['ball', 'plate'])
def test_the_spacing_of_points_is_the_edge_of_their_voxel_grid(kind, edge):
    points = voxel_grid(surface(kind, 40 * edge, np.random.default_rng(0)), edge)
    assert point_spacing(points) == pytest.approx(edge, rel=0.25)
    assert point_spacing(2 * points) == pytest.approx(2 * point_spacing(points), rel=1e-5)


def test_the_spacing_of_a_model_is_that_of_its_cloud(true_model, recording):
    field = FusionSettings().voxel * np.median([recording.targets[k].footprint for k in range(0, 126, 3)])
    assert true_model.spacing == pytest.approx(CLOUD_SPACING * field, rel=0.1)


@pytest.mark.parametrize('count', [0, 1])
def test_points_without_neighbours_have_a_spacing_that_divides(count):
    assert point_spacing(np.zeros((count, 3))) == NO_FOOTPRINT


def test_a_cloud_that_fits_no_pinhole_camera_keeps_its_colour():
    """As one that a driver made of a lens that distorts, or a lidar's with its own colours."""
    v, u = np.mgrid[:60, :80].astype(np.float32)
    x, y = (u - 40) / 70, (v - 30) / 70
    bent = 1 - 0.3 * (x**2 + y**2)
    points = np.stack([x * bent, y * bent, np.ones_like(x)], axis=-1) * np.float32(0.8)
    rgb = np.stack([u * 3, v * 4, u + v], axis=-1).astype(np.uint8)
    frame = DepthFrame.from_cloud(1, points.astype(np.float32), rgb)
    seen = frame.depth > 0
    assert seen.sum() > 0.6 * 60 * 80
    assert not frame.rgb[~seen].any()
    rows, columns = np.nonzero(seen)
    shown = rgb.reshape(-1, 3)
    places = points.reshape(-1, 3)
    for n in range(0, len(rows), 97):
        colour = frame.rgb[rows[n], columns[n]]
        (k,) = np.flatnonzero((shown == colour).all(axis=1))
        projected = places[k, :2] / places[k, 2] * frame.camera.fx + (frame.camera.cx, frame.camera.cy)
        assert np.abs(projected - (columns[n], rows[n])).max() <= 0.51
