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

"""Rays of a simulated sensor whose lens distorts: what is rendered along them is what it would send."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array
from debris_scanner.sensing.rectification import Distortion
from debris_scanner.sim.rays import PinholeRays, Window

STEP = 1e-6  # of the derivatives


def undistorted(lens: Distortion, x: Array, y: Array) -> Array:
    """The rays (2, ...) that a lens brings to the places x, y of an image of focal length 1, by Newton."""
    wanted = np.stack([x, y]).astype(np.float64)
    at = wanted.copy()
    for _ in range(30):
        here = np.stack(lens.distorted(*at))
        miss = wanted - here
        if np.abs(miss).max() < 1e-9:
            return at
        along_x = (np.stack(lens.distorted(at[0] + STEP, at[1])) - here) / STEP
        along_y = (np.stack(lens.distorted(at[0], at[1] + STEP)) - here) / STEP
        det = along_x[0] * along_y[1] - along_x[1] * along_y[0]
        at[0] += (miss[0] * along_y[1] - miss[1] * along_y[0]) / det
        at[1] += (miss[1] * along_x[0] - miss[0] * along_x[1]) / det
    raise ValueError(f'no rays found for {lens}')


@dataclass(frozen=True)
class LensRays(PinholeRays):
    """Rays of a camera with a lens; their z is 1."""

    camera: Camera
    lens: Distortion

    def directions(self, u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        """Directions (..., 3) of z = 1."""
        camera = self.camera
        x, y = undistorted(self.lens, (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
        return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)

    def window(self, vertices: NDArray[np.float32], T: Array) -> Window | None:
        """The whole image: the simpler bound."""
        del vertices, T
        return (0, 0, self.camera.width, self.camera.height)
