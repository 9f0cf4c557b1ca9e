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

"""Times when the target is out of sight or partially occluded: for seconds, or for good from some time on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FIRST_S = 4.0  # nothing is hidden before
_LENGTH_S = (1.0, 3.0)
_SIGHT_S = (5.0, 9.0)  # in sight between two gaps
_RAMP_S = 0.5  # a shadow's edge takes this long to cross the target
_SHADES_S = (2.0, 6.0)  # between two shades
_SHADE_SHARE = (0.3, 0.7)  # visible share of the target in a shade


@dataclass(frozen=True)
class Gaps:
    """Intervals (start, end) in seconds during which the target is out of sight."""

    intervals: tuple[tuple[float, float], ...]
    shades: tuple[tuple[float, float, float], ...] = ()  # (start, end, visible share)

    @staticmethod
    def draw(duration_s: float, seed: int, from_s: float = 0.0) -> 'Gaps':
        """Gaps of 1 to 3 s, 5 to 9 s apart, over the given time, none before ``from_s``."""
        rng = np.random.default_rng([seed, 2])
        intervals = []
        start = max(_FIRST_S, from_s) + float(rng.uniform(0.0, 2.0))
        while start < duration_s:
            end = start + float(rng.uniform(*_LENGTH_S))
            intervals.append((start, end))
            start = end + float(rng.uniform(*_SIGHT_S))
        return Gaps(tuple(intervals))

    def shaded(self, duration_s: float, seed: int) -> 'Gaps':
        """The same with shades added: for 1 to 3 s only 30 to 70 % of the target is visible."""
        rng = np.random.default_rng([seed, 6])
        shades = []
        start = float(rng.uniform(*_SHADES_S))
        while start < duration_s:
            end = start + float(rng.uniform(*_LENGTH_S))
            shades.append((start, end, float(rng.uniform(*_SHADE_SHARE))))
            start = end + float(rng.uniform(*_SHADES_S))
        return Gaps(self.intervals, tuple(shades))

    def leaving(self, t_s: float) -> 'Gaps':
        """The same, and out of sight for good from t_s on."""
        return Gaps((*self.intervals, (t_s, np.inf)), self.shades)

    def visibility(self, t_s: float) -> float:
        """Visible share of the target at t_s: 0 in a gap, with ramps of 0.5 s around it."""
        hidden = [(a, b, 0.0) for a, b in self.intervals]
        return min(
            (
                share + (1 - share) * min(max(a - t_s, t_s - b, 0.0) / _RAMP_S, 1.0)
                for a, b, share in (*hidden, *self.shades)
            ),
            default=1.0,
        )


def dark_side(depth: NDArray[np.float32], visibility: float, seed: int) -> NDArray[np.bool_]:
    """Pixels (h, w) behind a straight shadow edge that leaves the given share of the silhouette lit.

    Args:
        depth: (h, w) of the target, inf beside it.
        visibility: share of the silhouette that stays lit.
        seed: of the edge's direction.
    """
    v, u = np.nonzero(np.isfinite(depth))
    dark = np.zeros(depth.shape, bool)
    if len(v):
        angle = np.random.default_rng([seed, 5]).uniform(0, 2 * np.pi)
        along = u * np.cos(angle) + v * np.sin(angle)
        hidden = along > np.quantile(along, visibility)
        dark[v[hidden], u[hidden]] = True
    return dark
