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

"""A turn shows as far as a shape is not round."""

import numpy as np
import pytest

from benchmarks.scorecard.targets import TARGETS
from benchmarks.turn_evidence import TURN, moved_by_a_turn, noise, row
from debris_scanner.sim.sensors import SENSORS
from debris_scanner.sim.shapes import box, lathe


def test_a_round_body_turns_unseen():
    profile = np.array([(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)])
    assert moved_by_a_turn(*lathe(profile, 256)) < 1e-3


def test_a_long_bar_shows_its_turn_least_about_its_length():
    """Over a face its points move by x sin t; at the edges the next face is nearer."""
    over_a_face = np.sin(TURN) / np.sqrt(3)
    assert 0.8 * over_a_face < moved_by_a_turn(*box((2.0, 2.0, 40.0))) < over_a_face


def test_a_row_tells_shares_of_the_noise():
    sensors = [SENSORS['flexx'], SENSORS['d405']]
    name, mm, flexx, d405 = row(TARGETS['upper_stage'], sensors)
    assert name == 'upper_stage' and 1.0 < float(mm) < 1.3
    assert float(flexx) == pytest.approx(float(mm) / (1e3 * noise(sensors[0])), abs=0.01)
    assert 0.3 < float(d405) < 0.6  # a smaller one, nearer
