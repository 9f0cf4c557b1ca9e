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

"""A gap is counted in frames, not in seconds."""

import numpy as np
import pytest
from coarse_frames import coarse

from debris_scanner.core.frames import DepthFrame
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.tracking.cadence import REMEMBERED, Cadence

SECOND = 1_000_000_000


@pytest.mark.parametrize(('hz', 'stretch'), [(30, 1.0), (10, 1.0), (2, 5.0), (1, 10.0)])
def test_bounds_in_time_span_as_many_frames(hz, stretch):
    assert Cadence(range(0, 5 * SECOND, SECOND // hz)).stretch == pytest.approx(stretch)


def test_gaps_do_not_count_as_the_usual_interval():
    stamps = np.cumsum([0, *[SECOND // 10] * REMEMBERED, 3 * SECOND, SECOND // 10, 2 * SECOND])
    assert Cadence(int(s) for s in stamps).stretch == 1.0


def test_nothing_is_known_before_the_second_frame():
    assert Cadence().stretch == Cadence([SECOND]).stretch == 1.0


@pytest.mark.slow
def test_one_frame_a_second_in_steps_of_twenty_degrees_closes_the_loop():
    recording = simulate(SimulationSettings(target='asteroid', rate_hz=1.0, seconds=22.0, spin_rad_s=0.35))
    scanner = Scanner(Settings())
    for frame in recording:
        image = DepthFrame(frame.stamp_ns, frame.depth_mm * np.float32(0.001), frame.camera)
        scanner.process(coarse(image))
    result = scanner.finish()
    assert result.model is not None
    assert result.frames_rejected == {}
