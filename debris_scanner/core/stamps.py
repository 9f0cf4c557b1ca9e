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

"""Two streams of stamped images joined: each of the first with the nearest in time of the second.

One line of time from a sensor's stamps: jumps, loops and repeats are noticed, counted and survived.

A frame's stamp is its name, so it is left alone as long as time goes forward as it should. When the
sensor's clock jumps, or a recording begins anew, the stamps from there on are moved, all by the same, so
that time goes on: the filter must not predict over an hour that never was, nor frames be refused for one.

When the sensor saw a frame, on this machine's clock; a replay's stamps lie in the past.
"""

import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import Generic, TypeVar

import numpy as np

A = TypeVar('A')
B = TypeVar('B')

_KEPT = 10  # of either stream


class StampPairs(Generic[A, B]):
    """Pairs leave in the order of the first stream; none of it is lost, none waits long.

    One waits only while the second stream is alive, for ``patience_s`` at most, and not if there is a
    partner already than which none can be much better: at most half of ``within_ns`` away.

    Args:
        within_ns: stamps of a pair differ by so much at most, nanoseconds.
        patience_s: how long a partner may be late, seconds.
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
        """One of the first stream, and when it came."""
        self._waiting.append((stamp_ns, now_s, item))

    def add_partner(self, stamp_ns: int, now_s: float, item: B) -> None:
        """One of the second stream."""
        self._last_s = now_s
        self._partners.append((stamp_ns, item))

    def pop(self, now_s: float) -> Iterator[tuple[A, B | None]]:
        """Those that need not wait any longer, with their partners, or None."""
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
        """There is a second stream, even if nothing has come of it yet."""
        self._last_s = now_s

    def end_partners(self) -> None:
        """There is no second stream any more: nothing waits for it."""
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
        """Whether the second stream is past a stamp: what comes now is further away."""
        return bool(self._partners) and self._partners[-1][0] >= stamp_ns


JUMP_S = 5.0  # stamps and the clock on the wall may disagree so much over one gap
PERSISTENT = 3  # frames in a row that lie back in time: no straggler, time itself has gone back
FASTEST = 100.0  # a recording is not played faster
_RATES = 20

BACKWARDS, FORWARDS, REPEATED, LATE = 'back_jumps', 'forward_jumps', 'repeated', 'late'


class MonotonicStamps:
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


# A live sensor's stamps are this close to the clock; anything further off is a recording.
_LIVE_S = 30.0


class SensorClock:
    """Turns stamps into times of the system's clock, nanoseconds.

    A player keeps the recorded stamps, which name the frames, and says in its diagnostics which of them
    it published when; a live sensor stamps with the clock itself.
    """

    def __init__(self) -> None:
        self._replay: tuple[int, int, float] | None = None

    def learn(self, values: Mapping[str, str]) -> None:
        """Take what a player says: first stamp, when it was published, and how fast it plays."""
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
    """What a player says for :meth:`SensorClock.learn`."""
    return {'first_stamp_ns': first_stamp_ns, 'first_published_ns': first_published_ns, 'rate': rate}


def now_ns() -> int:
    """The system's clock, as the middleware reads it."""
    return time.time_ns()
