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

"""Figures of tracking from made-up estimates."""

import numpy as np
import pytest

from benchmarks.scorecard.tracking import Tracked, tracking_figures
from debris_scanner.core.geometry import exp_so3, transform

STEP_NS = 100_000_000


def truth_of(n):
    return {
        k * STEP_NS: transform(exp_so3(np.array([0.05 * k, 0.02 * k, 0.0])), [0, 0, 0.8]) for k in range(n)
    }


def run(n=100, dark=(), off=(), unbelieved=()):
    """Figures when the target is hidden in ``dark``, 20 degrees off in ``off``, else disbelieved or right."""
    truth = truth_of(n)
    T_truth_target = transform(exp_so3(np.array([0.3, -0.2, 0.5])), [0.01, 0.0, 0.02])
    tracked = []
    for k, (stamp, T) in enumerate(truth.items()):
        estimate = T @ T_truth_target
        if k in off:
            estimate = estimate @ transform(exp_so3(np.array([0.0, np.radians(20), 0.0])), np.zeros(3))
        hidden = k in dark or k in unbelieved
        tracked.append(
            Tracked(stamp, 'lost' if k in unbelieved else 'tracking', None if hidden else estimate)
        )
    return tracking_figures(tracked, truth, lambda stamp: 0.0 if stamp // STEP_NS in dark else 1.0)


def test_one_constant_alignment_is_no_error():
    figures = run()
    assert figures['attitude_rms_deg'] == figures['position_rms_mm'] == 0
    assert (figures['frames'], figures['seconds']) == (100, 9.9)
    assert figures['missed'] == figures['lost'] == figures['wrong'] == figures['never_reacquired'] == 0
    assert figures['gaps'] == [] and figures['reacquired_s'] is None and figures['partial_max_deg'] is None


def test_gaps_are_timed_until_the_first_right_estimate():
    figures = run(dark=range(20, 50), unbelieved=(50, 51), off=(52,))
    assert figures['gaps'] == [{'gap_s': 3.0, 'reacquired_s': 0.3}]
    assert (figures['missed'], figures['lost'], figures['wrong']) == (2, 2, 1)
    assert figures['attitude_max_deg'] == pytest.approx(20, abs=0.1)


def test_a_gap_that_is_never_ended_is_said():
    figures = run(dark=range(20, 30), unbelieved=range(30, 100))
    assert figures['never_reacquired'] == 1 and figures['gaps'][0]['reacquired_s'] is None
    assert run(dark=range(90, 100))['gaps'] == []  # the recording ends in it


def test_nothing_tracked_has_no_figures():
    assert tracking_figures([], {}, lambda _: 1.0) is None
    assert run(10, unbelieved=range(10)) is None
