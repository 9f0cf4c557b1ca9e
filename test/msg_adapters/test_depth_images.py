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

from array import array

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image

from debris_scanner.core.camera import Camera, virtual_camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.clouds import cloud_message, read_cloud
from msg_adapters.depth_images import (
    camera_info_message,
    cloud_frame_message,
    depth_image_message,
    organised_cloud,
    read_depth,
)
from msg_adapters.errors import MalformedMessage, WrongCameraInfo
from msg_adapters.inputs.camera_infos import read_camera
from msg_adapters.inputs.decoder import FrameDecoder
from msg_adapters.raw_messages import jazzy_types

CAMERA = Camera(52.5, 52.3, 31.4, 23.7, 64, 48)


def depth_of(seed: int = 0, shape: tuple[int, int] = (48, 64)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.3, 5, shape).astype(np.float32)
    depth[rng.uniform(size=shape) < 0.2] = 0
    return depth


def image_of(pixels: np.ndarray, encoding: str, big: bool, padding: int) -> Image:
    """Rows of pixels in a byte order of choice, each followed by bytes that are none of it."""
    rows = [
        row.tobytes() + b'\xab' * padding
        for row in pixels.astype(pixels.dtype.newbyteorder('>' if big else '<'))
    ]
    height, width = pixels.shape
    image = Image(height=height, width=width, encoding=encoding, is_bigendian=int(big))
    image.step = width * pixels.itemsize + padding
    image.data = array('B', b''.join(rows))
    return image


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 99), st.booleans(), st.integers(0, 5), st.tuples(st.integers(0, 5), st.integers(0, 6)))
def test_millimetres_in_any_byte_order_and_padding(seed, big, padding, shape):
    pixels = np.random.default_rng(seed).integers(0, 2**16, shape, dtype=np.uint16)
    depth = read_depth(image_of(pixels, '16UC1', big, padding))
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, pixels * np.float32(0.001))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(0, 99), st.booleans(), st.integers(0, 5), st.tuples(st.integers(0, 5), st.integers(0, 6)))
def test_metres_in_any_byte_order_and_padding(seed, big, padding, shape):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.1, 9, shape).astype(np.float32)
    invalid = rng.uniform(size=shape) < 0.4
    pixels[invalid] = rng.choice([np.nan, np.inf, -np.inf, 0, -1], shape)[invalid]
    depth = read_depth(image_of(pixels, '32FC1', big, padding))
    np.testing.assert_array_equal(depth, np.where(invalid, np.float32(0), pixels))


@pytest.mark.parametrize(('encoding', 'tolerance'), [('32FC1', 0), ('16UC1', 0.000501)])
def test_a_frame_comes_back(encoding, tolerance):
    depth = depth_of()
    image = depth_image_message(1_700_000_000_000_000_001, 'sensor', depth, encoding)
    info = camera_info_message(0, 'sensor', CAMERA)
    for decode in (lambda m: m, through_bag):
        frame = FrameDecoder().image(decode(image), decode(info))
        assert frame.stamp_ns == 1_700_000_000_000_000_001
        assert frame.camera == CAMERA
        np.testing.assert_allclose(frame.depth, depth, atol=tolerance, rtol=0)
        np.testing.assert_array_equal(frame.depth == 0, depth == 0)


def through_bag(message):
    return jazzy_types().deserialize_cdr(
        serialize_message(message), f'sensor_msgs/msg/{type(message).__name__}'
    )


def test_depth_beyond_sixteen_bits_is_invalid():
    depth = np.array([[65.5, 65.6, 0.0004, np.nan, -2]], np.float32)
    np.testing.assert_allclose(read_depth(depth_image_message(0, 'f', depth, '16UC1')), [[65.5, 0, 0, 0, 0]])


def test_an_image_without_any_depth_is_an_empty_frame():
    frame = FrameDecoder().image(
        depth_image_message(7, 'f', np.zeros((48, 64), np.float32)), camera_info_message(7, 'f', CAMERA)
    )
    assert not frame.depth.any()


