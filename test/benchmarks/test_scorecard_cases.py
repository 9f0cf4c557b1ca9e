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

"""The matrix: every name once, every simulator's option known, held-out cases apart, a short set in it."""

import json
from collections import Counter

import pytest

from benchmarks.scorecard.__main__ import main, parser, select
from benchmarks.scorecard.cases import (
    BODY,
    EXTRAS,
    HELD_OUT_SEEDS,
    MOTIONS,
    QUICK,
    SEEDS,
    SENSORS_CROSSED,
    TUMBLES,
    all_cases,
)
from benchmarks.scorecard.targets import CURVED, FLAT, NEAR_AXISYMMETRIC, RECORDING, TARGETS, available
from debris_scanner.sim.clutter import CLUTTER_NAMES
from debris_scanner.sim.session import SimulationSettings
from debris_scanner.sim.targets import TARGET_NAMES

CASES = {c.name: c for c in all_cases()}


def chosen(*options):
    return select(parser().parse_args(options))


def test_names_are_unique_and_fit_for_files():
    assert len(CASES) == len(all_cases())
    assert all(name.replace('-', '').replace('_', '').isalnum() for name in CASES)


def test_the_matrix_has_every_target_and_motion_and_condition():
    names = {c.target.name for c in CASES.values()}
    assert names == set(TARGETS) and set(TARGET_NAMES) <= names
    assert {c.motion for c in CASES.values()} >= set(MOTIONS)
    assert {c.options.get('clutter') for c in CASES.values()} >= set(CLUTTER_NAMES)
    assert {c.options.get('rate_hz', 10.0) for c in CASES.values()} >= {1.0, 2.0, 3.0, 5.0, 10.0, 30.0}
    for flag in ('mli', 'correlated', 'gaps', 'patchy', 'leaves_s'):
        assert any(c.options.get(flag) for c in CASES.values()), flag


def test_every_observable_target_sees_every_motion_of_the_body_with_three_seeds():
    count = Counter((c.target.name, c.motion) for c in CASES.values() if not c.condition and c.seed in SEEDS)
    for target in TARGETS.values():
        if target.kind in (CURVED, FLAT, NEAR_AXISYMMETRIC):
            assert all(count[target.name, motion] == 3 for motion in BODY), target.name


def test_keys_are_json_and_settings_are_the_simulators():
    for case in CASES.values():
        assert json.loads(json.dumps(case.key)) == case.key
        SimulationSettings(target=case.target.name, seed=case.seed, **case.options)
        assert case.frames > 0


def test_recordings_last_long_enough_for_a_turn():
    for case in CASES.values():
        if case.may_be_modelled and case.options.get('motion') in ('spin', 'swing', 'clohessy_wiltshire'):
            assert abs(case.options.get('spin_rad_s', 0.5)) * case.options['seconds'] > 1.3 * 6.283


def test_what_cannot_be_modelled_has_its_reasons():
    for case in CASES.values():
        assert case.may_be_modelled or case.reasons


def test_held_out_cases_are_run_by_that_name_alone():
    assert not any(c.held_out for c in chosen())
    held = chosen('--held-out')
    assert held and all(c.target.held_out or c.seed in HELD_OUT_SEEDS for c in held)
    assert len(chosen('--everything')) == len(chosen()) + len(held) == len(CASES)
    kinds = {c.target.kind for c in held}
    assert kinds >= {CURVED, FLAT, NEAR_AXISYMMETRIC}


def test_the_quick_set_is_telling():
    quick = [CASES[name] for name in QUICK]
    assert len(set(QUICK)) == len(QUICK) == len(chosen('--quick'))
    assert 50 <= sum(c.target.kind != RECORDING for c in quick) <= 70
    assert not any(c.held_out for c in quick)
    assert {c.target.name for c in quick} == {t.name for t in TARGETS.values() if not t.held_out}
    assert {c.motion for c in quick} == {c.motion for c in chosen()}
    assert {c.condition for c in quick} == {c.condition for c in chosen()}
    assert {c.seed for c in quick} == {0}
    moves = {(c.options.get('sensor'), c.motion in TUMBLES) for c in quick}
    assert moves >= {(sensor, tumbles) for sensor in SENSORS_CROSSED for tumbles in (False, True)}
    classes = Counter(c.target.kind for c in quick)
    assert min(classes[kind] for kind in (CURVED, FLAT, NEAR_AXISYMMETRIC)) >= 15


def test_the_sample_holds_every_sensor_size_and_held_out_target():
    sample = chosen('--sample')
    assert {c.name for c in sample} >= set(QUICK)
    assert {c.options.get('sensor') for c in sample} >= {None, *SENSORS_CROSSED}
    assert any(c.options.get('size') == 1.6 for c in sample)
    assert {c.target.name for c in sample if c.held_out} == {t.name for t in TARGETS.values() if t.held_out}


def test_selections_combine():
    cases = chosen('--targets', 'prism,cubesat', '--motions', 'gaps', '--seeds', '1', '--conditions', 'usual')
    assert [c.name for c in cases] == ['prism-gaps-s1', 'cubesat-gaps-s1']
    assert [c.name for c in chosen('--cases', 'juno-spin-s0')] == ['juno-spin-s0']


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        (['--targets', 'teapot'], 'there is no teapot'),
        (['--motions', 'still', '--targets', 'mir'], 'no case'),
        (['--jobs', '0'], '--jobs'),
    ],
)
def test_bad_selections_are_named(options, message, capsys):
    assert main(options) == 2
    assert message in capsys.readouterr().err


def test_the_list_names_cases_and_runs_nothing(capsys):
    assert main(['--list', '--held-out', '--targets', 'juno', '--seeds', '0', '--motions', 'spin']) == 0
    assert capsys.readouterr().out.splitlines()[0] == 'juno-spin-s0  (held out)'


def test_meshes_are_found_where_the_data_lie(shared_data, monkeypatch):
    monkeypatch.setenv('DEBRIS_SCANNER_DATA', str(shared_data))
    assert all(available(t) for t in TARGETS.values())
    monkeypatch.setenv('DEBRIS_SCANNER_DATA', str(shared_data / 'nowhere'))
    missing = {t.name for t in TARGETS.values() if not available(t)}
    assert missing == {t.name for t in TARGETS.values() if t.mesh or t.kind == RECORDING}


def test_extras_are_options():
    assert all(hasattr(parser().parse_args([]), extra) for extra in EXTRAS)
