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

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from processor_time import processor_seconds
from rclpy.serialization import serialize_message

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from msg_adapters.clouds import cloud_message, read_fields
from msg_adapters.errors import MalformedMessage
from msg_adapters.raw_messages import jazzy_types
from msg_adapters.target_frames import read_target_frame, target_frame_message


def target(
    seed: int = 0, shape: tuple[int, int] = (90, 110), corner: tuple[int, int] = (200, 150), coloured=True
):
    """A round target of noisy depth in a window of a Kinect's image."""
    rng = np.random.default_rng(seed)
    h, w = shape
    v, u = np.mgrid[:h, :w]
    on = ((v - h / 2) / (h / 2)) ** 2 + ((u - w / 2) / (w / 2)) ** 2 < 1
    depth = np.where(on, rng.uniform(0.5, 0.8, shape), 0).astype(np.float32)
    fitted = on & (rng.uniform(size=shape) < 0.9)
    normals = rng.normal(size=(h, w, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return TargetFrame(
        stamp_ns=1_700_000_000_123_456_789,
        camera=Camera(525.3, 523.9, 319.4, 239.6, 640, 480).crop(*corner, w, h),
        depth=depth,
        depth_fit=np.where(fitted, depth * 1.001, 0).astype(np.float32),
        normals=np.where(fitted[..., None], normals, 0).astype(np.float32),
        rgb=rng.integers(0, 256, (h, w, 3), dtype=np.uint8) if coloured else None,
    )


@settings(derandomize=True, deadline=None, max_examples=40)
@given(
    st.integers(0, 1000),
    st.tuples(st.integers(12, 200), st.integers(12, 200)),
    st.tuples(st.integers(-20, 600), st.integers(-20, 440)),
    st.booleans(),
)
def test_a_target_frame_comes_back(seed, shape, corner, coloured):
    frame = target(seed, shape, corner, coloured)
    back = read_target_frame(target_frame_message(frame, 'sensor'))
    assert back.stamp_ns == frame.stamp_ns
    for name in ('depth', 'depth_fit', 'normals', 'rgb'):
        np.testing.assert_array_equal(getattr(back, name), getattr(frame, name))
    assert (back.camera.width, back.camera.height) == (frame.camera.width, frame.camera.height)
    # a pixel of the window is where it was: focal length and centre may trade off within rounding
    for pixel, f, c in ((shape[1], 'fx', 'cx'), (shape[0], 'fy', 'cy')):
        slopes = (np.array([0, pixel]) - getattr(frame.camera, c)) / getattr(frame.camera, f)
        np.testing.assert_allclose(
            slopes * getattr(back.camera, f) + getattr(back.camera, c), [0, pixel], atol=1e-3
        )


def test_the_camera_of_an_ordinary_target_is_exact_to_a_thousandth_of_a_pixel():
    frame = target()
    camera = read_target_frame(target_frame_message(frame, 'sensor')).camera
    np.testing.assert_allclose(dataclasses.astuple(camera), dataclasses.astuple(frame.camera), atol=1e-3)


def test_it_survives_a_bag():
    frame = target()
    raw = serialize_message(target_frame_message(frame, 'sensor'))
    back = read_target_frame(jazzy_types().deserialize_cdr(raw, 'sensor_msgs/msg/PointCloud2'))
    np.testing.assert_array_equal(back.depth, frame.depth)


def test_off_the_target_the_cloud_has_no_points():
    frame = target()
    message = target_frame_message(frame, 'sensor')
    assert (message.height, message.width) == frame.depth.shape
    z = read_fields(message, ['z'])['z']
    np.testing.assert_array_equal(np.isnan(z), frame.depth == 0)


def test_what_is_no_number_counts_as_no_fit():
    frame = target()
    frame.normals[40, 40] = np.nan
    frame.depth_fit[40, 40] = np.inf
    back = read_target_frame(target_frame_message(frame, 'sensor'))
    assert not back.normals[40, 40].any()
    assert back.depth_fit[40, 40] == 0


def test_a_cloud_without_rows_is_no_target_frame():
    names = ['x', 'y', 'z', 'normal_x', 'normal_y', 'normal_z', 'depth_fit']
    message = cloud_message(0, 'sensor', {name: np.ones(400, np.float32) for name in names})
    with pytest.raises(MalformedMessage, match='no pinhole camera'):
        read_target_frame(message)


def test_a_missing_field_is_named():
    plain = {axis: np.ones((20, 20), np.float32) for axis in 'xyz'}
    with pytest.raises(MalformedMessage, match='normal_x'):
        read_target_frame(cloud_message(0, 'sensor', plain))


@pytest.mark.timing
def test_a_target_travels_in_a_few_milliseconds():
    frame = target(shape=(200, 200))
    took = processor_seconds(lambda: read_target_frame(target_frame_message(frame, 'sensor')), tries=5)
    assert took < 0.02  # 1.5 ms when measured
