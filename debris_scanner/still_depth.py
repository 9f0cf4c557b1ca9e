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

"""Which pixels of a depth image show something that stands still before the sensor.

What turns changes the depth under nearly every pixel it covers within a second; a wall, a table or a
mug beside the target does not.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from debris_scanner.camera import Camera
from debris_scanner.geometry import Array

CONFIRMED_S = 1.0  # a depth that lasts this long stands still
TOLERANCE = 0.009  # 1/m: equal depths differ by less than this times their square (disparity noise)
LAPSE = 3.0  # a differing depth outweighs this many equal ones
LONGEST_STEP_S = 0.2  # a longer gap between frames counts as this


class StillDepth:
    """Remembers the depth under every pixel, and where it has lasted, also behind what passes in front."""

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._stamp_ns = 0
        self.observed_s = 0.0  # since the first frame

    def observe(
        self, camera: Camera, stamp_ns: int, rows: NDArray[np.int32], columns: NDArray[np.int32], depth: Array
    ) -> NDArray[np.bool_]:
        """Which of the pixels (n,), with their depths (n,) in metres, stand still; others hold no depth."""
        if self._camera is None or not camera.resembles(self._camera):
            self._camera, self._stamp_ns, self.observed_s = camera, stamp_ns, 0.0
            shape = (camera.height, camera.width)
            self._mean, self._lasting = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
            self._lasted = np.zeros(shape, np.float32)  # s
        step = min((stamp_ns - self._stamp_ns) * 1e-9, LONGEST_STEP_S)
        self._stamp_ns = stamp_ns
        self.observed_s += step
        still = np.empty(len(depth), np.bool_)
        _observe(rows, columns, depth, step, self._mean, self._lasted, self._lasting, still)
        return still


@njit(cache=True, nogil=True, error_model='numpy')
def _observe(
    rows: NDArray[np.int32], columns: NDArray[np.int32], depth: Array, step: float,
    mean: NDArray[np.float32], lasted: NDArray[np.float32], lasting: NDArray[np.float32],
    still: NDArray[np.bool_],
) -> None:  # fmt: skip
    for k in range(len(depth)):
        v, u, z = rows[k], columns[k], depth[k]
        tolerance = TOLERANCE * z * z
        if abs(z - mean[v, u]) < tolerance:
            mean[v, u] += 0.1 * (z - mean[v, u])
            lasted[v, u] = min(lasted[v, u] + step, 2 * CONFIRMED_S)
            if lasted[v, u] >= CONFIRMED_S:
                lasting[v, u] = mean[v, u]
        else:
            lasted[v, u] -= LAPSE * step
            if lasted[v, u] <= 0:
                mean[v, u], lasted[v, u] = z, 0.0
        still[k] = abs(z - lasting[v, u]) < tolerance
