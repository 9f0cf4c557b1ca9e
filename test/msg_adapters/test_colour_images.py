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

"""Colour images of every layout that a driver may send."""

from array import array

import numpy as np
import pytest

from msg_adapters.colour_images import (
    COLOUR_ENCODINGS,
    colour_image_message,
    picture_rank,
    read_colour,
)
from msg_adapters.errors import MalformedMessage

RGB = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)


def laid_out(encoding, pixels, padding=0):
    """RGB as a message in another layout, rows padded."""
    msg = colour_image_message(1, 'camera', RGB)
    rows = np.zeros((5, pixels[0, 0].size * 7 + padding), np.uint8)
    rows[:, : pixels[0, 0].size * 7] = pixels.reshape(5, -1)
    msg.encoding, msg.step, msg.data = encoding, rows.shape[1], array('B', rows.tobytes())
    return msg


def test_colours_come_back():
    msg = colour_image_message(5, 'camera', RGB)
    assert (msg.encoding, msg.width, msg.height, msg.step) == ('rgb8', 7, 5, 21)
    assert np.array_equal(read_colour(msg), RGB)


@pytest.mark.parametrize('padding', [0, 3])
def test_every_encoding_tells_the_same_colours(padding):
    alpha = np.full((5, 7, 1), 9, np.uint8)
    layouts = {
        'rgb8': RGB,
        'bgr8': RGB[..., ::-1],
        '8UC3': RGB[..., ::-1],
        'rgba8': np.concatenate([RGB, alpha], axis=2),
        'bgra8': np.concatenate([RGB[..., ::-1], alpha], axis=2),
    }
    for encoding, pixels in layouts.items():
        assert np.array_equal(read_colour(laid_out(encoding, pixels, padding)), RGB), encoding
    for encoding in COLOUR_ENCODINGS - set(layouts):  # grey
        grey = read_colour(laid_out(encoding, RGB[..., :1], padding))
        assert np.array_equal(grey, RGB[..., :1].repeat(3, axis=2)), encoding


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        ({'encoding': 'yuv422'}, "'yuv422' is no picture"),
        ({'data': array('B', b'\0' * 20)}, '20 bytes, 5 rows'),
        ({'step': 20}, 'shorter than 7 pixels of 3 bytes'),
        ({'height': 60_000, 'width': 60_000}, 'larger than the limit'),
    ],
)
def test_what_contradicts_itself_is_malformed(change, said):
    msg = colour_image_message(1, 'camera', RGB)
    for name, value in change.items():
        setattr(msg, name, value)
    with pytest.raises(MalformedMessage) as refusal:
        read_colour(msg)
    assert said in str(refusal.value)


def test_an_empty_image_has_no_colours():
    msg = colour_image_message(1, 'camera', RGB)
    msg.height = 0
    assert read_colour(msg).shape == (0, 7, 3)


def test_infrared_of_sixteen_bits_becomes_grey_by_its_square_root():
    brightness = np.full((5, 7), 100, np.uint16)
    brightness[:, 3:] = 400
    msg = colour_image_message(1, 'camera', brightness)
    grey = read_colour(msg)
    assert np.ptp(grey, axis=2).max() == 0
    assert (grey[0, 0, 0], grey[0, 6, 0]) == (127, 254)
    msg.data, msg.is_bigendian = array('B', brightness.astype('>u2').tobytes()), 1
    assert np.array_equal(read_colour(msg), grey)
    msg.encoding, msg.step, msg.is_bigendian = '32FC1', 28, 0
    msg.data = array('B', np.where(brightness > 100, np.nan, brightness).astype('<f4').tobytes())
    assert (read_colour(msg)[:, 3:] == 0).all() and (read_colour(msg)[:, :3] == 254).all()


@pytest.mark.parametrize(
    ('topic', 'encoding', 'rank'),
    [
        ('/rgb/image_raw', 'rgb8', 0),
        ('/camera/infra1/image_rect_raw', 'mono8', 1),
        ('/ir/image_raw', 'mono16', 1),
        ('/kinect2/sd/image_ir', '16UC1', 1),
        ('/camera/amplitude', '32FC1', 1),
        ('/camera/depth/image_raw', '16UC1', None),
        ('/mirror/image', '16UC1', None),
        ('/camera/confidence', 'yuv422', None),
    ],
)
def test_a_picture_is_told_from_a_depth_image_by_encoding_and_name(topic, encoding, rank):
    assert picture_rank(topic, encoding) == rank
