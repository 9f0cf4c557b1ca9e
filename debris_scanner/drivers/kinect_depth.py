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

"""Depth from a Kinect v1's raw disparity, by the zero plane that each device was calibrated to.

After libfreenect 0.5, src/registration.c (raw_to_mm, camera_to_world); lengths in its units.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera

WIDTH, HEIGHT = 640, 480
NO_RAW = 2047  # the 11-bit value that means no measurement
MAX_MM = 10_000  # libfreenect discards depths beyond it
_STEPS_PER_PIXEL = 4  # of raw disparity, on the sensor's 1280 pixels
_OFFSET_PX = 0.375

# Approximate colour camera of a Kinect v1: ROS's freenect_camera takes 1050 px at 1280 pixels across.
COLOUR_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, WIDTH, HEIGHT)


@dataclass(frozen=True)
class ZeroPlane:
    """A device's calibration; the defaults, of a typical one, are for recordings without."""

    emitter_cm: float = 7.5  # from the infrared camera to the projector
    focal_mm: float = 120.0  # libfreenect's reference_distance
    pixel_mm: float = 0.1042  # of the zero plane, at 1280 pixels across
    const_shift_px: float = 200.0

    @property
    def camera(self) -> Camera:
        """Camera of the infrared image, 640 x 480: half of its 1280 pixels, centred as in camera_to_world."""
        focal = self.focal_mm / (2 * self.pixel_mm)
        return Camera(focal, focal, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)

    def table_mm(self) -> NDArray[np.uint16]:
        """Depth, millimetres, of each of the 2048 raw values; 0 where invalid. Rounded, not truncated."""
        raw = np.arange(NO_RAW + 1)
        shift = (raw / _STEPS_PER_PIXEL - self.const_shift_px - _OFFSET_PX) * self.pixel_mm
        with np.errstate(divide='ignore'):
            depth = 10 * (shift * self.focal_mm / (self.emitter_cm - shift) + self.focal_mm)
        valid = (shift < self.emitter_cm) & (depth > 0) & (depth < MAX_MM) & (raw < NO_RAW)
        return np.where(valid, np.rint(depth), 0).astype(np.uint16)
