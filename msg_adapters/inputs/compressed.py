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

"""sensor_msgs/CompressedImage as the Image it was made of: PNG, and compressedDepth; colours as JPEG, too.

compressed_depth_image_transport puts two numbers before a PNG of 16 bit. 16UC1 is the image itself. 32FC1 is
inverse depth, from which they give the metres back.
"""

import io
import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from msg_adapters.clouds import MAX_POINTS
from msg_adapters.errors import MalformedMessage

_HEADER = struct.Struct('<iff')  # of compressedDepth: format, depthQuantA, depthQuantB
_PNG = b'\x89PNG'
_DEPTHS = ('16UC1', '32FC1', 'mono16')


def is_depth(message: Any) -> bool:
    """Whether a CompressedImage says that it is a depth."""
    text = str(message.format)
    return 'compressedDepth' in text or text.split(';')[0].strip() in _DEPTHS


def decompressed(message: Any) -> Any:
    """The Image of a CompressedImage: a record with the fields of sensor_msgs/Image.

    Raises:
        MalformedMessage: a depth that is not compressed as PNG, as JPEG changes depths; or it cannot be read.
    """
    encoding = str(message.format).split(';')[0].strip()
    data = bytes(message.data)
    if not is_depth(message):
        return _image(message, 'rgb8', _pixels(data, 'RGB'))
    at = data.find(_PNG, 0, _HEADER.size + len(_PNG))
    if at < 0:
        raise MalformedMessage(
            f'depth compressed as {message.format!r} is not PNG, the one format that keeps depths: '
            'set the publisher to png, or use the raw images'
        )
    values = _pixels(data[at:], '')
    if encoding != '32FC1':
        return _image(message, '16UC1', values)
    if at != _HEADER.size:
        raise MalformedMessage(f'depth compressed as {message.format!r} lacks its depthParam')
    _, a, b = _HEADER.unpack_from(data)
    with np.errstate(all='ignore'):
        depth = np.where(values > 0, np.float32(a) / (values.astype(np.float32) - np.float32(b)), np.nan)
    return _image(message, '32FC1', depth.astype('<f4'))


def _pixels(data: bytes, mode: str) -> NDArray[Any]:
    """Pixels of an image file: (h, w) of 16 bit, or (h, w, 3) where a mode is asked for."""
    try:
        with PillowImage.open(io.BytesIO(data)) as image:
            if image.width * image.height > MAX_POINTS:
                raise MalformedMessage(f'image of {image.width} x {image.height} pixels is too large')
            kind = image.mode
            pixels = np.asarray(image.convert(mode) if mode else image)
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        if isinstance(error, MalformedMessage):
            raise
        raise MalformedMessage(f'compressed image cannot be read: {error}') from None
    if not mode and not kind.startswith('I'):
        raise MalformedMessage(f'compressed depth has pixels of {kind}, not of 16 bit')
    return pixels.astype(np.uint8 if mode else '<u2')


def _image(message: Any, encoding: str, pixels: NDArray[Any]) -> Any:
    height, width = pixels.shape[:2]
    return SimpleNamespace(
        header=message.header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.nbytes // max(1, height),
        data=np.ascontiguousarray(pixels).reshape(-1).view(np.uint8),
    )
