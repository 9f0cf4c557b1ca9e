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

"""The target alone, as it travels between nodes: an organised cloud of its window.

No side channel carries the window's camera: it is fitted to the points (a pinhole camera puts the point of
column u at x/z = (u - cx)/fx), so the cloud also displays correctly in any viewer.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.camera import fit_pinhole
from debris_scanner.core.frames import TargetFrame
from msg_adapters.clouds import cloud_message, read_cloud, read_scalars
from msg_adapters.errors import MalformedMessage

_FITTED = ('normal_x', 'normal_y', 'normal_z', 'depth_fit')


def target_frame_message(frame: TargetFrame, frame_id: str) -> PointCloud2:
    """Organised cloud (h, w) of the window, metres, in the sensor's optical frame ``frame_id``.

    Fields: x, y, z of the depth as measured, NaN off the target; normal_x, normal_y, normal_z and
    depth_fit, 0 where no plane fits; and packed rgb if the frame has colours.
    """
    camera = frame.camera
    z = np.where(frame.depth > 0, frame.depth, np.float32(np.nan)).astype(np.float32, copy=False)
    u = (np.arange(z.shape[1]) - camera.cx) / camera.fx
    v = (np.arange(z.shape[0]) - camera.cy) / camera.fy
    fields: dict[str, NDArray[Any]] = {
        'x': (u[None, :] * z).astype(np.float32),
        'y': (v[:, None] * z).astype(np.float32),
        'z': z,
    }
    fields |= {f'normal_{axis}': frame.normals[..., i].astype(np.float32) for i, axis in enumerate('xyz')}
    fields['depth_fit'] = frame.depth_fit.astype(np.float32)
    return cloud_message(frame.stamp_ns, frame_id, fields, frame.rgb)


def read_target_frame(msg: Any) -> TargetFrame:
    """Target frame of an organised cloud: the inverse of :func:`target_frame_message`.

    Depth, fit, normals and colours come back exactly, the camera within 1e-3 pixels.

    Raises:
        MalformedMessage: the cloud contradicts itself, lacks a field, or no pinhole camera explains it
            (as for a target of fewer than 50 pixels).
    """
    cloud = read_cloud(msg)
    fields = read_scalars(msg, _FITTED)
    camera = fit_pinhole(cloud.xyz)
    if camera is None:
        raise MalformedMessage(f'no pinhole camera explains the target cloud of shape {cloud.xyz.shape[:-1]}')
    z = cloud.xyz[..., 2]
    return TargetFrame(
        stamp_ns=cloud.stamp_ns,
        camera=camera,
        depth=np.where(np.isfinite(z) & (z > 0), z, np.float32(0)),
        depth_fit=_finite(fields['depth_fit']),
        normals=np.stack([_finite(fields[f'normal_{axis}']) for axis in 'xyz'], axis=-1),
        rgb=cloud.rgb,
    )


def _finite(values: NDArray[Any]) -> NDArray[np.float32]:
    """The values as float32, 0 where they are not numbers."""
    with np.errstate(over='ignore', invalid='ignore'):
        single = values.astype(np.float32)
    return np.where(np.isfinite(single), single, np.float32(0))
