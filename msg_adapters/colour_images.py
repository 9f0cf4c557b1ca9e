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

"""Colour images from and to sensor_msgs/Image."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from msg_adapters.clouds import MAX_POINTS, byte_array, message_bytes
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import header_message

# Encoding: bytes a pixel, and which of them are red, green and blue.
_CHANNELS: dict[str, tuple[int, tuple[int, int, int]]] = {
    'rgb8': (3, (0, 1, 2)),
    'bgr8': (3, (2, 1, 0)),
    'rgba8': (4, (0, 1, 2)),
    'bgra8': (4, (2, 1, 0)),
    'mono8': (1, (0, 0, 0)),
    '8UC1': (1, (0, 0, 0)),
    '8UC3': (3, (2, 1, 0)),  # OpenCV's order
}

COLOUR_ENCODINGS = frozenset(_CHANNELS)


def read_colour(image: Any) -> NDArray[np.uint8]:
    """Colours (h, w, 3), red first, of an Image of 8 bits a channel.

    Raises:
        MalformedMessage: another encoding, absurdly large, or shorter than it says.
    """
    height, width, step = int(image.height), int(image.width), int(image.step)
    if str(image.encoding) not in _CHANNELS:
        raise MalformedMessage(f'image encoding {image.encoding!r} is no colour: {", ".join(_CHANNELS)}')
    size, order = _CHANNELS[str(image.encoding)]
    if height * width > MAX_POINTS:
        raise MalformedMessage(f'image of {width} x {height} pixels is larger than the limit of {MAX_POINTS}')
    if step < width * size:
        raise MalformedMessage(f'image step {step} is shorter than {width} pixels of {size} bytes')
    if len(image.data) < step * height:
        raise MalformedMessage(
            f'image data has {len(image.data)} bytes, {height} rows of {step} bytes announced'
        )
    if 0 in (height, width):
        return np.zeros((height, width, 3), np.uint8)
    pixels: NDArray[np.uint8] = np.ndarray(
        (height, width, size), np.uint8, message_bytes(image.data), 0, (step, size, 1)
    )
    return np.ascontiguousarray(pixels[..., list(order)])


def colour_image_message(stamp_ns: int, frame_id: str, rgb: NDArray[np.uint8]) -> Image:
    """Image (rgb8) of colours (h, w, 3)."""
    height, width, _ = rgb.shape
    return Image(
        header=header_message(stamp_ns, frame_id),
        height=height,
        width=width,
        encoding='rgb8',
        is_bigendian=0,
        step=3 * width,
        data=byte_array(rgb),
    )
