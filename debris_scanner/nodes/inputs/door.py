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

"""Decides which frames are served where more come than the scan keeps up with; free of ROS.

A frame that waits makes every later one late, so only as many wait as are served within some two periods
of the sensor: a short delay costs no frame. Where a frame takes longer than a period, only the newest
waits. What has to go is chosen evenly, before anything is decoded.
"""

import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar('T')

PERIODS = 2.0  # of the sensor, within which all frames that wait should be served
SHORTEST_WAIT_S = 0.05  # that is worth shedding a frame for
ON_THE_WAY = 2  # most frames that the later stages have and have not answered: one is served, one waits
PATIENCE_S = 1.0  # later stages that are silent for longer have been killed: they catch up by themselves
PATIENT = 4.0  # but not before they have been silent for so many times their slowest frame of late
FORGOTTEN = 0.1  # of the slowest frame's time with each frame
RATED = 16  # frames of which the sensor's period is measured
RATE_S = 3.0  # over which the rates are told
SMOOTHING = 0.2  # weight of the newest service time


class Door(Generic[T]):
    """Frames that wait, those that are on their way through the later stages, and what was shed.

    Args:
        most: frames that may wait, however quickly they are served.
        clock: seconds.
        patience_s: later stages that are silent for longer have been killed; infinite within one process.
    """

    def __init__(
        self, most: int, clock: Callable[[], float] = time.monotonic, patience_s: float = PATIENCE_S
    ) -> None:
        self.most = most
        self._clock = clock
        self._patience_s = patience_s
        self.reset()

    def reset(self) -> None:
        """Forget all frames and what was measured."""
        self.shed = 0
        self._waiting: deque[T] = deque()
        self._published: deque[int] = deque(maxlen=RATED)  # ns, of frames that have come
        self._sent: deque[tuple[int, float]] = deque()  # stamps that are not answered, and when they left
        self._answered_s = self._clock()
        self._owed_s = self._answered_s  # since when answers are owed; the oldest stamps may be forgotten
        self._own_s: float | None = None  # to prepare a frame here
        self._later_s: float | None = None  # that the slowest later stage takes for a frame
        self._slowest_s = 0.0  # the same, of the slowest frame of late
        self._history: deque[tuple[float, int, int]] = deque()  # when frames were served or shed, how many

    def __len__(self) -> int:
        """Number of frames that wait."""
        return len(self._waiting)

    @property
    def room(self) -> int:
        """How many frames may wait: what is served within some periods; all as long as little is known."""
        times = [s for s in (self._own_s, self._later_s) if s is not None]
        if len(self._published) < RATED or not times:
            return self.most
        period_s = (self._published[-1] - self._published[0]) * 1e-9 / (RATED - 1)
        patience_s = max(PERIODS * period_s, SHORTEST_WAIT_S)
        return max(1, int(min(patience_s / max(*times, 1e-6), self.most)))

    def arrive(self, item: T, published_ns: int) -> None:
        """Let a frame wait; ``published_ns`` is when its message was published."""
        self._waiting.append(item)
        self._published.append(published_ns)

    def next(self) -> T | None:
        """The frame to serve now, after shedding what cannot be served in time; None: later, or no frame."""
        self._shed()
        if not self._waiting or self.is_shut:
            return None
        return self._waiting.popleft()

    def lost(self, count: int) -> None:
        """Count frames that were overwritten while they waited to be received."""
        self.shed += count
        self._note(0, count)

    @property
    def is_shut(self) -> bool:
        """Whether a frame would wait for the later stages, once it is prepared; the newest is let in then."""
        if not self._sent:
            return False
        silent_s = self._clock() - max(self._answered_s, self._owed_s)
        is_alive = silent_s < max(self._patience_s, PATIENT * self._slowest_s)
        if not is_alive or len(self._sent) >= ON_THE_WAY:
            return is_alive
        if self._later_s is None or self._own_s is None:
            return False
        return self._later_s - silent_s > self._own_s

    def served(self, stamp_ns: int | None, own_s: float) -> None:
        """A frame has been prepared within ``own_s``; with a stamp it is on its way to the later stages."""
        self._own_s = _smoothed(self._own_s, own_s)
        self._note(1, 0)
        if stamp_ns is not None:
            if not self._sent:
                self._owed_s = self._clock()
            self._sent.append((stamp_ns, self._clock()))
            while len(self._sent) > self.most:
                self._sent.popleft()

    def answered(self, stamp_ns: int) -> None:
        """The later stages have done with all frames up to a stamp."""
        now_s, left_s = self._clock(), None
        while self._sent and self._sent[0][0] <= stamp_ns:
            left_s = self._sent.popleft()[1]
        if left_s is not None:
            took_s = now_s - max(left_s, self._answered_s)
            self._later_s = _smoothed(self._later_s, took_s)
            self._slowest_s = max(took_s, (1 - FORGOTTEN) * self._slowest_s)
        self._answered_s = now_s

    def rates(self) -> tuple[float, float]:
        """Frames a second that are served, and that are offered, over the last seconds."""
        self._forget()
        served, shed = (sum(row[k] for row in self._history) for k in (1, 2))
        return round(served / RATE_S, 1), round((served + shed) / RATE_S, 1)

    @property
    def is_shedding(self) -> bool:
        """Whether frames were shed in the last seconds."""
        self._forget()
        return any(shed for _, _, shed in self._history)

    def _shed(self) -> None:
        """Keep as many as there is room for, evenly spread, the newest among them."""
        count, room = len(self._waiting), self.room
        if count <= room:
            return
        kept = {(n + 1) * count // room - 1 for n in range(room)}
        self._waiting = deque(item for n, item in enumerate(self._waiting) if n in kept)
        self.lost(count - room)

    def _note(self, served: int, shed: int) -> None:
        self._history.append((self._clock(), served, shed))
        self._forget()

    def _forget(self) -> None:
        since_s = self._clock() - RATE_S
        while self._history and self._history[0][0] < since_s:
            self._history.popleft()


def _smoothed(before: float | None, now: float) -> float:
    return now if before is None else before + SMOOTHING * (now - before)
