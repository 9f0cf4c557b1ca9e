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

"""Stamps in time: one monotonic line of stamps, pairs of two streams, and the age of a frame.

A frame's stamp identifies it, so `MonotonicStamps` leaves it alone as long as time goes forward. When the
sensor's clock jumps, or a recording starts over, it shifts all later stamps by the same amount. Otherwise the
target would be lost over an hour that never was, or frames would be rejected as too old. A single frame whose
stamp is damaged is left out, and moves nothing. Jumps, loops, strays and repeats are counted.

`StampPairs` joins each image of one stream with the nearest in time of another. `SensorClock` gives the
age of a frame by this machine's clock, also of a replay, whose stamps lie in the past.
"""

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Generic, TypeVar

import numpy as np

A = TypeVar('A')
B = TypeVar('B')

JUMP_S = 5.0  # over one gap, stamps and the clock that they arrive by may disagree by this much
PERSISTENT = 3  # frames in a row that lie elsewhere in time are no strays: time itself has jumped
FASTEST = 100.0  # a recording is not played faster
BACKWARDS, FORWARDS, REPEATED = 'back_jumps', 'forward_jumps', 'repeated'
LATE, EARLY = 'late', 'early'  # frames out of order, and further ahead than time has gone on
_RATES = 20  # latest gaps that the playing speed is measured by
_KEPT = 10  # images kept of either stream
_LIVE_S = 30.0  # a live sensor's stamps are this close to the clock; anything further off is a recording


class StampPairs(Generic[A, B]):
    """Joins each image of a first stream with the nearest in time of a second.

    Pairs leave in the order of the first stream; none of it is lost. An image waits only while the second
    stream is alive, for ``patience_s`` at most, and not if a good partner is there already: at most half of
    ``within_ns`` away.

    Args:
        within_ns: largest difference of a pair's stamps, nanoseconds.
        patience_s: how late a partner may be, seconds.
        alive_s: a second stream that is silent for longer has ended, seconds.
    """

    def __init__(self, within_ns: int = 40_000_000, patience_s: float = 0.06, alive_s: float = 1.0) -> None:
        self._within_ns = within_ns
        self._patience_s = patience_s
        self._alive_s = alive_s
        self._waiting: deque[tuple[int, float, A]] = deque()
        self._partners: deque[tuple[int, B]] = deque(maxlen=_KEPT)
        self._last_s: float | None = None

    def add(self, stamp_ns: int, now_s: float, item: A) -> None:
        """One of the first stream, and its arrival time."""
        self._waiting.append((stamp_ns, now_s, item))

    def add_partner(self, stamp_ns: int, now_s: float, item: B) -> None:
        """One of the second stream."""
        self._last_s = now_s
        self._partners.append((stamp_ns, item))

    def pop(self, now_s: float) -> Iterator[tuple[A, B | None]]:
        """Images that need not wait any longer, each with its partner or None."""
        while self._waiting:
            stamp_ns, since_s, item = self._waiting[0]
            distance_ns, partner = self._nearest(stamp_ns)
            alive = self._last_s is not None and now_s - self._last_s < self._alive_s
            patient = alive and now_s - since_s < self._patience_s and len(self._waiting) <= _KEPT
            if distance_ns > self._within_ns // 2 and patient and not self._passed(stamp_ns):
                return
            self._waiting.popleft()
            yield item, partner if distance_ns <= self._within_ns else None

    def expect(self, now_s: float) -> None:
        """Announce a second stream that has not sent anything yet."""
        self._last_s = now_s

    def end_partners(self) -> None:
        """End the second stream: nothing waits for it any more."""
        self._partners.clear()
        self._last_s = None

    def clear(self) -> None:
        """Forget both streams."""
        self._waiting.clear()
        self.end_partners()

    def _nearest(self, stamp_ns: int) -> tuple[int, B | None]:
        distances = [(abs(stamp - stamp_ns), k) for k, (stamp, _) in enumerate(self._partners)]
        if not distances:
            return self._within_ns + 1, None
        distance_ns, k = min(distances)
        return distance_ns, self._partners[k][1]

    def _passed(self, stamp_ns: int) -> bool:
        """Whether the second stream is past a stamp: later partners are further away."""
        return bool(self._partners) and self._partners[-1][0] >= stamp_ns


