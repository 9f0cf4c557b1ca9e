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

"""Half and double of each tunable: what is tried, and how it is told."""

import pytest

from benchmarks.scorecard.cases import all_cases
from benchmarks.sensitivity import DEFAULT_CASES, changed, changes, main, table
from debris_scanner.core.parameters import flatten
from debris_scanner.settings import Settings, tunables


def test_each_change_changes_one_tunable_within_its_range():
    usual = flatten(Settings())
    tried = list(changes())
    assert changed(tried[0]) == Settings()
    assert len(tried) == 1 + 2 * len(tunables())
    for name, factor in tried[1:]:
        values = flatten(changed((name, factor)))
        assert [n for n in usual if values[n] != usual[n]] == [name]
        assert values[name] == pytest.approx(factor * usual[name], abs=0.51)


def test_default_cases_exist():
    assert set(DEFAULT_CASES.split(',')) <= {c.name for c in all_cases()}


def test_table_names_what_differs():
    cases = ['a', 'b']
    found = {f'{name}*{factor:g}': dict.fromkeys(cases, 'right') for name, factor in changes()}
    found['*1'] = dict.fromkeys(cases, 'right')
    found['verdict.max_gain*0.5'] = {'a': 'right', 'b': 'false refusal'}
    text = table(found, cases)
    assert text.startswith('2 of 2 right with no change.')
    assert '| `verdict.max_gain` | 0.08 | b: false refusal | as before |' in text
    assert f'1 of {4 * len(tunables())} verdicts differ' in text


def test_unknown_case_is_named(capsys):
    assert main(['--cases', 'teapot-spin-s0']) == 2
    assert 'teapot-spin-s0' in capsys.readouterr().err
