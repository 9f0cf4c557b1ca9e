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


def test_visibility_falls_and_rises_within_half_a_second():
    gaps = Gaps(((5.0, 7.0),))
    times = [0.0, 4.5, 4.75, 5.0, 6.0, 7.0, 7.25, 7.5, 20.0]
    np.testing.assert_allclose([gaps.visibility(t) for t in times], [1, 1, 0.5, 0, 0, 0, 0.5, 1, 1])
    assert Gaps(()).visibility(3.0) == 1
