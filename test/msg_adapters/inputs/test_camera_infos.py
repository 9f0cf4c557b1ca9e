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

"""K or P, windows, other resolutions, lenses: what camera_infos say, and what they get wrong."""

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from debris_scanner.core.camera import Camera
from msg_adapters.depth_images import camera_info_message
from msg_adapters.errors import WrongCameraInfo
from msg_adapters.inputs.camera_infos import is_rectified, read_camera, read_lens, same_camera

CAMERA = Camera(52.5, 53.0, 31.5, 23.5, 64, 48)
IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def info(**changes):
    message = camera_info_message(0, 'f', CAMERA)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def p_of(fx):
    return [fx, 0.0, 30.0, 0.0, 0.0, fx, 20.0, 0.0, 0.0, 0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ('topic', 'told'),
    [
        ('/camera/camera/depth/image_rect_raw', True),
        ('/depth/image_rect', True),
        ('/depth/image_rect/compressedDepth', True),
        ('/depth_rect/image_raw', False),
        ('/depth/image_raw', False),
        ('/depth/direct', False),
    ],
)
def test_the_name_of_a_topic_tells_that_it_is_rectified(topic, told):
    assert is_rectified(topic) == told


def test_rectified_images_are_seen_by_p_and_raw_ones_by_k():
    both = info(p=p_of(50.0))
    assert read_camera(both).fx == 52.5
    assert read_camera(both, rectified=True) == Camera(50, 50, 30, 20, 64, 48)
    assert read_lens(both, 64, 48, rectified=True).camera.fx == 50


def test_a_k_that_is_the_identity_gives_way_to_p():
    """As a stereo camera's driver sends it, its window a row short of the image."""
    message = info(k=IDENTITY, p=p_of(50.0), roi=RegionOfInterest(width=64, height=47))
    assert read_lens(message, 64, 48).camera == Camera(50, 50, 30, 20, 64, 48)


@pytest.mark.parametrize('number', [0.0, np.nan, -52.5])
def test_a_k_that_is_no_calibration_is_no_camera_of_raw_images(number):
    message = info(k=[number] * 9, p=p_of(50.0))
    with pytest.raises(WrongCameraInfo, match='no usable intrinsics'):
        read_lens(message, 64, 48)
    assert read_lens(message, 64, 48, rectified=True).camera.fx == 50


def test_a_p_of_zeros_gives_way_to_k():
    assert read_camera(info(p=[0.0] * 12), rectified=True) == CAMERA


@pytest.mark.parametrize('rectified', [False, True])
def test_a_focal_length_of_one_is_nobodys(rectified):
    with pytest.raises(WrongCameraInfo, match=r'sees 178\.2 deg of 64x48 pixels: fx 1, fy 1'):
        read_lens(info(k=IDENTITY, p=p_of(1.0)), 64, 48, rectified)


@pytest.mark.parametrize(
    'k', [[52.5, 0, 1e9, 0, 53.0, 23.5, 0, 0, 1], [1e12, 0, 31.5, 0, 1e12, 23.5, 0, 0, 1]]
)
def test_nobody_sees_beside_himself_or_finer_than_light(k):
    with pytest.raises(WrongCameraInfo, match='has a K that sees'):
        read_lens(info(k=[float(x) for x in k]), 64, 48)


def test_a_window_far_from_the_axis_is_seen():
    roi = RegionOfInterest(x_offset=4000, y_offset=4000, width=64, height=48)
    message = info(k=[5000.0, 0, 2000.0, 0, 5000.0, 2000.0, 0, 0, 1], width=4064, height=4048, roi=roi)
    assert read_lens(message, 64, 48).camera.cx == -2000.0


def test_a_window_that_is_cut_out_and_one_that_is_only_named():
    message = info(roi=RegionOfInterest(x_offset=10, y_offset=4, width=32, height=24))
    assert read_lens(message, 32, 24).camera == Camera(52.5, 53.0, 21.5, 19.5, 32, 24)
    assert read_lens(message, 64, 48).camera == CAMERA


@pytest.mark.parametrize('size', [(64, 40), (48, 32), (128, 96), (0, 0)])
def test_any_other_size_is_refused_with_both(size):
    width, height = size
    with pytest.raises(WrongCameraInfo, match=f'camera_info is of 64x48, the image has {width}x{height}'):
        read_lens(info(), *size)


def test_a_lens_is_undone_unless_the_images_are_rectified():
    message = info(d=[-0.1, 0.01, 0.0, 0.0, 0.0])
    assert read_lens(message, 64, 48).rectifier is not None
    assert read_lens(message, 64, 48, rectified=True).rectifier is None
    assert read_lens(info(d=[0.0] * 5, distortion_model='Brown Conrady'), 64, 48).rectifier is None


@pytest.mark.parametrize(
    ('changes', 'named'),
    [
        (
            {'distortion_model': 'omnidirectional', 'd': [0.1] * 4},
            "distortion model 'omnidirectional' is none of",
        ),
        ({'distortion_model': 'plumb_bob', 'd': [0.1] * 3}, 'plumb_bob has 4 or 5 finite coefficients'),
        ({'distortion_model': 'equidistant', 'd': [np.nan] * 4}, 'equidistant has 4 finite coefficients'),
        ({'distortion_model': 'rational_polynomial', 'd': [0.0] * 12 + [0.1, 0]}, 'tilted sensor'),
    ],
)
def test_a_lens_that_is_not_known_is_named(changes, named):
    with pytest.raises(WrongCameraInfo, match=named):
        read_lens(info(**changes), 64, 48)


def test_cameras_are_the_same_by_size_and_k():
    assert same_camera(info(), info())
    assert not same_camera(info(), camera_info_message(0, 'f', Camera(61.0, 61.0, 31.5, 23.5, 64, 48)))
    assert not same_camera(info(), CameraInfo(width=64, height=48))
