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

"""What a sensor does to its depths as a cloud of the spline's coefficients, latched on ``depth_offset``."""

from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2

from debris_scanner.sensing.depth_offset import NO_OFFSET, SUPPORT, DepthOffset
from msg_adapters.clouds import cloud_message, read_fields
from msg_adapters.errors import MalformedMessage

LARGEST = 256  # coefficients in a row or column
LARGEST_SHARE = 0.1  # of the depth: no sensor is so wrong


def depth_offset_message(offset: DepthOffset, stamp_ns: int, frame_id: str) -> PointCloud2:
    """Organised cloud of the coefficients: x, y are tangents of the ray, z is 1, ``share`` is of the depth.

    It is empty where there is no offset.
    """
    if offset.is_none:
        return cloud_message(stamp_ns, frame_id, dict.fromkeys(('x', 'y', 'z', 'share'), np.zeros(0)))
    columns, rows = offset.coefficients.shape
    # a cubic spline's coefficient counts most one step into its first cell
    x = (offset.first[0] - 1 + np.arange(columns)) * offset.step
    y = (offset.first[1] - 1 + np.arange(rows)) * offset.step
    across, down = np.meshgrid(x, y)
    fields = {'x': across, 'y': down, 'z': np.ones_like(across), 'share': offset.coefficients.T.copy()}
    return cloud_message(stamp_ns, frame_id, fields)


def read_depth_offset(cloud: Any) -> DepthOffset:
    """The inverse of :func:`depth_offset_message`.

    Raises:
        MalformedMessage: the message contradicts itself, or is no lattice of shares of the depth.
    """
    x, y, share = read_fields(cloud, ('x', 'y', 'share')).values()
    if not share.size:
        return NO_OFFSET
    if share.ndim != 2 or min(share.shape) < SUPPORT or max(share.shape) > LARGEST:
        raise MalformedMessage(f'a depth offset of {share.shape} coefficients')
    if not (np.isfinite([x, y, share]).all() and np.abs(share).max() <= LARGEST_SHARE):
        raise MalformedMessage('a depth offset that is not finite, or too large')
    step = float(x[0, 1] - x[0, 0])
    steps = np.concatenate([np.diff(x, axis=1).ravel(), np.diff(y, axis=0).ravel()])
    if not step > 0 or not np.allclose(steps, step, rtol=1e-3):
        raise MalformedMessage('the steps of a depth offset are not even')
    first = round(float(x[0, 0]) / step) + 1, round(float(y[0, 0]) / step) + 1
    return DepthOffset(step, first, np.ascontiguousarray(share.T, np.float64))
