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

"""What makes a scan's graph a model, and the words for why not."""

import pytest

from debris_scanner.registration import Agreement
from debris_scanner.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
)
from debris_scanner.verdict import VerdictSettings, judge_graph, judge_scan

SETTINGS = VerdictSettings()
GOOD = Agreement(points=1000, matched=900, square=900 * 0.0014**2, visible=950, in_free_space=5)
BLURRED = Agreement(points=1000, matched=900, square=900 * 0.0030**2, visible=950, in_free_space=5)
CROSSING = Agreement(points=1000, matched=900, square=900 * 0.0014**2, visible=950, in_free_space=90)
SEEN = [0.005, 0.004, 0.006]


def test_agreeing_graph_is_a_model():
    assert judge_graph([GOOD] * 20, [1.0] * 5, SEEN, SETTINGS) is None


@pytest.mark.parametrize(
    ('agreements', 'weights', 'observability', 'reason', 'word'),
    [
        ([BLURRED] * 20, [1.0], SEEN, INCONSISTENT_MODEL, 'residual 3.00 mm'),
        ([GOOD] * 16 + [CROSSING] * 4, [1.0], SEEN, INCONSISTENT_MODEL, 'free space'),
        ([GOOD] * 20, [1.0] * 8 + [0.1] * 2, SEEN, INCONSISTENT_MODEL, '20%'),
        ([GOOD] * 20, [1.0], [0.0005, 0.0004, 0.01], UNOBSERVABLE_ROTATION, '0.0005'),
        ([GOOD] * 20, [1.0], [], UNOBSERVABLE_ROTATION, 'rotation information'),
    ],
)
def test_contradiction_is_no_model(agreements, weights, observability, reason, word):
    verdict = judge_graph(agreements, weights, observability, SETTINGS)
    assert verdict is not None
    assert verdict[0] == reason
    assert word in verdict[1]


def test_a_few_bad_edges_of_many_are_forgiven():
    assert judge_graph([GOOD] * 38 + [BLURRED, CROSSING], [1.0] * 19 + [0.1], SEEN, SETTINGS) is None


@pytest.mark.parametrize(
    ('frames', 'observability', 'reason'),
    [
        (0, [], NO_TARGET),
        (SETTINGS.min_frames - 1, SEEN, TOO_FEW_FRAMES),
        (SETTINGS.min_frames, SEEN, NO_CLOSURE),
        (SETTINGS.min_frames, [], NO_CLOSURE),  # nothing moved, so nothing was compared
        (200, [0.0003, 0.0004], UNOBSERVABLE_ROTATION),
        (3, [0.0003], TOO_FEW_FRAMES),
    ],
)
def test_reason_of_a_scan_without_a_loop(frames, observability, reason):
    found, why = judge_scan(frames, observability, SETTINGS)
    assert found == reason
    assert why
