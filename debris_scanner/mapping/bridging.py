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

"""How far a target can have turned while it was out of sight.

Equal faces look alike; the motion tells them apart. A free target turns on, by the mean of the rates before
and after, give or take the difference: a tumbling one's rate may swing as far beyond them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, exp_so3, log_so3, rotation_angle
from debris_scanner.core.results import Check, Checks

STEPS = 3  # of key frames before and after, of which the rates are known
RATE_ERROR = 0.2  # of the rates: friction, a push, a recording that was paused
ANOTHER_FACE = np.radians(45.0)  # equal faces of a box are a quarter of a turn apart


@dataclass(frozen=True)
class Bridge:
    """A stretch out of sight between two parts: how the pose after it compares with the motion."""

    gap_s: float
    off: float  # rad, from where the rates lead
    known: float  # rad, how well they know it

    @property
    def leads_here(self) -> bool:
        """Whether the target can have turned so."""
        return self.off < self.known + ANOTHER_FACE

    @property
    def checks(self) -> Checks:
        """By how much the pose after it may be off where the rates lead, and how long it is."""
        off, most = np.degrees([self.off, self.known + ANOTHER_FACE])
        turn = Check('off_motion_deg', float(off), float(most), self.leads_here)
        return turn, Check('out_of_sight_s', self.gap_s)


class FreeMotion:
    """What the rates of key frames, in order of time, say of their poses after a stretch out of sight.

    Args:
        stamps_ns: (n,).
        linked: (n,) whether each was tracked from the one before.
        followed: (n,) whether the target was in sight all the time since the one before. In sight it may
            stop, as on a turntable; out of sight it is taken to turn on.
    """

    def __init__(self, stamps_ns: Sequence[int], linked: Sequence[bool], followed: Sequence[bool]) -> None:
        self._t = (np.asarray(stamps_ns, np.int64) - stamps_ns[0]) * 1e-9
        self._linked, self._followed = linked, followed

    def leads(self, poses: Sequence[Array], part: Sequence[int] | NDArray[Any]) -> bool:
        """Whether the target can have turned from each part to the next.

        Args:
            poses: T_target_sensor (4, 4), n of them.
            part: (n,) number of the part of each.
        """
        bridge = self.worst_bridge(poses, part)
        return bridge is None or bridge.leads_here

    def worst_bridge(self, poses: Sequence[Array], part: Sequence[int] | NDArray[Any]) -> Bridge | None:
        """The least likely bridge between two parts; None where no rates are known."""
        R, bridges = [T[:3, :3] for T in poses], []
        for a, b in pairwise(range(len(R))):
            if part[a] == part[b] or self._followed[b]:
                continue
            before, after = self._rate(R, a, -1), self._rate(R, b, 1)
            if before is None or after is None:
                continue
            mean, gap = 0.5 * (before + after), float(self._t[b] - self._t[a])
            off = rotation_angle((R[a] @ exp_so3(-mean * gap)).T @ R[b])
            swing = float(np.linalg.norm(after - before)) + RATE_ERROR * float(np.linalg.norm(mean))
            bridges.append(Bridge(gap, off, gap * swing))
        return max(bridges, key=lambda bridge: bridge.off - bridge.known, default=None)

    def _rate(self, R: Sequence[Array], start: int, step: int) -> Array | None:
        """As the sensor sees it (3,), rad/s, over some key frames from one on; None if it is alone."""
        end = start
        while abs(end - start) < STEPS and 0 <= end + step < len(R) and self._linked[max(end, end + step)]:
            end += step
        a, b = sorted((start, end))
        dt = float(self._t[b] - self._t[a])
        return log_so3(R[b].T @ R[a]) / dt if dt > 0 else None
