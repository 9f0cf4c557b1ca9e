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

"""A target that comes into sight grows; one that is in sight does not count as coming."""

import pytest

from debris_scanner.tracking.occlusion import LONGEST_EMERGING_NS, Appearance

MAX_GAP = 0.35


def told(counts, hz=10.0, start_s=0.0, appearance=None):
    """What is said frame by frame of a target that shows so many points."""
    appearance = appearance or Appearance()
    said = []
    for n, count in enumerate(counts):
        appearance.note(round((start_s + n / hz) * 1e9), count, MAX_GAP)
        said.append(appearance.emerging)
    return appearance, said


def test_what_was_never_away_does_not_emerge():
    assert told([1000, 2000, 500, 3000])[1] == [False] * 4


@pytest.mark.parametrize('hz', [10.0, 30.0])
def test_it_emerges_after_a_gap_until_it_stops_growing(hz):
    appearance, _ = told([2000] * 5, hz)
    frames = round(0.5 * hz)
    grows = [round(2000 * (n + 1) / frames) for n in range(frames)]
    _, said = told(grows + [2000] * round(0.3 * hz), hz, 3.0, appearance)
    assert all(said[: frames - 1])
    assert not any(said[frames + round(0.1 * hz) :])


def test_what_grows_for_long_is_turning():
    appearance, _ = told([2000] * 5)
    _, said = told([300 * 1.1**n for n in range(30)], 10.0, 3.0, appearance)
    settled = said.index(False)
    assert settled == round(LONGEST_EMERGING_NS * 1e-9 * 10) + 1
    assert not any(said[settled:])
