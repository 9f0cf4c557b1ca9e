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

"""One line of time from a sensor's stamps: jumps, loops and repeats are noticed, counted and survived.

A frame's stamp is its name, so it is left alone as long as time goes forward as it should. When the
sensor's clock jumps, or a recording begins anew, the stamps from there on are moved, all by the same, so
that time goes on: the filter must not predict over an hour that never was, nor frames be refused for one.
"""

from collections import Counter, deque

import numpy as np

JUMP_S = 5.0  # stamps and the clock on the wall may disagree so much over one gap
PERSISTENT = 3  # frames in a row that lie back in time: no straggler, time itself has gone back
FASTEST = 100.0  # a recording is not played faster
_RATES = 20

BACKWARDS, FORWARDS, REPEATED, LATE = 'back_jumps', 'forward_jumps', 'repeated', 'late'


class StampLine:
    """Places stamps, nanoseconds, on one line of time."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.shift_ns = 0
        self.remark = ''  # on the last jump, for the log; whoever reads it clears it
        self.reset()

    def reset(self) -> None:
        """A new scan takes stamps as they come."""
        self.counts.clear()
        self.shift_ns = 0
        self._last: tuple[int, float] | None = None  # placed stamp and arrival
        self._back: deque[int] = deque(maxlen=PERSISTENT)
        self._period_ns = 0
        self._speeds: deque[float] = deque(maxlen=_RATES)

    def place(self, stamp_ns: int, arrival_s: float) -> int:
        """The stamp on the line of time; not later than the last one for a frame out of its turn.

        Args:
            stamp_ns: of the header.
            arrival_s: when it came, on a clock that only goes forward.
        """
        placed = stamp_ns + self.shift_ns
        if self._last is None:
            self._last = placed, arrival_s
            return placed
        last_ns, last_s = self._last
        if placed <= last_ns:
            placed = self._backward(stamp_ns, last_ns)
        elif (placed - last_ns) * 1e-9 - (arrival_s - last_s) * self._speed > JUMP_S:
            gap_ns = max(self._period_ns, round((arrival_s - last_s) * self._speed * 1e9))
            placed = self._move(stamp_ns, last_ns + max(1, gap_ns), FORWARDS)
        if placed > last_ns:
            self._back.clear()
            self._learn(placed - last_ns, arrival_s - last_s)
            self._last = placed, arrival_s
        return placed

    def _backward(self, stamp_ns: int, last_ns: int) -> int:
        if stamp_ns + self.shift_ns == last_ns:
            self.counts[REPEATED] += 1
            return last_ns
        self.counts[LATE] += 1
        if self._back and stamp_ns <= self._back[-1]:
            self._back.clear()
        self._back.append(stamp_ns)
        if len(self._back) < PERSISTENT:
            return stamp_ns + self.shift_ns
        steps = stamp_ns - self._back[0]
        return self._move(stamp_ns, last_ns + max(self._period_ns, 1) + steps, BACKWARDS)

    def _move(self, stamp_ns: int, placed: int, kind: str) -> int:
        before, self.shift_ns = self.shift_ns, placed - stamp_ns
        self.counts[kind] += 1
        direction = 'back' if kind == BACKWARDS else 'forward'
        self.remark = (
            f'stamps jumped {direction} by {abs(self.shift_ns - before) * 1e-9:.3f} s at {stamp_ns}: it '
            f'goes on with stamps moved by {self.shift_ns * 1e-9:+.9f} s (~/reset takes them as they come)'
        )
        return placed

    @property
    def _speed(self) -> float:
        """Seconds of the stamps in one on the wall: a recording may be played fast."""
        return min(float(np.median(self._speeds)), FASTEST) if len(self._speeds) >= 5 else 1.0

    def _learn(self, gap_ns: int, wall_s: float) -> None:
        self._period_ns = gap_ns if not self._period_ns else min(gap_ns, 2 * self._period_ns)
        self._speeds.append(gap_ns * 1e-9 / max(wall_s, 1e-3))