class MonotonicStamps:
    """Places stamps, nanoseconds, on one monotonic line of time."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.shift_ns = 0
        self.remark = ''  # on the last jump, for the log; the reader clears it
        self.reset()

    def reset(self) -> None:
        """Start a new scan: take stamps as they come."""
        self.counts.clear()
        self.shift_ns = 0
        self._last: tuple[int, float] | None = None  # placed stamp and arrival
        self._elsewhere: list[int] = []  # stamps in a row that do not go on with the line
        self._period_ns = 0
        self._speeds: deque[float] = deque(maxlen=_RATES)

    def place(self, stamp_ns: int, arrival_s: float) -> int:
        """The stamp on the line of time; for a frame to be left out, not later than the last one.

        Args:
            stamp_ns: of the header.
            arrival_s: arrival time on a monotonic clock; of a recorded frame, the recording's time.
        """
        placed = stamp_ns + self.shift_ns
        if self._last is None:
            self._last = placed, arrival_s
            return placed
        last_ns, last_s = self._last
        passed_s = max(0.0, arrival_s - last_s) * self._speed
        if placed == last_ns:
            self.counts[REPEATED] += 1
            return last_ns
        if placed < last_ns or (placed - last_ns) * 1e-9 - passed_s > JUMP_S:
            self.counts[LATE if placed < last_ns else EARLY] += 1
            if self._elsewhere and stamp_ns <= self._elsewhere[-1]:
                self._elsewhere = []
            self._elsewhere.append(stamp_ns)
            if len(self._elsewhere) < PERSISTENT:
                return min(placed, last_ns)
            placed = self._move(stamp_ns, last_ns + max(1, self._period_ns, round(passed_s * 1e9)))
        self._elsewhere = []
        self._learn(placed - last_ns, arrival_s - last_s)
        self._last = placed, arrival_s
        return placed

    def follows(self, stamp_ns: int, arrival_s: float) -> bool:
        """Whether a frame goes on with the line, where stamps are left as they are; see :meth:`place`."""
        last, placed = self._last, self.place(stamp_ns, arrival_s)
        return last is None or placed > last[0]

    def _move(self, stamp_ns: int, placed: int) -> int:
        moved_ns = placed - stamp_ns - self.shift_ns
        self.shift_ns += moved_ns
        self.counts[BACKWARDS if moved_ns > 0 else FORWARDS] += 1
        self.remark = (
            f'stamps jumped {"back" if moved_ns > 0 else "forward"} by {abs(moved_ns) * 1e-9:.3f} s at '
            f'{stamp_ns}: it goes on with stamps moved by {self.shift_ns * 1e-9:+.9f} s'
        )
        return placed

    @property
    def _speed(self) -> float:
        """Stamp seconds per wall-clock second: a recording may be played fast."""
        return min(float(np.median(self._speeds)), FASTEST) if len(self._speeds) >= 5 else 1.0

    def _learn(self, gap_ns: int, wall_s: float) -> None:
        self._period_ns = gap_ns if not self._period_ns else min(gap_ns, 2 * self._period_ns)
        self._speeds.append(gap_ns * 1e-9 / max(wall_s, 1e-3))


class SensorClock:
    """Turns stamps into times of the system's clock, nanoseconds.

    A player keeps the recorded stamps, which identify the frames, and publishes in its diagnostics when it
    sent the first of them. A live sensor stamps with the clock itself.
    """

    def __init__(self) -> None:
        self._replay: tuple[int, int, float] | None = None

    def learn(self, values: Mapping[str, str]) -> None:
        """Take a player's diagnostics: first stamp, when it was published, and playing rate."""
        try:
            self._replay = (
                int(values['first_stamp_ns']),
                int(values['first_published_ns']),
                float(values['rate']),
            )
        except (KeyError, ValueError):
            return

    def age_s(self, stamp_ns: int, at_ns: int) -> float | None:
        """Age of a frame at a time of the system's clock; None where the stamps belong to another clock."""
        if self._replay is not None:
            first, published, rate = self._replay
            stamp_ns = published + round((stamp_ns - first) / rate)
        age = (at_ns - stamp_ns) * 1e-9
        return age if abs(age) < _LIVE_S else None


def replay_values(first_stamp_ns: int, first_published_ns: int, rate: float) -> dict[str, object]:
    """A player's diagnostics for :meth:`SensorClock.learn`."""
    return {'first_stamp_ns': first_stamp_ns, 'first_published_ns': first_published_ns, 'rate': rate}
