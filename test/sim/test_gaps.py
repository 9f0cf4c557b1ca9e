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

from itertools import pairwise

import numpy as np

from debris_scanner.sim.gaps import Gaps


def test_gaps_last_one_to_three_seconds_and_leave_time_between():
    for seed in range(5):
        intervals = Gaps.draw(60.0, seed).intervals
        assert 5 <= len(intervals) <= 12
        assert all(1 <= b - a <= 3 for a, b in intervals)
        assert all(after[0] - before[1] >= 5 for before, after in pairwise(intervals))
        assert intervals[0][0] >= 4


def test_gaps_are_seeded():
    assert Gaps.draw(60.0, 3) == Gaps.draw(60.0, 3)
    assert Gaps.draw(60.0, 3) != Gaps.draw(60.0, 4)


def test_gaps_can_wait():
    assert Gaps.draw(60.0, 3, 30.0).intervals[0][0] >= 30
    assert Gaps.draw(60.0, 3, 1.0) == Gaps.draw(60.0, 3)


def test_shades_hide_a_part():
    shaded = Gaps(((20.0, 21.0),)).shaded(60.0, 3)
    assert shaded.intervals == ((20.0, 21.0),)
    assert 7 <= len(shaded.shades) <= 20
    for start, end, share in shaded.shades:
        assert 1 <= end - start <= 3 and 0.3 <= share <= 0.7
        if not 19 < (start + end) / 2 < 22:
            assert shaded.visibility((start + end) / 2) == share
    assert shaded.visibility(0.0) == 1 and shaded.visibility(20.5) == 0


def test_what_leaves_does_not_come_back():
    gaps = Gaps(((2.0, 3.0),)).leaving(6.0)
    assert [gaps.visibility(t) for t in (1.0, 2.5, 4.0, 5.75, 6.0, 7.0, 1e6)] == [1, 0, 1, 0.5, 0, 0, 0]


def test_visibility_falls_and_rises_within_half_a_second():
    gaps = Gaps(((5.0, 7.0),))
    times = [0.0, 4.5, 4.75, 5.0, 6.0, 7.0, 7.25, 7.5, 20.0]
    np.testing.assert_allclose([gaps.visibility(t) for t in times], [1, 1, 0.5, 0, 0, 0, 0.5, 1, 1])
    assert Gaps(()).visibility(3.0) == 1
