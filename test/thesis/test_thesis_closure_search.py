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

import numpy as np
import pytest

from debris_scanner.mapping.closure_search import Candidate
from debris_scanner.research.thesis.loop_closures import SearchThresholds, frugal, greedy

STEP = np.radians(10.0)  # between key frames
SECOND = 1_000_000_000


def turn(probabilities):
    """Arrays of earlier key frames with these probabilities, ten degrees apart, and the newest one's path."""
    p = np.asarray(probabilities, float)
    n = len(p)
    return np.arange(n, dtype=np.int64) * SECOND, p, np.arange(n) * STEP, n * STEP


def indices(found):
    return [c.index for c in found]


@pytest.fixture
def full_turn():
    """36 earlier frames: alike at the start of the turn, in its middle, and just now."""
    p = np.full(36, 0.3)
    p[[0, 1, 2]] = 0.95, 0.9, 0.82
    p[[16, 17, 18, 19, 20]] = 0.85, 0.97, 0.98, 0.97, 0.85
    p[[30, 32, 33, 34, 35]] = 0.9, 0.9, 0.7, 0.99, 0.99
    return turn(p)


def test_greedy_takes_all_half_a_turn_back_and_the_directly_preceding(full_turn):
    # Frame 18 is exactly half a turn back; 33 is directly preceding but not alike; 30 and 32 are too near.
    assert indices(greedy(*full_turn)) == [0, 1, 2, 16, 17, 18, 34, 35]


def test_greedy_without_preceding_frames(full_turn):
    found = greedy(*full_turn, SearchThresholds(preceding=0))
    assert indices(found) == [0, 1, 2, 16, 17, 18]


def test_frugal_takes_the_best_half_a_turn_back(full_turn):
    best = frugal(*full_turn)
    assert best == Candidate(18, 18 * SECOND, 0.98)
    assert frugal(*full_turn, SearchThresholds(min_turn=np.radians(350.0))).index == 0


def test_nothing_probable_is_no_closure():
    arrays = turn(np.full(36, 0.79))
    assert frugal(*arrays) is None
    assert greedy(*arrays) == []


def test_threshold_itself_is_accepted():
    arrays = turn(np.full(36, 0.8))
    assert frugal(*arrays).index == 0
    assert len(greedy(*arrays)) == 19 + 3


def test_fewer_earlier_frames_than_preceding_ones():
    assert indices(greedy(*turn([0.9, 0.9]))) == [0, 1]


def test_nothing_earlier():
    arrays = turn([])
    assert greedy(*arrays) == []
    assert frugal(*arrays) is None


def test_inputs_are_left_alone(full_turn):
    before = [np.copy(a) for a in full_turn]
    for search in (greedy, frugal):
        search(*full_turn)
    for a, b in zip(before, full_turn, strict=True):
        np.testing.assert_array_equal(a, b)
