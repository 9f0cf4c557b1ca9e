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

"""How much of its turn a target has shown."""

import numpy as np
import scipy

from debris_scanner.core.geometry import Array, rotation_angle

WHOLE_TURN = 2 * np.pi
LEAST_STEP = np.radians(3.0)  # between attitudes that are kept: well above their noise
MOST_KEPT = 2000  # attitudes; a target that only rocks must not fill the memory


def turn_words(shown: float) -> str:
    """A turn of so many radians in words for whoever turns the target."""
    if shown < WHOLE_TURN:
        return f'turn on: {min(np.degrees(shown), 359):.0f}° of 360° seen'
    return 'a whole turn seen'


class TurnWatch:
    """Measures the turn about the main axis while it goes on; to and fro does not add up, nor does noise.

    Attitudes of another target frame continue where the last ended.
    """

    def __init__(self) -> None:
        self._frame = ''
        self._kept: list[Array] = []

    def add(self, frame: str, R_sensor_target: Array) -> None:
        """The attitude (3, 3) now, in the target frame of that name; less than half a turn from the last."""
        if not self._kept:
            self._kept.append(R_sensor_target)
        elif frame != self._frame:  # they differ by a constant turn on the target's side
            R_old_new = self._kept[-1].T @ R_sensor_target
            self._kept = [R @ R_old_new for R in self._kept]
        elif len(self._kept) < MOST_KEPT and rotation_angle(self._kept[-1].T @ R_sensor_target) > LEAST_STEP:
            self._kept.append(R_sensor_target)
        self._frame = frame

    @property
    def shown(self) -> float:
        """Radians between the two ends of the turn so far; more than 2π after a whole turn."""
        if len(self._kept) < 2:
            return 0.0
        R = np.array(self._kept)
        between = scipy.spatial.transform.Rotation.from_matrix(R[1:] @ np.swapaxes(R[:-1], 1, 2))
        steps = between.as_rotvec()  # sensor frame
        axis = np.linalg.eigh(steps.T @ steps)[1][:, -1]
        return float(np.ptp(np.concatenate([[0.0], np.cumsum(steps @ axis)])))
