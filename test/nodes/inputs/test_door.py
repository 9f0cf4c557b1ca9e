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

"""What is served, what waits and what is shed, on a clock of the test's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from debris_scanner.nodes.inputs.door import ON_THE_WAY, PATIENCE_S, RATED, Door

S = 1_000_000_000
PERIOD_S = 1 / 30


class Clock:
    """Stands still until it is moved."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class Line:
    """A camera, a door with its stage, and a later stage, each of which takes its time for a frame.

    The stage cannot receive while it serves, as an executor with one thread.
    """

    def __init__(self, own_s, later_s, most=10, **options):
        self.clock = Clock()
        self.door = Door(most, self.clock, **options)
        self.own_s, self.later_s = own_s, later_s
        self.done = []  # stamp, when it left the later stage
        self.late_free_s = 0.0
        self._pending = []  # what the later stage has

    def run(self, frames, stall=None):
        """Serve frames, which come at 30 Hz; ``stall``: a frame, and how long the stage stands still."""
        start_s, n = self.clock.now_s, 0
        stamps = [start_s + k * PERIOD_S for k in range(frames)]
        while n < frames or len(self.door) or self._pending:
            while n < frames and stamps[n] <= self.clock.now_s:
                self.door.arrive(n, round(stamps[n] * 1e9))
                n += 1
                if stall is not None and n == stall[0]:
                    self.clock.now_s += stall[1]
            self._answer()
            frame = self.door.next()
            if frame is not None:
                self._serve(frame)
                continue
            upcoming = ([stamps[n]] if n < frames else []) + [t for _, t in self._pending[:1]]
            self.clock.now_s = max(self.clock.now_s, min(upcoming, default=self.clock.now_s)) + 1e-9
        self._answer()
        served = [k for k, _ in self.done]
        return np.array(served), np.array([t - stamps[k] for k, t in self.done])

    def _serve(self, frame):
        self.clock.now_s += self.own_s
        self.door.served(frame, self.own_s)
        self.late_free_s = max(self.late_free_s, self.clock.now_s) + self.later_s
        self._pending.append((frame, self.late_free_s))

    def _answer(self):
        now_s = self.clock.now_s
        while self._pending and self._pending[0][1] <= now_s:
            frame, self.clock.now_s = self._pending.pop(0)
            self.door.answered(frame)
            self.done.append((frame, self.clock.now_s))
        self.clock.now_s = now_s


def test_what_is_fast_enough_loses_nothing_and_does_not_wait():
    served, late = Line(0.010, 0.015).run(300)
    assert list(served) == list(range(300))
    assert late.max() < 0.030


def test_a_short_stall_costs_no_frame():
    served, late = Line(0.008, 0.008).run(300, stall=(100, 0.12))
    assert list(served) == list(range(300))
    assert late[-1] < 0.02, 'it has caught up'


def test_after_a_long_stall_the_newest_frames_are_served_evenly():
    line = Line(0.020, 0.005)
    served, late = line.run(300, stall=(100, 0.6))
    gaps = np.diff(served)
    lost = 300 - len(served)
    assert 10 < lost == line.door.shed
    assert (gaps > 1).sum() >= 2 and gaps.max() <= 10, 'no gap of the length of the stall'
    assert np.median(late) < 0.05 and served[-1] == 299


@settings(deadline=None, max_examples=60)
@given(
    own_s=st.floats(0.002, 0.25),
    later_s=st.floats(0.002, 0.25),
)
def test_under_any_load_latency_and_gaps_are_bounded_and_the_newest_is_served(own_s, later_s):
    line = Line(own_s, later_s)
    served, late = line.run(400)
    slowest_s = max(own_s, later_s)
    settled = served > 40
    bound_s = own_s + (ON_THE_WAY + 1) * later_s + max(slowest_s, 2 * PERIOD_S) + 2 * PERIOD_S
    assert late[settled].max() <= bound_s
    gaps = np.diff(served[settled]) * PERIOD_S
    assert gaps.max() <= own_s + slowest_s + 2 * PERIOD_S
    assert gaps.max() - gaps.min() <= max(own_s, slowest_s) + 2 * PERIOD_S, 'spread evenly'
    assert served[-1] == 399
    assert len(served) + line.door.shed == 400


@given(waiting=st.integers(1, 60), most=st.integers(1, 20))
def test_what_is_shed_is_spread_evenly_and_never_the_newest(waiting, most):
    door = Door(most, Clock())
    for n in range(waiting):
        door.arrive(n, n * S // 30)
    kept = []
    while (item := door.next()) is not None:
        kept.append(item)
    assert kept[-1] == waiting - 1
    assert len(kept) == min(most, waiting) and door.shed == waiting - len(kept)
    gaps = np.diff([-1, *kept])
    assert gaps.max() - gaps.min() <= 1


def test_silent_later_stages_shut_the_door_for_a_while_only():
    clock = Clock()
    door = Door(10, clock)
    for n in range(ON_THE_WAY + 2):
        door.arrive(n, n)
    for _ in range(ON_THE_WAY):
        door.served(door.next(), 0.01)
    assert door.next() is None and len(door) == 2
    clock.now_s += 1.01 * PATIENCE_S
    assert door.next() == ON_THE_WAY, 'they were killed: what they miss is written down'
    door.answered(10)
    assert door.next() == ON_THE_WAY + 1


def test_a_frame_that_takes_long_is_not_taken_for_stages_that_were_killed():
    line = Line(0.010, 3 * PATIENCE_S, patience_s=np.inf)
    _, late = line.run(600)
    assert late.max() <= (ON_THE_WAY + 1) * line.later_s, 'no queue behind it'
    line = Line(0.010, 0.9 * PATIENCE_S)
    line.run(300)
    line.later_s = 3 * PATIENCE_S
    _, late = line.run(300)
    assert late.max() <= (ON_THE_WAY + 1) * line.later_s, 'nor where the others were nearly as long'


def test_without_later_stages_all_frames_are_served_after_a_while():
    clock = Clock()
    door = Door(10, clock)
    served = []
    for n in range(120):
        clock.now_s += PERIOD_S
        door.arrive(n, round(clock.now_s * 1e9))
        while (frame := door.next()) is not None:
            served.append(frame)
            door.served(frame, 0.002)
    assert served[-80:] == list(range(40, 120))


def test_the_rates_tell_what_is_kept_up_with():
    line = Line(0.060, 0.010)
    line.run(200)
    kept, offered = line.door.rates()
    assert kept == pytest.approx(1 / 0.060, rel=0.15)
    assert offered == pytest.approx(30, rel=0.15)
    assert line.door.is_shedding
    line.clock.now_s += 10.0
    assert not line.door.is_shedding and line.door.rates() == (0.0, 0.0)


def test_before_anything_is_measured_only_the_longest_queue_sheds():
    door = Door(5, Clock())
    for n in range(RATED - 1):
        door.arrive(n, n)
    assert door.room == 5
    door.lost(3)
    assert door.shed == 3
    door.reset()
    assert door.shed == 0 and len(door) == 0
