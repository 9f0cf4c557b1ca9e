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

"""Does a target that changes while it turns show, whatever its poses, and does a rigid one never?"""

import numpy as np
import pytest
from changing_targets import HALF, TWO_TURNS, frames, key_frames, with_knob

from benchmarks.adversaries import bent
from debris_scanner.core.geometry import compose, exp_se3
from debris_scanner.core.results import NOT_RIGID
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.rigidity import CHANCE, change_over_time, signed_rank
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation

SCATTER = np.random.default_rng(3).normal(size=(2 * HALF, 6)) * np.repeat([np.radians(0.15), 0.0005], 3)


@pytest.mark.parametrize('second', [None, with_knob, bent], ids=['rigid', 'with a knob', 'bent'])
def test_a_change_shows_and_scattered_poses_are_none(second):
    views, poses = key_frames(second)
    poses = [compose(exp_se3(twist), T) for twist, T in zip(SCATTER, poses, strict=True)]
    found = change_over_time(PosedViews(views, poses, typical_sensor(views)))
    if second is None:
        assert found is None
        return
    assert found.check == ('deviations_of_chance', found.deviations, CHANCE, False)
    assert found.before_ns < views[HALF].frame.stamp_ns <= found.after_ns
    if second is with_knob:
        knob = with_knob(Simulation(TWO_TURNS).target).vertices
        assert np.linalg.norm(found.at - knob[-8:].mean(axis=0)) < 0.05  # its half diagonal is 43 mm
        assert 0.01 < found.by < 0.09


@pytest.mark.slow
def test_a_scan_of_a_target_that_was_bent_after_its_model_was_made_ends_without_one():
    scanner = Scanner(Settings())
    for frame, _ in frames(bent):
        scanner.process(frame)
    result = scanner.finish()
    assert (result.reason, result.model) == (NOT_RIGID, None)


def test_one_turn_shows_no_side_twice_and_says_nothing():
    views, poses = key_frames(bent, HALF)
    assert change_over_time(PosedViews(views, poses, typical_sensor(views))) is None


def test_the_signed_rank_is_that_of_the_literature():
    stats = pytest.importorskip('scipy.stats')
    values = np.random.default_rng(1).normal(0.3, 1, 80)
    test = stats.wilcoxon(values, alternative='greater', method='asymptotic')
    assert signed_rank(values) == pytest.approx(stats.norm.isf(test.pvalue), abs=1e-6)
    assert abs(signed_rank(np.array([1.0, -1.0, 2.0, -2.0]))) < 0.5
