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

"""Turned about its weakest axis a cylinder fits its frames as well as before; nothing else here does."""

import numpy as np
import pytest
from posed_frames import tumbling

from debris_scanner.modelling.evidence import PROFILE_TURNS_DEG, CostScan, scan_weakest_axis
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.modelling.validation import VerdictSettings, judge_rotation

SETTINGS = VerdictSettings()


def test_where_one_side_was_seen_most_the_axis_is_still_found():
    """Turned about the middle of what was seen, a cylinder would move sideways."""
    frames = tumbling('cylinder')[8:28]
    scan = scan_weakest_axis(fuse(frames, FusionSettings()), frames)
    assert judge_rotation(scan, SETTINGS) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ('target', 'seen'), [('cylinder', False), ('upper_stage', True), ('tank_boosters', True), ('prism', True)]
)
def test_a_turn_of_a_cylinder_costs_nothing(target, seen):
    frames = tumbling(target)
    scan = scan_weakest_axis(fuse(frames, FusionSettings()), frames)
    assert abs(scan.axis[2]) > 0.99  # each of them is longest or roundest along z
    assert len(scan.costs) == len(PROFILE_TURNS_DEG)
    assert (judge_rotation(scan, SETTINGS) is None) is seen


def test_the_words_name_axis_and_cost():
    scan = CostScan(np.array([0.0, 0.0, 1.0]), PROFILE_TURNS_DEG, (2.0, 1.5, 1.1, 1.2, 1.6, 2.1))
    said = judge_rotation(scan, SETTINGS)
    assert said is not None and '(0.00, 0.00, 1.00)' in said and '1.10 < 1.40' in said
