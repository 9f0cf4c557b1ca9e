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

"""Pictures registered to the depth, colour or brightness, from and to sensor_msgs/Image."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from debris_scanner.core.frames import grey_picture
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

# Brightness of more than 8 bits: infrared and amplitude images.
_BRIGHTNESS: dict[str, np.dtype[Any]] = {
    'mono16': np.dtype('u2'),
    '16UC1': np.dtype('u2'),
    '32FC1': np.dtype('f4'),
}
_GREY = frozenset({'mono8', '8UC1', *_BRIGHTNESS})

COLOUR_ENCODINGS = frozenset(_CHANNELS)
# What a topic of infrared or amplitude images is called; their encoding is that of some depth images.
_BRIGHT_NAMES = re.compile(r'(^|[/_])(ir|infra\w*|amplitude|intensity|gr[ae]y\w*)([/_]|$)')


def names_brightness(topic: str) -> bool:
    """Whether a topic is called as infrared, amplitude or grey images are."""
    return _BRIGHT_NAMES.search(topic.lower()) is not None


def picture_rank(topic: str, encoding: str) -> int | None:
    """0 for images in colour, 1 for brightness, None for other images, as of depth, by topic and encoding."""
    if encoding in _CHANNELS:
        return int(encoding in _GREY)
    return 1 if encoding in _BRIGHTNESS and names_brightness(topic) else None


def read_colour(image: Any) -> NDArray[np.uint8]:
    """Colours (h, w, 3), red first, of an Image; brightness of any depth as three equal channels.

    Raises:
        MalformedMessage: another encoding, absurdly large, or shorter than it says.
    """
    height, width, step = int(image.height), int(image.width), int(image.step)
    encoding = str(image.encoding)
    if encoding not in _CHANNELS and encoding not in _BRIGHTNESS:
        known = ', '.join((*_CHANNELS, *_BRIGHTNESS))
        raise MalformedMessage(f'image encoding {encoding!r} is no picture: {known}')
    depth = _BRIGHTNESS.get(encoding)
    size, order = _CHANNELS[encoding] if depth is None else (depth.itemsize, (0,))
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
    if depth is not None:
        kind = depth.newbyteorder('>' if image.is_bigendian else '<')
        values: NDArray[Any] = np.ndarray((height, width), kind, message_bytes(image.data), 0, (step, size))
        return grey_picture(values)
    pixels: NDArray[np.uint8] = np.ndarray(
        (height, width, size), np.uint8, message_bytes(image.data), 0, (step, size, 1)
    )
    return np.ascontiguousarray(pixels[..., list(order)])


def colour_image_message(stamp_ns: int, frame_id: str, picture: NDArray[Any]) -> Image:
    """Image of colours (h, w, 3) uint8 as rgb8, or of brightness (h, w) uint16 as mono16."""
    encoding, kind = ('rgb8', 'u1') if picture.ndim == 3 else ('mono16', '<u2')
    pixels = np.ascontiguousarray(picture, kind)
    return Image(
        header=header_message(stamp_ns, frame_id),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels.strides[0],
        data=byte_array(pixels),
    )
