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

"""Depth images from sensor_msgs/Image, and depth frames to Image with CameraInfo, and to PointCloud2.

Depth images are 16UC1, millimetres, 0 invalid, or 32FC1, metres, NaN and Inf invalid (REP-118).
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.clouds import MAX_POINTS, byte_array, cloud_message, message_bytes
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import header_message

MONO16 = 'mono16'  # what kinect_ros2 calls its millimetres, and others their infrared
DEPTH_ENCODINGS: dict[str, np.dtype[Any]] = {
    '16UC1': np.dtype('u2'),
    '32FC1': np.dtype('f4'),
    MONO16: np.dtype('u2'),
}


def read_depth(image: Any, unit: float = 0.0) -> NDArray[np.float32]:
    """Depth (h, w) float32 of an Image, metres, 0 where it is invalid.

    ``unit`` is metres a unit of the image; 0: a millimetre in 16 bit, a metre in floats.

    Raises:
        MalformedMessage: not a depth encoding, absurdly large, or shorter than it says.
    """
    height, width, step = int(image.height), int(image.width), int(image.step)
    dtype = DEPTH_ENCODINGS.get(str(image.encoding))
    if dtype is None:
        raise MalformedMessage(
            f'image encoding {image.encoding!r} is not a depth: {", ".join(DEPTH_ENCODINGS)}'
        )
    if height * width > MAX_POINTS:
        raise MalformedMessage(f'image of {width} x {height} pixels is larger than the limit of {MAX_POINTS}')
    if step < width * dtype.itemsize:
        raise MalformedMessage(f'image step {step} is shorter than {width} pixels of {dtype.itemsize} bytes')
    if len(image.data) < step * height:
        raise MalformedMessage(
            f'image data has {len(image.data)} bytes, {height} rows of {step} bytes announced'
        )
    if 0 in (height, width):
        return np.zeros((height, width), np.float32)
    dtype = dtype.newbyteorder('>' if image.is_bigendian else '<')
    pixels = np.ndarray((height, width), dtype, message_bytes(image.data), 0, (step, dtype.itemsize))
    if dtype.kind == 'u':
        return pixels * np.float32(unit or 0.001)
    with np.errstate(over='ignore', invalid='ignore'):
        metres = pixels.astype(np.float32) * np.float32(unit or 1.0)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def depth_image_message(
    stamp_ns: int, frame_id: str, depth: NDArray[np.float32], encoding: Literal['16UC1', '32FC1'] = '32FC1'
) -> Image:
    """Image of a depth (h, w), metres, 0 or NaN where there is none; 16UC1 rounds to the millimetre.

    Depth that 16UC1 cannot hold (beyond 65.535 m) becomes invalid.
    """
    valid = np.isfinite(depth) & (depth > 0)
    if encoding == '16UC1':
        millimetres = np.rint(np.where(valid, depth, 0) * np.float64(1000))
        pixels: NDArray[Any] = np.where(millimetres < 2**16, millimetres, 0).astype('<u2')
    else:
        pixels = np.where(valid, depth, np.nan).astype('<f4')
    height, width = depth.shape
    return Image(
        header=header_message(stamp_ns, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width * pixels.itemsize,
        data=byte_array(pixels),
    )


def camera_info_message(stamp_ns: int, frame_id: str, camera: Camera) -> CameraInfo:
    """CameraInfo of a pinhole camera without distortion."""
    return CameraInfo(
        header=header_message(stamp_ns, frame_id),
        height=camera.height,
        width=camera.width,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=[camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def organised_cloud(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Points (h, w, 3) of a depth image (h, w), metres, optical frame, NaN where there is no depth."""
    return camera.back_project(depth)


def cloud_frame_message(frame: DepthFrame, frame_id: str) -> PointCloud2:
    """Organised cloud (h, w) of a depth frame with its colours, as a Kinect's driver sends it."""
    points = organised_cloud(frame.depth, frame.camera)
    return cloud_message(
        frame.stamp_ns, frame_id, {axis: points[..., i] for i, axis in enumerate('xyz')}, frame.rgb
    )
