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

"""Targets and sensors drawn by a number: the same number is the same stranger, and each can be scanned."""

import numpy as np
import pytest

from benchmarks.scorecard.cases import all_cases
from benchmarks.scorecard.recordings import open_recording
from benchmarks.scorecard.targets import STRANGER
from benchmarks.strangers import STRANGERS, craft, recording, sensor
from debris_scanner.sim.sensors import SENSORS
from debris_scanner.sim.shapes import volume

CASES = [c for c in all_cases() if c.target.kind == STRANGER]


def test_each_number_is_one_case_that_is_held_out():
    assert [c.seed for c in CASES] == list(STRANGERS)
    assert all(c.held_out for c in CASES)
    assert {c.motion for c in CASES} == {'spin', 'tumble', 'gaps', 'swing'}
    assert len({c.options['sensor'] for c in CASES}) >= 6


def test_a_number_draws_the_same_again_and_another_number_something_else():
    (a, _), (again, _), (other, _) = craft(6), craft(6), craft(10)
    np.testing.assert_array_equal(a, again)
    assert a.shape != other.shape or not np.allclose(a, other)
    assert sensor(6) == sensor(6) and sensor(6) != sensor(7) and recording(6) == recording(6)
    assert sensor(6).axial != SENSORS[sensor(6).name].axial


@pytest.mark.parametrize('case', CASES, ids=lambda c: c.target.name)
def test_the_target_is_closed_and_in_sight(case):
    assert volume(craft(case.seed)) > 0
    frame, T = next(iter(open_recording(case).frames()))
    size = case.options['size']
    near = (frame.depth > 0) & (np.abs(frame.depth - T[2, 3]) < size)
    assert near.sum() > 80  # isolation.min_pixels
    v, u = np.nonzero(near)
    height, width = near.shape
    assert v.min() > 0 and u.min() > 0 and v.max() < height - 1 and u.max() < width - 1