def test_a_binned_window_of_the_sensor_has_its_own_camera():
    info = CameraInfo(width=640, height=480, k=[500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0])
    info.binning_x = info.binning_y = 2
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 100, 40, 200, 160
    assert read_camera(info) == Camera(250, 255, 110, 100, 100, 80)


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({'encoding': 'rgb8'}, "'rgb8' is not a depth"),
        ({'encoding': ''}, "'' is not a depth"),
        ({'step': 127}, 'step 127'),
        ({'data': array('B', bytes(6143))}, '6143 bytes, 48 rows of 128'),
        ({'height': 49}, '49 rows of 128'),
        ({'height': 2**31, 'width': 2**31}, 'larger than the limit'),
    ],
)
def test_an_image_that_contradicts_itself_is_refused(change, named):
    image = depth_image_message(0, 'f', depth_of(), '16UC1')
    for name, value in change.items():
        setattr(image, name, value)
    with pytest.raises(MalformedMessage, match=named):
        read_depth(image)


@pytest.mark.parametrize(
    ('k', 'named'),
    [
        ([0.0] * 9, 'no usable intrinsics: fx 0, fy 0'),
        ([np.nan] * 9, 'no usable intrinsics: fx nan'),
        ([np.inf, 0, 1, 0, 1, 1, 0, 0, 1], 'no usable intrinsics: fx inf'),
        ([-525.0, 0, 31, 0, 525, 23, 0, 0, 1], 'no usable intrinsics: fx -525'),
        ([52.0, 0, np.nan, 0, 52, 23, 0, 0, 1], 'no usable intrinsics: .* cx nan'),
        ([1.0, 0, 31, 0, 1, 23, 0, 0, 1], 'sees 176.5 deg of 64x48 pixels: fx 1, fy 1'),
    ],
)
def test_a_camera_info_that_is_no_cameras_is_refused(k, named):
    with pytest.raises(WrongCameraInfo, match=named) as refusal:
        read_camera(CameraInfo(width=64, height=48, k=np.array(k, np.float64)))
    assert refusal.value.reason == 'camera_info'


def test_an_image_of_another_size_than_its_camera_is_refused():
    info = camera_info_message(0, 'f', CAMERA)
    with pytest.raises(WrongCameraInfo, match='camera_info is of 64x48, the image has 32x48'):
        FrameDecoder().image(depth_image_message(0, 'f', depth_of(shape=(48, 32))), info)


def test_an_organised_cloud_is_the_same_frame():
    rgb = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    frame = DepthFrame(9, depth_of(), CAMERA, rgb)
    message = cloud_frame_message(frame, 'sensor')
    np.testing.assert_array_equal(read_cloud(message).xyz, organised_cloud(frame.depth, CAMERA))
    back = FrameDecoder().cloud(message)
    assert back.stamp_ns == 9
    np.testing.assert_array_equal(back.depth, frame.depth)
    np.testing.assert_array_equal(back.rgb, rgb)
    assert back.camera.fx == pytest.approx(CAMERA.fx, abs=1e-3)
    assert back.camera.cy == pytest.approx(CAMERA.cy, abs=1e-3)


def test_a_cloud_without_rows_is_seen_through_the_virtual_camera():
    points = organised_cloud(depth_of(), CAMERA).reshape(-1, 3)
    frame = FrameDecoder().cloud(cloud_message(3, 'f', {axis: points[:, i] for i, axis in enumerate('xyz')}))
    assert frame.camera == virtual_camera(points)
    assert np.count_nonzero(frame.depth) > 1000


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.data())
def test_damaged_images_raise_nothing_but_malformed(data):
    image = through_bag(depth_image_message(0, 'f', depth_of(shape=(4, 5)), '16UC1'))
    info = through_bag(camera_info_message(0, 'f', Camera(5, 5, 2, 2, 5, 4)))
    numbers = st.one_of(st.integers(0, 20), st.sampled_from([2**16, 2**31, 2**32 - 1]))
    for name in data.draw(st.lists(st.sampled_from(['height', 'width', 'step', 'is_bigendian']), max_size=3)):
        setattr(image, name, data.draw(numbers))
    for name in data.draw(
        st.lists(st.sampled_from(['height', 'width', 'binning_x', 'binning_y']), max_size=2)
    ):
        setattr(info, name, data.draw(numbers))
    image.data = image.data[: data.draw(st.integers(0, 40))]
    try:
        frame = FrameDecoder().image(image, info)
    except MalformedMessage as error:
        assert '\n' not in str(error)
        return
    assert frame.depth.shape == (frame.camera.height, frame.camera.width)
