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

"""Two streams joined by their stamps."""

import math

import pytest

from debris_scanner.core.stamps import StampPairs

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
