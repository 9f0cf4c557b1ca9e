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

"""The rate of the frames: what counts as a gap, and how long to wait for evidence.

Evidence comes with frames, not with seconds. Bounds in time are declared for :data:`USUAL_HZ`; with a slower
sensor they stretch by as much, so that they span as many frames.
"""

import statistics
from collections import deque
from collections.abc import Iterable

USUAL_HZ = 10.0  # at this rate and above, bounds in time are as declared
REMEMBERED = 15  # intervals; their median is the usual one


class Cadence:
    """The usual interval between frames, from their stamps (ns)."""

    def __init__(self, stamps_ns: Iterable[int] = ()) -> None:
        self._intervals: deque[int] = deque(maxlen=REMEMBERED)
        self._last_ns: int | None = None
        for stamp_ns in stamps_ns:
            self.add(stamp_ns)

    def add(self, stamp_ns: int) -> None:
        """Add the next frame, used or not."""
        if self._last_ns is not None:
            self._intervals.append(stamp_ns - self._last_ns)
        self._last_ns = stamp_ns

    @property
    def stretch(self) -> float:
        """Factor of bounds in time, at least 1."""
        if not self._intervals:
            return 1.0
        return max(1.0, statistics.median(self._intervals) * 1e-9 * USUAL_HZ)

    def span_s(self, frames: float) -> float:
        """How long so many frames take, s: of a fast sensor as long as at the usual rate."""
        return frames / USUAL_HZ * self.stretch
