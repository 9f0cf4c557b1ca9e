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

"""Two streams of stamped images joined: each of the first with the nearest in time of the second."""

from collections import deque
from collections.abc import Iterator
from typing import Generic, TypeVar

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
