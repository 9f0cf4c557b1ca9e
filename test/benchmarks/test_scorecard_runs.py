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

"""Cases that are really run: the same figures as the verbs, in processes, resumable, whatever breaks."""

import json
from dataclasses import replace

import pytest

from benchmarks.scorecard.__main__ import main
from benchmarks.scorecard.cases import all_cases
from benchmarks.scorecard.run_case import run_case
from benchmarks.scorecard.store import PACKAGES, Store, digest
from benchmarks.scorecard.tasks import run_cases
from debris_scanner.batch.sources import snapshot
from debris_scanner.cli.main import main as debris_scan

CASES = {c.name: c for c in all_cases()}
BRIEF = replace(CASES['empty-still-s0'], options={'motion': 'still', 'seconds': 0.3})
TURN = replace(
    CASES['cubesat-spin-s0'],
    options={'motion': 'spin', 'spin_rad_s': 1.0, 'seconds': 7.5, 'rate_hz': 4.0},
)


@pytest.fixture(scope='module')
def turn():
    """Record of a brief turn, with all that can be found out besides."""
    return run_case(TURN, ('bound', 'similarity'))


@pytest.mark.slow
def test_a_case_has_the_figures_of_the_verbs(turn, tmp_path):
    bag, out = tmp_path / 'bag', tmp_path / 'out'
    options = ['--spin', '1', '--seconds', '7.5', '--rate', '4']
    assert debris_scan(['simulate', 'cubesat', '--out', str(bag), *options]) == 0
    code = debris_scan(['scan', str(bag), '--out', str(out)])
    assert debris_scan(['evaluate', str(out), '--truth', str(bag)]) == 0
    assert turn['metrics'] == json.loads((out / 'metrics.json').read_text())
    summary = json.loads((out / 'summary.json').read_text())
    assert turn['scan']['frames'] == summary['frames'] and turn['scan']['reason'] == summary['reason']
    assert (code == 0) == (turn['scan']['reason'] is None)


@pytest.mark.slow
def test_a_record_is_json_and_has_what_was_asked_for(turn):
    assert json.loads(json.dumps(turn, allow_nan=False)) == turn
    assert turn['extras'] == ['bound', 'similarity']
    assert 0 < turn['bound']['model_mm']['rmse'] < 0.5 and turn['bound']['completeness'] > 0.9
    assert 0 < turn['bound']['attitude_deg']['median'] < 0.2
    assert turn['similarity'] is None or set(turn['similarity']['area']) >= {'float', 'per_bin_joint'}
    assert turn['cost']['wall_s'] > 0


def test_the_store_knows_options_and_sources(tmp_path):
    store = Store(tmp_path)
    assert not store.done(BRIEF, None)
    store.save(BRIEF, {'scan': {}, 'extras': ['bound']}, 'abc')
    assert store.done(BRIEF, 'abc', ['bound']) and store.done(BRIEF, None)
    assert not store.done(BRIEF, 'abd') and not store.done(BRIEF, 'abc', ['similarity'])
    assert store.load(replace(BRIEF, options={'motion': 'still', 'seconds': 0.4})) is None
    store.save(BRIEF, {'error': 'broke'}, 'abc')
    assert not store.done(BRIEF, 'abc') and store.load(BRIEF)['error'] == 'broke'
    (tmp_path / 'cases' / f'{BRIEF.name}.json').write_text('{"torn')
    assert store.load(BRIEF) is None
    with pytest.raises(ValueError):
        store.save(BRIEF, {'figure': float('nan')}, 'abc')


def test_the_digest_is_of_what_decides_a_result(tmp_path):
    for name in ('scanner.py', 'sim/session.py', 'core/geometry.py', 'cli/scan.py'):
        (tmp_path / 'debris_scanner' / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / 'debris_scanner' / name).write_text('x = 1\n')
    before = digest(tmp_path)
    (tmp_path / 'debris_scanner' / 'cli' / 'scan.py').write_text('x = 2\n')
    assert digest(tmp_path) == before
    for name in ('sim/session.py', 'core/geometry.py'):
        (tmp_path / 'debris_scanner' / name).write_text('x = 2\n')
        assert digest(tmp_path) != before
        before = digest(tmp_path)


@pytest.mark.slow
def test_a_case_that_breaks_costs_itself_alone():
    broken = replace(BRIEF, seed=1, options={'motion': 'wobble'})
    slow = replace(TURN, seed=2, options={**TURN.options, 'seconds': 1.0})
    found = {}

    def note(case, record):
        found[case.name] = record

    with snapshot(PACKAGES, 'scorecard-') as root:
        run_cases([broken, slow, BRIEF], 1, root, (), 300.0, note)
        assert "unknown motion 'wobble'" in found[broken.name]['error']
        assert found[BRIEF.name]['scan']['reason'] == 'no_target'
        assert 'error' not in found[slow.name]
        run_cases([slow], 1, root, (), 0.0, note)
    assert found[slow.name]['error'] == 'gave up after 0 s'


@pytest.mark.slow
def test_what_is_done_is_not_run_again(tmp_path, capfd):
    command = ['--cases', 'empty-still-s0', '--out', str(tmp_path), '--jobs', '1']
    assert main(command) == 0
    first = capfd.readouterr()
    assert '1 of 1 cases to run' in first.err and '1 cases: 1 right' in first.out
    path = tmp_path / 'cases' / 'empty-still-s0.json'
    content = path.read_bytes()
    document = tmp_path / 'docs.md'
    document.write_text('prose\n<!-- tables -->\nold\n<!-- end tables -->\nmore prose\n')
    assert main([*command, '--write', str(document)]) == 0
    assert '0 of 1 cases to run' in capfd.readouterr().err
    assert path.read_bytes() == content
    text = (tmp_path / 'scorecard.md').read_text()
    written = f'prose\n<!-- tables -->\n\n{text.strip()}\n\n<!-- end tables -->\nmore prose\n'
    assert document.read_text() == written
    document.write_text('prose\n')
    assert main([*command, '--table', '--write', str(document)]) == 2
    assert 'no section <!-- tables -->' in capfd.readouterr().err
    assert '`python -m benchmarks.scorecard --cases empty-still-s0`' in text and str(tmp_path) not in text
    assert main([*command, '--fresh']) == 0
    assert '1 of 1 cases to run' in capfd.readouterr().err
