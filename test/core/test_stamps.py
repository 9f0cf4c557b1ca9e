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

"""Stamps: pairs of two streams; jumping, looping or late ones put in order; those of a replay."""

import math
import time

import pytest

from debris_scanner.core.stamps import MonotonicStamps, SensorClock, StampPairs, replay_values

MS = 1_000_000


def pairs_of(firsts, seconds, expected=True):
    """Pairs of two lists of stamps, ms, all there at once."""
    pairs = StampPairs()
    if expected:
        pairs.expect(0.0)
    for stamp in seconds:
        pairs.add_partner(stamp * MS, 0.0, stamp)
    for stamp in firsts:
        pairs.add(stamp * MS, 0.0, stamp)
    return [*pairs.pop(0.0), *pairs.pop(math.inf)]


def test_the_nearest_is_taken_if_it_is_near_enough():
    assert pairs_of([100, 200], [99, 120, 211]) == [(100, 99), (200, 211)]
    assert pairs_of([100], [140]) == [(100, 140)]
    assert pairs_of([100], [141]) == [(100, None)]
    assert pairs_of([100, 133, 166], [90, 123, 157]) == [(100, 90), (133, 123), (166, 157)]


def test_one_partner_may_serve_two():
    assert pairs_of([100, 110], [105]) == [(100, 105), (110, 105)]


def test_without_a_second_stream_nothing_waits():
    pairs = StampPairs()
    pairs.add(100 * MS, 5.0, 'a')
    assert list(pairs.pop(5.0)) == [('a', None)]


def test_a_late_partner_is_waited_for_but_not_for_ever():
    pairs = StampPairs()
    pairs.add_partner(0, 4.95, 'old')
    pairs.add(100 * MS, 5.0, 'a')
    assert list(pairs.pop(5.01)) == []
    pairs.add_partner(101 * MS, 5.02, 'late')
    assert list(pairs.pop(5.02)) == [('a', 'late')]
    pairs.add(200 * MS, 5.1, 'b')
    assert list(pairs.pop(5.12)) == []
    assert list(pairs.pop(5.17)) == [('b', None)]


def test_a_middling_partner_is_taken_only_when_no_better_can_come():
    pairs = StampPairs()
    pairs.add_partner(70 * MS, 5.0, 'before')
    pairs.add(100 * MS, 5.0, 'a')
    assert list(pairs.pop(5.0)) == []  # one at 103 may be on its way
    pairs.add_partner(103 * MS, 5.01, 'after')
    assert list(pairs.pop(5.01)) == [('a', 'after')]
    pairs.add(170 * MS, 5.1, 'b')
    pairs.add_partner(205 * MS, 5.1, 'past')
    assert list(pairs.pop(5.1)) == [('b', 'past')]


def test_a_second_stream_that_ends_holds_nothing_up():
    pairs = StampPairs()
    pairs.add_partner(0, 5.0, 'x')
    pairs.add(100 * MS, 5.0, 'a')
    pairs.end_partners()
    assert list(pairs.pop(5.0)) == [('a', None)]
    pairs.add_partner(200 * MS, 6.0, 'y')
    pairs.add(300 * MS, 7.1, 'b')
    assert list(pairs.pop(7.1)) == [('b', None)]


@pytest.mark.parametrize('count', [11, 40])
def test_all_leave_in_order_however_many_wait(count):
    pairs = StampPairs()
    pairs.expect(0.0)
    for k in range(count):
        pairs.add(k * 100 * MS, 0.0, k)
    left = [k for k, _ in pairs.pop(0.0)]
    assert left == list(range(count - 10))
    assert [k for k, _ in pairs.pop(math.inf)] == list(range(count - 10, count))


S = 1_000_000_000


def play(line, stamps, wall=None, period_s=0.1):
    """Place stamps in s that arrive a period apart, or at given times; placed stamps in s."""
    wall = wall or [k * period_s for k in range(len(stamps))]
    return [line.place(round(s * S), w) / S for s, w in zip(stamps, wall, strict=True)]


def steps(first, count, period_s=0.1):
    return [round(first + k * period_s, 9) for k in range(count)]


def test_time_as_it_should_be_is_left_alone():
    line = MonotonicStamps()
    stamps = steps(100.0, 50)
    assert play(line, stamps) == stamps
    assert not line.counts
    assert line.shift_ns == 0


def test_a_silence_of_the_sensor_is_no_jump():
    line = MonotonicStamps()
    stamps = [*steps(5.0, 10), *steps(36.0, 10)]
    wall = [*steps(0.0, 10), *steps(31.0, 10)]
    assert play(line, stamps, wall) == stamps
    assert not line.counts


def test_nor_is_a_recording_played_ten_times_as_fast():
    line = MonotonicStamps()
    stamps = [*steps(5.0, 20), *steps(67.0, 20)]  # a minute's silence takes six seconds
    wall = [s / 10 for s in stamps]
    assert play(line, stamps, wall) == stamps
    assert not line.counts


