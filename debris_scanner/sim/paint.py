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

"""Paint on a simulated target: colours fixed to its points, whatever its attitude."""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array, apply, inverse

STRIPE_M = 0.06  # width of the stripes along each axis
BACKGROUND = (30, 30, 34)
_DARK, _BRIGHT = 60, 220  # of each colour


def paint(
    depth_mm: NDArray[np.integer] | NDArray[np.floating], camera: Camera, T_sensor_target: Array
) -> NDArray[np.uint8]:
    """Colours (h, w, 3) of a depth image, millimetres, 0 invalid.

    Soft stripes: red along the target's x axis, green along y, blue along z.
    """
    rgb = np.empty((*depth_mm.shape, 3), np.uint8)
    rgb[:] = BACKGROUND
    v, u = np.nonzero(depth_mm)
    z = depth_mm[v, u] * 0.001
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=1)
    rgb[v, u] = paint_at(apply(inverse(T_sensor_target), points))
    return rgb


def paint_at(points: Array) -> NDArray[np.uint8]:
    """Colours (n, 3) of points (n, 3) of the target, metres, target frame."""
    wave = 0.5 + 0.5 * np.sin(points * (np.pi / STRIPE_M))
    return np.asarray(np.rint(_DARK + (_BRIGHT - _DARK) * wave), np.uint8)
