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

"""The scans that have no right model: what is done to the targets, and how rows become a table."""

import numpy as np
import pytest

from benchmarks import adversaries
from benchmarks.adversaries import (
    CHANGES,
    HIDDEN_S,
    PUSHED,
    SECONDS,
    Case,
    all_cases,
    frames_of,
    with_knob,
)
from debris_scanner.core.geometry import rotation_angle
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import make_target

SIZE = 0.34


def test_each_case_is_another_and_each_sensor_has_some():
    cases = all_cases()
    assert len(set(cases)) == len(cases) >= 60
    assert {c.sensor for c in cases} == set(adversaries.SENSORS)


@pytest.mark.parametrize('name', CHANGES)
def test_a_change_begins_with_the_target_itself_and_keeps_to_its_size(name):
    target = make_target('shuttle_stack', SIZE)
    np.testing.assert_array_equal(CHANGES[name](target, 0.0).vertices, target.vertices)
    corners = CHANGES[name](target, 0.7).vertices
    moved = np.linalg.norm(corners[: len(target.vertices)] - target.vertices, axis=1).max()
    assert 0.01 * SIZE < moved < 0.2 * SIZE or len(corners) > len(target.vertices)


def test_a_knob_stands_out_of_the_flank():
    target = make_target('asteroid', SIZE)
    knobbed = with_knob(target)
    assert len(knobbed.triangles) == len(target.triangles) + 12
    corners = knobbed.vertices[len(target.vertices) :]
    assert np.ptp(corners, axis=0) == pytest.approx([0.074 * SIZE] * 3, rel=1e-4)
    assert np.abs(np.linalg.norm(corners, axis=1)).max() > 0.3 * SIZE


def test_a_pushed_target_jumps_while_nobody_sees_it():
    case = next(c for c in all_cases() if c.what == PUSHED and c.hidden_s == HIDDEN_S[0])
    settings = SimulationSettings(seconds=SECONDS, rate_hz=1.0)
    target = make_target('prism', SIZE)
    undisturbed = Simulation(settings, target)
    frames = list(frames_of(case, target, settings))
    off = [
        rotation_angle((f.T_sensor_target @ np.linalg.inv(undisturbed.pose(k)))[:3, :3])
        for k, f in enumerate(frames)
    ]
    hidden = [not f.depth.any() for f in frames]
    assert 4 <= sum(hidden) <= 6
    first, last = hidden.index(True), len(hidden) - 1 - hidden[::-1].index(True)
    assert max(off[: first + 1]) < 1e-6
    assert min(off[last:]) == pytest.approx(0.5 * HIDDEN_S[0] / 2, rel=1e-3)  # it spins at 0.5 rad/s


@pytest.mark.parametrize(('what', 'shapes'), [('bent at half time', 2), ('growing', 10), ('bent', 1)])
def test_a_change_comes_at_once_or_in_steps(what, shapes, monkeypatch):
    monkeypatch.setattr(adversaries, 'STEPS', 10)
    made = []
    monkeypatch.setattr(adversaries, 'Simulation', lambda *given: made.append(given) or Simulation(*given))
    case = Case(what, 'cubesat', 'kinect1', model=what not in CHANGES)
    settings = SimulationSettings(seconds=20.0, rate_hz=1.0)
    assert len(list(frames_of(case, make_target('cubesat', SIZE), settings))) == 20
    assert len(made) == shapes


def test_a_known_model_that_is_wrong_is_counted_by_itself():
    rows = [
        {**vars(Case('bent', 'cubesat', 'd435', model=True)), 'reason': reason, 'wrong': reason is None}
        for reason in ('no_match', None)
    ]
    line = adversaries.table(rows).splitlines()[-1]
    assert [cell.strip() for cell in line.strip('|').split('|')] == [
        'known model: bent', '2', '0', '1', '1', 'no_match',
    ]  # fmt: skip