@pytest.mark.parametrize('jump_s', [6.0, 3600.0, 86400.0, 1.6e9, -1.0, -100.0, -3600.0, -86400.0, -1.6e9])
def test_a_clock_that_is_set_costs_two_frames(jump_s):
    line = MonotonicStamps()
    placed = play(line, [*steps(1.7e9, 20), *steps(1.7e9 + 2 + jump_s, 20)])
    assert placed[:20] == steps(1.7e9, 20)
    assert max(placed[20:22]) <= placed[19]
    assert placed[22:] == pytest.approx(steps(1.7e9 + 2.2, 18), abs=1e-6)
    late, way = ('late', 'back') if jump_s < 0 else ('early', 'forward')
    assert dict(line.counts) == {late: 3, f'{way}_jumps': 1}
    assert f'jumped {way}' in line.remark


@pytest.mark.parametrize('off_s', [6.0, 3600.0, 1.6e9, -6.0, -3600.0])
def test_a_single_damaged_stamp_moves_nothing(off_s):
    line = MonotonicStamps()
    stamps = steps(5000.0, 20)
    placed = play(line, [*stamps[:9], stamps[9] + off_s, *stamps[10:]])
    assert placed[9] <= placed[8]
    assert [*placed[:9], *placed[10:]] == [*stamps[:9], *stamps[10:]]
    assert line.shift_ns == 0


def test_where_stamps_stay_as_they_are_the_same_ones_are_left_out():
    line, year_ns = MonotonicStamps(), 365 * 24 * 3600 * 1000 * MS
    stamps = [
        100,
        200,
        300,
        300,
        250,
        400 + 50 * year_ns // MS,
        400,
        500,
        *(700 + year_ns // MS + 100 * k for k in range(4)),
    ]
    followed = [line.follows(stamp * MS, n / 10) for n, stamp in enumerate(stamps)]
    assert followed == [True] * 3 + [False] * 3 + [True] * 2 + [False] * 2 + [True] * 2


def test_a_clock_that_wraps_goes_on_each_time():
    """A counter of 32 bits of microseconds starts over after 71.6 minutes."""
    line = MonotonicStamps()
    wrap = 2**32 * 1e-6
    placed = play(line, [(5 + k * 0.1) % wrap for k in range(60_000, 100_000)])
    kept = [p for k, p in enumerate(placed) if k == 0 or p > max(placed[k - 1 : k])]
    assert len(kept) >= 40_000 - 2
    assert kept[-1] - kept[0] == pytest.approx(3999.9)


def test_a_recording_that_loops_goes_on_each_time():
    line = MonotonicStamps()
    placed = play(line, steps(50.0, 30) * 4)
    kept = [p for k, p in enumerate(placed) if k == 0 or p > max(placed[:k])]
    assert len(kept) == 4 * 30 - 3 * 2
    assert kept == sorted(kept)
    assert kept[-1] == pytest.approx(50.0 + 11.9)
    assert line.counts['back_jumps'] == 3


def test_stragglers_and_repeats_move_nothing():
    line = MonotonicStamps()
    stamps = [1.0, 1.1, 1.1, 1.2, 1.15, 1.3, 1.25, 1.4, 1.1, 1.5, 1.45, 1.5, 1.6]
    assert play(line, stamps) == stamps
    assert dict(line.counts) == {'repeated': 2, 'late': 4}
    assert line.shift_ns == 0


def test_two_clocks_that_take_turns_stay_apart():
    """A second driver on the topic with a clock of its own must not drag time back and forth."""
    line = MonotonicStamps()
    for k in range(40):
        line.place(round((500 + k * 0.1) * S), k * 0.1)
        line.place(round((20 + k * 0.1) * S), k * 0.1 + 0.05)
    assert line.counts == {'late': 40}
    assert line.shift_ns == 0


def test_a_reset_takes_stamps_as_they_come():
    line = MonotonicStamps()
    play(line, [*steps(100.0, 10), *steps(1.0, 5)])
    assert line.shift_ns
    line.reset()
    assert line.place(5 * S, 99.0) == 5 * S
    assert not line.counts


def test_stamps_made_up_to_run_away_do_not_get_far():
    """The speed that is learnt from them does not vouch for the next jump."""
    line = MonotonicStamps()
    stamps = [1e9 + 4.9 * k for k in range(100)]  # each just too near to be a jump
    placed = play(line, [*stamps, 2.1e9], [k * 1e-3 for k in range(101)])
    assert placed[-1] == placed[-2]
    assert not line.counts['forward_jumps']


def test_a_replays_stamps_are_brought_to_the_clock():
    clock = SensorClock()
    now = time.time_ns()
    assert clock.age_s(10**9, now) is None
    clock.learn({k: str(v) for k, v in replay_values(10**9, now, 2.0).items()})
    # half a second after the start, at twice the speed, a second of the recording has gone by
    assert clock.age_s(2 * 10**9, now + 530_000_000) == pytest.approx(0.03)
    clock.learn({'first_stamp_ns': 'soon'})
    assert clock.age_s(2 * 10**9, now + 530_000_000) == pytest.approx(0.03)
