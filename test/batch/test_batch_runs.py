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

"""Batches on this machine, with scans that take no time: whatever breaks, all is accounted for."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from batch_waits import ROOT, WAIT_S, until
from stub_scans import recordings

from debris_scanner.cli.main import main

pytestmark = pytest.mark.slow


def rows(out):
    with (out / 'batch.csv').open() as file:
        return {row['name']: row for row in csv.DictReader(file)}


def results(out):
    return {name: row['result'] for name, row in rows(out).items()}


def family(process):
    return psutil.Process(process.pid).children(recursive=True)


def ended(process, members):
    process.wait(WAIT_S)
    assert psutil.wait_procs(members, timeout=30)[1] == []


def test_what_breaks_costs_itself_alone_and_is_all_that_is_done_again(verb, begun, tmp_path):
    bags = recordings(tmp_path / 'bags', good='', other='', poison='poison', crash='crash', full='full')
    recordings(bags, greedy='greedy', wrong='uncalibrated')
    out = tmp_path / 'out'
    command = [bags, '--out', out, '--workers', '1', '--retries', '1', '--memory', '1GB']
    done = verb(*command)
    errors = done.communicate(timeout=WAIT_S)[1]
    assert done.returncode == 2, errors
    assert 'dashboard http://127.0.0.1:' in errors and '5 of 7 recordings have no result' in errors
    assert 'Traceback' not in errors
    found = rows(out)
    broken = {'poison': 'bad_input', 'crash': 'failed', 'full': 'failed', 'greedy': 'failed'}
    broken |= {'wrong': 'bad_input'}
    assert results(out) == {'good': 'no_model', 'other': 'no_model', **broken}
    assert found['good']['reason'] == 'no_target' and found['poison']['reason'] == 'not a bag'
    assert 'SIGSEGV' in found['crash']['reason'] and 'MB of memory' in found['greedy']['reason']
    assert 'No space left' in found['full']['reason']
    assert found['wrong']['reason'] == 'camera_info: fx 0'  # no recording to scan again, but one to look at
    assert [found[n]['attempts'] for n in ('good', 'poison', 'crash')] == ['1', '1', '2']
    assert begun() == {'good': 1, 'other': 1, 'poison': 1, 'crash': 2, 'full': 2, 'greedy': 2, 'wrong': 1}
    assert (out / 'good' / 'log.txt').read_text() == 'scanning good.mcap\n'
    assert 'scanning crash.mcap' in (out / '_failed' / 'crash' / 'log.txt').read_text()
    assert {'summary.json', 'report.html', 'batch.json'} <= {p.name for p in (out / 'good').iterdir()}
    page = (out / 'index.html').read_text()
    assert 'good/report.html' in page and '_failed/crash/log.txt' in page
    assert (out / 'wrong' / 'report.html').is_file() and 'wrong/report.html' in page
    # the record says what the result is of
    key = json.loads((out / 'good' / 'batch.json').read_text())['key']
    assert set(key) == {'input', 'parameters', 'program'}
    told = (found['good'][name] for name in ('input_sha256', 'parameters_sha256', 'program'))
    assert tuple(told) == tuple(key.values())
    assert Path(found['good']['url'].removeprefix('file://')) == bags / 'good.mcap'

    # touched, changed, mended and new
    os.utime(bags / 'good.mcap')
    recordings(bags, other='changed', crash='mended', full='', greedy='', fresh='')
    done = verb(*command)
    assert done.wait(WAIT_S) == 2  # the poisoned and the wrong one
    again = {'other': 2, 'crash': 3, 'full': 3, 'greedy': 3}
    assert begun() == again | {'good': 1, 'poison': 1, 'wrong': 1, 'fresh': 1}
    assert results(out) == dict.fromkeys(begun(), 'no_model') | dict.fromkeys(
        ('poison', 'wrong'), 'bad_input'
    )
    assert not (out / '_failed' / 'crash').exists()
    # nothing is left to do, and other parameters are another result
    done = verb(*command)
    assert '8 recordings, 8 of them done already' in done.communicate(timeout=WAIT_S)[1]
    parameters = tmp_path / 'parameters.yaml'
    parameters.write_text('/**:\n  ros__parameters:\n    odometry:\n      max_loss: 1.5\n')
    done = verb(bags / 'good.mcap', '--out', out, '--workers', '1', '--params', parameters)
    assert done.communicate(timeout=WAIT_S)[0].startswith('no model')
    assert begun()['good'] == 2 and len(rows(out)) == 8


def test_a_frame_that_raises_is_no_reason_to_scan_again(tmp_path):
    bag, out = tmp_path / 'bag', tmp_path / 'out'
    assert main(['simulate', 'prism', '--seconds', '1.5', '--out', str(bag)]) == 0
    variables = {
        'PYTHONPATH': f'{ROOT / "test" / "raising"}:{ROOT}',
        'RAISE_AT': 'debris_scanner.tracking.odometry:Odometry.process:10',
        'RAISED': str(tmp_path),
    }
    command = [sys.executable, '-m', 'debris_scanner', 'batch', bag, '--out', out, '--workers', '1']
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | variables)
    assert done.returncode == 0, done.stderr
    (row,) = rows(out).values()
    assert (row['result'], row['attempts']) == ('no_model', '1')
    summary = json.loads((out / row['name'] / 'summary.json').read_text())
    assert summary['errors'] == {'ZeroDivisionError': 1}
    assert summary['frames']['rejected'] == {'error': 1}


def slow_bags(tmp_path):
    names = {f'r{k}': 'slow 1' for k in range(6)}
    return recordings(tmp_path / 'bags', **names)


@pytest.mark.parametrize('number', [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.faults)])
def test_a_batch_that_is_ended_goes_on(verb, begun, tmp_path, number):
    """Ctrl-C, which the whole group receives, and kill -9: no process stays, what is done is done."""
    bags, out = slow_bags(tmp_path), tmp_path / 'out'
    first = verb(bags, '--out', out, '--workers', '2')
    until(lambda: len(list(out.glob('*/batch.json'))) >= 2)
    members = family(first)
    if number == signal.SIGINT:
        os.killpg(first.pid, number)
    else:
        first.kill()
    ended(first, members)
    complete = {p.parent.name for p in out.glob('*/batch.json')}
    if number == signal.SIGINT:
        errors = first.stderr.read()
        assert first.returncode == 130 and 'Traceback' not in errors, errors
        assert 'recordings are left; the same command goes on' in errors
        assert set(results(out)) == {f'r{k}' for k in range(6)}
    under_way = {n for n in begun() if n not in complete}
    assert len(under_way) <= 2
    again = verb(bags, '--out', out, '--workers', '2')
    assert again.wait(WAIT_S) == 0
    assert set(results(out).values()) == {'no_model'} and len(results(out)) == 6
    assert {n for n, count in begun().items() if count > 1} <= under_way
    assert [p for p in out.iterdir() if p.name.endswith(('.part', '.old'))] == []


@pytest.mark.faults
def test_a_worker_that_is_killed_loses_what_it_had_under_way(verb, begun, tmp_path):
    bags, out = slow_bags(tmp_path), tmp_path / 'out'
    batch = verb(bags, '--out', out, '--workers', '2')
    until(lambda: begun().total() >= 3)
    workers = [p for p in psutil.Process(batch.pid).children() if p.children()]
    workers[0].kill()
    assert batch.wait(WAIT_S) == 0
    assert set(results(out).values()) == {'no_model'} and len(results(out)) == 6
    assert begun().total() <= 7


def test_the_second_batch_into_a_folder_is_refused(verb, tmp_path):
    bags, out = slow_bags(tmp_path), tmp_path / 'out'
    first = verb(bags, '--out', out, '--workers', '1')
    until(lambda: (out / '.batch.lock').exists() and (out / '.batch.lock').read_text())
    second = verb(bags, '--out', out, '--workers', '1')
    errors = second.communicate(timeout=WAIT_S)[1]
    assert second.returncode == 2 and 'another batch' in errors and errors.count('\n') == 1
    os.killpg(first.pid, signal.SIGINT)
    first.wait(WAIT_S)


@pytest.mark.faults
def test_a_disk_that_is_full_fails_recordings_and_a_larger_one_mends_them(verb, begun, tmp_path):
    """Files may be 300 kB: reports do not fit, tables do."""
    bags, out = recordings(tmp_path / 'bags', a='', b=''), tmp_path / 'out'
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, usual[1]))
    try:
        batch = verb(bags, '--out', out, '--workers', '1', '--retries', '0')
        errors = batch.communicate(timeout=WAIT_S)[1]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert batch.returncode == 2, errors
    assert results(out) == {'a': 'failed', 'b': 'failed'}
    assert 'File too large' in rows(out)['a']['reason']
    assert not (out / 'a').exists()
    assert verb(bags, '--out', out, '--workers', '1').wait(WAIT_S) == 0
    assert results(out) == {'a': 'no_model', 'b': 'no_model'}


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--workers', '0'], '--workers must be at least 1'),
        (['--retries', '-1'], '--retries must be at least 0'),
        (['--memory', 'much'], 'not a size'),
        (['--params', 'nowhere.yaml'], 'cannot read parameters'),
    ],
)
def test_bad_usage_is_one_line(tmp_path, capsys, options, said):
    bags = recordings(tmp_path / 'bags', a='')
    assert main(['batch', str(bags), '--out', str(tmp_path / 'out'), *options]) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_without_its_libraries_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('debris_scanner.batch._NEEDED', ('distributed', 'no_such_library'))
    assert main(['batch', str(tmp_path), '--out', str(tmp_path / 'out')]) == 2
    err = capsys.readouterr().err
    assert 'no_such_library' in err and "pip install 'debris_scanner[batch]'" in err and err.count('\n') == 1
