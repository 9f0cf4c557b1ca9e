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

"""Target frames and key frames in compact form, as journal records or in memory.

Depth is stored in whole millimetres, or as finely as 16 bits allow, and compressed. A window of 250 x 150
pixels takes 12 kB in millimetres.
Depth that the sensor measured in whole millimetres comes back exactly; planes are fitted again on reading.
"""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings

_MOST = 65535  # of 16 bits
_MILLIMETRE = 1e-3  # unit of depth cameras
_FAST = 1  # zlib level: better ones gain a tenth and take five times as long


def pack_frame(frame: TargetFrame, with_depth: bool = True) -> dict[str, Any]:
    """Values of a record; ``with_depth`` false keeps only stamp and camera."""
    camera = frame.camera
    values: dict[str, Any] = {
        'stamp_ns': frame.stamp_ns,
        'camera': [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height],
    }
    if with_depth:
        values['unit'], values['depth'] = quantised(frame.measured)
        if frame.rgb is not None:
            values['rgb'] = frame.rgb
    return values


def unpack_frame(
    values: dict[str, Any], normals: NormalSettings | None, offset: DepthOffset = NO_OFFSET
) -> TargetFrame:
    """The frame of a record.

    Args:
        values: of :func:`pack_frame`.
        normals: settings of the plane fit; None leaves the planes out.
        offset: of the sensor, which is taken off where planes are fitted.
    """
    fx, fy, cx, cy, width, height = values['camera']
    camera = Camera(fx, fy, cx, cy, int(width), int(height))
    raw = values.get('depth')
    if raw is None:
        nothing = np.zeros((0, 0), np.float32)
        return TargetFrame(int(values['stamp_ns']), camera, nothing, nothing, np.zeros((0, 0, 3), np.float32))
    stamp_ns, depth, rgb = int(values['stamp_ns']), metres(raw, values['unit']), values.get('rgb')
    if normals is not None:
        return offset.target_frame(stamp_ns, camera, depth, normals, rgb)
    return TargetFrame(
        stamp_ns, camera, depth, np.zeros_like(depth), np.zeros((*depth.shape, 3), np.float32), rgb
    )


def pack_keyframe(keyframe: KeyFrame) -> dict[str, Any]:
    """Values of a record."""
    return pack_frame(keyframe.frame) | {
        'T_target_sensor': keyframe.T_target_sensor,
        'path_rad': float(keyframe.path_rad),
        'covariance': keyframe.covariance,
        'submap': keyframe.submap,
    }


def unpack_keyframe(values: dict[str, Any], normals: NormalSettings) -> KeyFrame:
    """The inverse of :func:`pack_keyframe`."""
    frame = unpack_frame(values, normals)
    return KeyFrame(
        frame,
        values['T_target_sensor'],
        float(values['path_rad']),
        values['covariance'],
        int(values['submap']),
    )


class PackedFrame:
    """A target frame's depth and colours, compressed."""

    def __init__(self, frame: TargetFrame) -> None:
        values = pack_frame(frame)
        self.stamp_ns = frame.stamp_ns
        self._shape = frame.depth.shape
        self._depth = zlib.compress(values.pop('depth').tobytes(), _FAST)
        rgb = values.pop('rgb', None)
        self._rgb = None if rgb is None else zlib.compress(rgb.tobytes(), _FAST)
        self._values = values

    @property
    def nbytes(self) -> int:
        """Size of the compressed data."""
        return len(self._depth) + len(self._rgb or b'')

    def restore(self, settings: NormalSettings, offset: DepthOffset = NO_OFFSET) -> TargetFrame:
        """The frame, freed from an offset of the sensor, its planes fitted again."""
        values = dict(self._values)
        values['depth'] = np.frombuffer(zlib.decompress(self._depth), np.uint16).reshape(self._shape)
        if self._rgb is not None:
            values['rgb'] = np.frombuffer(zlib.decompress(self._rgb), np.uint8).reshape(*self._shape, 3)
        return unpack_frame(values, settings, offset)


def quantised(depth: NDArray[np.float32]) -> tuple[float, NDArray[np.uint16]]:
    """Unit, metres, and multiples of it; exact for whole millimetres."""
    furthest = float(depth.max(initial=0.0))
    if furthest < _MOST * _MILLIMETRE:
        whole = np.rint(depth / _MILLIMETRE).astype(np.uint16)
        if np.array_equal(metres(whole, _MILLIMETRE), depth):
            return _MILLIMETRE, whole
    unit = furthest / _MOST if furthest > 0 else _MILLIMETRE
    return unit, np.rint(depth / unit).astype(np.uint16)


def metres(depth: NDArray[np.uint16], unit: float) -> NDArray[np.float32]:
    """The inverse of :func:`quantised`."""
    return np.asarray(depth.astype(np.float32) * np.float32(unit))
