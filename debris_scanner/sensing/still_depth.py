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

"""Which pixels of a depth image show something that stands still.

Marks in an image (h, w) say so, and nothing is copied: each pixel is read a few times.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import inlined, kernel

Marks = NDArray[np.uint8]
Region = tuple[int, int, int, int]  # first row, row after the last, first column, column after the last

IN_BOX, STILL, MOVED = 1, 2, 4  # marks of a pixel; what is not in the box has none

CONFIRMED_S = 1.0  # a depth that lasts this long stands still
# Equal depths differ by less than the noise: a Kinect's, which grows with the square of the depth
# (Khoshelham and Elberink 2012), but at most 2 % of it, and never less than some pixels.
TOLERANCE = 0.009  # 1/m, times the square of the depth
MOST_TOLERANCE = 0.02  # of the depth
LEAST_TOLERANCE = 3.0  # px
LAPSE = 3.0  # a differing depth outweighs this many equal ones
LONGEST_STEP_S = 0.2  # a longer gap between frames counts as this


class StillDepth:
    """Tracks the depth under every pixel and where it has lasted, also behind what passes in front."""

    def __init__(self) -> None:
        self._camera: Camera | None = None
        self._stamp_ns = 0
        self.observed_s = 0.0  # since the first frame

    def observe(
        self,
        camera: Camera,
        stamp_ns: int,
        depth: NDArray[np.float32],
        marks: Marks,
        region: Region | None = None,
    ) -> None:
        """Learn from the pixels in the box (h, w), and mark those that stand still, and those that moved.

        Outside of ``region``, if there is one, nothing was looked at.
        """
        shape = (camera.height, camera.width)
        whole = (0, shape[0], 0, shape[1])
        if self._camera is None or not camera.resembles(self._camera):
            self._camera, self._stamp_ns, self.observed_s = camera, stamp_ns, 0.0
            self._mean, self._lasting = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
            self._lasted = np.zeros(shape, np.float32)  # s
            self._region, self._missed_s = whole, 0.0
        step = min((stamp_ns - self._stamp_ns) * 1e-9, LONGEST_STEP_S)
        self._stamp_ns = stamp_ns
        self.observed_s += step
        _observe(
            depth,
            marks,
            np.array(region or whole),
            step,
            step + self._missed_s,
            np.array(self._region),
            LEAST_TOLERANCE / camera.focal,
            self._mean,
            self._lasted,
            self._lasting,
        )
        if region is None:
            self._region, self._missed_s = whole, 0.0
        else:
            self._region, self._missed_s = region, self._missed_s + step

    def recall(self, camera: Camera, depth: NDArray[np.float32], marks: Marks) -> None:
        """Mark the pixels in the box that show what is known to stand still; nothing is learnt."""
        if self._camera is not None and camera.resembles(self._camera):
            _recall(depth, marks, LEAST_TOLERANCE / camera.focal, self._lasting)

    def unsettled_between(
        self,
        depth: NDArray[np.float32],
        camera: Camera,
        inner: Region,
        outer: Region,
        low: float,
        high: float,
    ) -> int:
        """Pixels between two regions that show, between two depths, what is not known to stand still."""
        least = LEAST_TOLERANCE / camera.focal
        around = np.array([*outer, *inner])
        return _unsettled_between(depth, self._lasting, around, least, low, high)

    def lasting(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
        """Depths (n,), metres, that have lasted here, also behind what passes; 0 where none has."""
        return self._lasting[rows, columns].astype(float)


def still_tolerance(depth: Array, focal: float) -> Array:
    """By how much equal depths (n,), metres, may differ."""
    least = LEAST_TOLERANCE / focal * depth
    return np.maximum(np.minimum(TOLERANCE * depth**2, MOST_TOLERANCE * depth), least)


@inlined
def tolerance(z: float, least: float) -> float:
    """:func:`still_tolerance` of one depth; ``least`` is that of a metre."""
    return max(min(TOLERANCE * z * z, MOST_TOLERANCE * z), least * z)


@kernel()
def _observe(
    depth: NDArray[np.float32], marks: Marks, region: NDArray[np.intp], usual_step: float, long_step: float,
    before: NDArray[np.intp], least: float,
    mean: NDArray[np.float32], lasted: NDArray[np.float32], lasting: NDArray[np.float32],
) -> None:  # fmt: skip
    """Learn from pixels; those outside of the region before were not looked at for longer.

    Without branches in the inner loop, several pixels are computed at a time.
    """
    v0, v1, u0, u1 = before
    begin, end = region[2], region[3]
    moved, still = np.uint8(MOVED if usual_step > 0 else 0), np.uint8(STILL)
    none = np.uint8(0)
    for v in range(region[0], region[1]):
        seen, z_row, mark = v0 <= v < v1, depth[v, begin:end], marks[v, begin:end]
        mean_row, lasted_row, lasting_row = mean[v, begin:end], lasted[v, begin:end], lasting[v, begin:end]
        for k in range(end - begin):
            z, level, since, last = float(z_row[k]), mean_row[k], lasted_row[k], lasting_row[k]
            most = tolerance(z, least)
            step = usual_step if seen and u0 <= k + begin < u1 else long_step
            used, same = mark[k] > 0, abs(z - level) < most
            longer = np.float32(min(since + step, 2 * CONFIRMED_S))
            shorter = np.float32(since - LAPSE * step)
            nearer, over = np.float32(level + 0.1 * (z - level)), shorter <= 0
            level_now = nearer if same else (np.float32(z) if over else level)
            since_now = longer if same else (np.float32(0) if over else shorter)
            last_now = level_now if same and longer >= CONFIRMED_S else last
            mean_row[k] = level_now if used else level
            lasted_row[k] = since_now if used else since
            lasting_row[k] = last_now if used else last
            found = (none if same else moved) | (still if abs(z - last_now) < most else none)
            mark[k] = (mark[k] | found) if used else none


@kernel()
def _recall(depth: NDArray[np.float32], marks: Marks, least: float, lasting: NDArray[np.float32]) -> None:
    for v in range(marks.shape[0]):
        for u in range(marks.shape[1]):
            z = float(depth[v, u])
            if marks[v, u] and abs(z - lasting[v, u]) < tolerance(z, least):
                marks[v, u] |= STILL


@kernel()
def _unsettled_between(
    depth: NDArray[np.float32], lasting: NDArray[np.float32], around: NDArray[np.intp], least: float,
    low: float, high: float,
) -> int:  # fmt: skip
    """Pixels of a region, without one inside of it (8,), between two depths, that differ from what lasts."""
    a, d, b, c, v0, v1, u0, u1 = around
    n = 0
    for v in range(a, d):
        middle = (u0, u1) if v0 <= v < v1 else (c, c)
        n += _unsettled(depth[v, b : middle[0]], lasting[v, b : middle[0]], least, low, high)
        n += _unsettled(depth[v, middle[1] : c], lasting[v, middle[1] : c], least, low, high)
    return n


@inlined
def _unsettled(
    depth: NDArray[np.float32], lasting: NDArray[np.float32], least: float, low: float, high: float
) -> int:
    """Pixels (n,) between two depths that differ from what lasts."""
    n = 0
    for k in range(len(depth)):
        z = float(depth[k])
        n += int((low <= z) & (z <= high) & (abs(z - lasting[k]) >= tolerance(z, least)))
    return n
