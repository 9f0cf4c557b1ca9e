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

"""Offline scans as users meet them: files, exit codes, one line for what is wrong, the same bytes again."""

import fcntl
import json
import os
import pty
import signal
import subprocess
import sys
import termios
import time

import numpy as np
import pytest
from scan_runs import run, simulated, summary

from debris_scanner.cli.main import main
from debris_scanner.io.mesh_exports import CLOSED_FILES
from debris_scanner.io.mesh_files import read_cloud
from debris_scanner.io.result_files import MODEL_FILES
from debris_scanner.io.trajectories import read_tum
from debris_scanner.scanner import Scanner

REPEATED = ['target_pose.tum', 'odometry.tum', 'rates.csv', 'graph.g2o', 'closure_probabilities.npz']
ALWAYS = {*REPEATED, 'summary.json'}
OF_MODEL = [*MODEL_FILES, *CLOSED_FILES, 'forecast.csv']
REPEATABLE = [*OF_MODEL, *REPEATED]


@pytest.mark.slow
def test_scan_finds_the_model_and_says_so(session_result):
    out = session_result
    assert {p.name for p in out.iterdir()} == ALWAYS | set(OF_MODEL)
    content = summary(out)
    assert (content['result'], content['reason']) == ('model', None)
    assert content['frames'] == {'read': 250, 'used': 250, 'rejected': {}}
    assert any(c['accepted'] for c in content['closures'])
    assert content['rotation_period_s'] == pytest.approx(2 * np.pi / 0.5, rel=0.02)
    assert content['model']['points'] == len(read_cloud(out / 'model.ply')) > 20_000
    assert 0 < content['wall_s'] < 600
    assert 50 < content['peak_rss_mb'] < 4000
    assert {'isolate', 'normals', 'registration', 'tracking'} <= content['timing'].keys()
    stdout, stderr = (out.with_suffix(f'.{name}').read_text() for name in ('stdout', 'stderr'))
    assert stderr == ''  # no bar where there is no terminal
    for text in ('model', '250 of 250 used', 'key frames', 'closures', str(out / 'mesh.ply')):
        assert text in stdout


def test_poses_are_stamped_as_the_frames(session_result, session_bag):
    out = session_result
    stamps = [p.stamp_ns for p in read_tum(session_bag / 'truth.tum')]
    assert [p.stamp_ns for p in read_tum(out / 'target_pose.tum')] == stamps
    assert [p.stamp_ns for p in read_tum(out / 'odometry.tum')] == stamps


@pytest.mark.slow
def test_second_run_writes_the_same_bytes(brief_result, brief_bag, tmp_path):
    out = brief_result
    # another process, hash seed, number of threads, a folder that held another result: none of it may show
    (tmp_path / 'again').mkdir()
    (tmp_path / 'again' / 'metrics.json').write_text('{}')
    threads = '2' if os.environ.get('OMP_NUM_THREADS') == '1' else '1'
    others = {'PYTHONHASHSEED': '12345', 'OMP_NUM_THREADS': threads, 'OPENBLAS_NUM_THREADS': threads}
    env = {**os.environ, **others}
    command = [sys.executable, '-m', 'debris_scanner', 'scan', str(brief_bag), '--out']
    subprocess.run([*command, str(tmp_path / 'again')], env=env, check=True, capture_output=True)
    for name in REPEATABLE:
        assert (tmp_path / 'again' / name).read_bytes() == (out / name).read_bytes(), name
    timed = {'timing', 'wall_s', 'peak_rss_mb'}
    first, second = summary(out), summary(tmp_path / 'again')
    assert {k: v for k, v in first.items() if k not in timed} == {
        k: v for k, v in second.items() if k not in timed
    }
    assert not (tmp_path / 'again' / 'metrics.json').exists()


# no model


@pytest.mark.parametrize(
    ('target', 'options', 'reason'),
    [
        ('empty', ['--seconds', '1'], 'no_target'),
        ('prism', ['--seconds', '0.5'], 'too_few_frames'),
        ('prism', ['--seconds', '3', '--motion', 'still'], 'no_closure'),
        ('prism', ['--seconds', '2'], 'no_closure'),
        ('cylinder', ['--seconds', '4', '--rate', '5'], 'unobservable_rotation'),
    ],
)
def test_no_model_says_why_and_rightly(tmp_path, capsys, target, options, reason):
    bag = simulated(tmp_path / 'bag', target, *options)
    capsys.readouterr()
    assert run(bag, tmp_path / 'out') == 3
    printed = capsys.readouterr()
    assert printed.err.count('\n') == 1
    assert printed.err.startswith(f'debris-scan scan: no model: {reason}: ')
    assert f'no model: {reason}' in printed.out
    content = summary(tmp_path / 'out')
    assert (content['result'], content['reason'], content['model']) == ('no_model', reason, None)
    assert {p.name for p in (tmp_path / 'out').iterdir()} == ALWAYS
    assert main(['evaluate', str(tmp_path / 'out'), '--truth', str(bag)]) == 0
    assert json.loads((tmp_path / 'out' / 'metrics.json').read_text())['verdict'] == 'right'


@pytest.mark.slow
def test_a_given_model_is_tracked_and_extended(brief_result, tmp_path, capsys):
    """Poses lie in the model's frame, which is that of the scan that it is from."""
    options = ('--range', '1.6', '--seconds', '4', '--rate', '5', '--spin', '0.5', '--seed', '5')
    bag = simulated(tmp_path / 'bag', 'shuttle_stack', *options)
    capsys.readouterr()
    out = tmp_path / 'out'
    assert run(bag, out, '--model', str(brief_result), '--extend') == 0
    assert 'tracked' in capsys.readouterr().out
    content = summary(out)
    assert (content['result'], content['reason']) == ('tracked', None)
    assert content['frames']['used'] == len(read_tum(out / 'target_pose.tum')) == 20
    before = summary(brief_result)['coverage']['observed_share']
    assert content['coverage']['observed_share'] > before - 0.04  # along openings a voxel or two is lost
    assert (out / 'mesh_closed.ply').is_file()


@pytest.mark.slow
def test_another_object_is_no_match(brief_result, tmp_path, capsys):
    bag = simulated(tmp_path / 'bag', 'asteroid', '--range', '1.6', '--seconds', '1.4', '--rate', '5')
    capsys.readouterr()
    assert run(bag, tmp_path / 'out', '--model', str(brief_result)) == 3
    assert 'no model: no_match: ' in capsys.readouterr().err
    assert summary(tmp_path / 'out')['reason'] == 'no_match'


def test_a_scan_without_a_model_leaves_that_of_an_earlier_one(tmp_path, capsys):
    bag = simulated(tmp_path / 'bag', 'empty', '--seconds', '0.3')
    (tmp_path / 'out').mkdir()
    for name in MODEL_FILES:
        (tmp_path / 'out' / name).write_text('of yesterday')
    capsys.readouterr()
    assert run(bag, tmp_path / 'out') == 3
    assert {p.name for p in (tmp_path / 'out').iterdir()} == {*MODEL_FILES, 'no_model'}
    assert all((tmp_path / 'out' / name).read_text() == 'of yesterday' for name in MODEL_FILES)
    assert {p.name for p in (tmp_path / 'out' / 'no_model').iterdir()} == ALWAYS
    printed, written = capsys.readouterr(), tmp_path / 'out' / 'no_model'
    assert str(written / 'summary.json') in printed.out
    left, reason = printed.err.splitlines()
    said = f'{tmp_path / "out"} holds the model of another scan and is left as it is'
    assert left == f'debris-scan scan: {said}: this scan is in {written}'
    assert reason.startswith('debris-scan scan: no model: no_target')


def test_a_second_scan_into_a_folder_is_refused_before_it_begins(tmp_path, capsys):
    bag = simulated(tmp_path / 'bag', 'empty', '--seconds', '0.3')
    capsys.readouterr()
    (tmp_path / 'out').mkdir()
    held = os.open(tmp_path / 'out', os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)  # as another process would
    assert run(bag, tmp_path / 'out') == 2
    error = capsys.readouterr().err
    assert error.startswith(f'debris-scan scan: another scan (process {os.getpid()}) writes to ')
    assert error.count('\n') == 1 and not any((tmp_path / 'out').iterdir())
    os.close(held)
    assert run(bag, tmp_path / 'out') == 3


# interruption


def interrupt_at(monkeypatch, frame, number, times=1):
    """Send a signal to this process while the scanner is within the frame."""
    process, seen = Scanner.process, []

    def interrupted(self, depth_frame):
        seen.append(depth_frame)
        if len(seen) == frame:
            for _ in range(times):
                os.kill(os.getpid(), number)
                time.sleep(0.01)
        return process(self, depth_frame)

    monkeypatch.setattr(Scanner, 'process', interrupted)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_interrupted_before_the_model(session_bag, tmp_path, monkeypatch, capsys, number):
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    interrupt_at(monkeypatch, 25, number)
    assert run(session_bag, tmp_path / 'out') == 3
    content = summary(tmp_path / 'out')
    assert content['reason'] == 'interrupted'
    assert content['frames']['read'] == 25
    assert len(read_tum(tmp_path / 'out' / 'target_pose.tum')) == 25
    assert 'no model: interrupted' in capsys.readouterr().err
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before


@pytest.mark.slow
def test_interrupted_after_the_loop_closed_saves_the_model(brief_bag, tmp_path, monkeypatch):
    interrupt_at(monkeypatch, 43, signal.SIGINT)  # of 45
    assert run(brief_bag, tmp_path / 'out') == 0
    content = summary(tmp_path / 'out')
    assert (content['result'], content['reason'], content['frames']['read']) == ('model', None, 43)
    assert {p.name for p in (tmp_path / 'out').iterdir()} == ALWAYS | set(OF_MODEL)


def test_second_interrupt_ends_at_once(session_bag, tmp_path, monkeypatch, capsys):
    interrupt_at(monkeypatch, 10, signal.SIGINT, times=2)
    assert run(session_bag, tmp_path / 'out') == 130
    assert list((tmp_path / 'out').iterdir()) == []
    assert capsys.readouterr().err.splitlines()[-1] == 'debris-scan: interrupted'


def test_terminal_shows_progress_and_ctrl_c_ends_the_scan(session_bag, tmp_path):
    terminal, end = pty.openpty()
    termios.tcsetwinsize(end, (24, 120))
    command = [sys.executable, '-m', 'debris_scanner', 'scan', str(session_bag), '--out', str(tmp_path / 'o')]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=end, text=True)
    os.close(end)
    shown = b''
    while b'key frames' not in shown:  # frames are being processed
        shown += os.read(terminal, 4096)
    process.send_signal(signal.SIGINT)
    while True:
        try:
            shown += os.read(terminal, 4096)
        except OSError:  # the other end has gone
            break
    out, _ = process.communicate(timeout=120)
    os.close(terminal)
    assert process.returncode == 3
    assert b'/250 [' in shown and b'scanning, ' in shown
    assert b'Traceback' not in shown
    assert 'no model: interrupted' in out
    assert 0 < summary(tmp_path / 'o')['frames']['read'] < 250


def test_a_second_interruption_saves_what_was_gathered(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    bag = simulated(tmp_path / 'bag', 'prism', '--seconds', '2')
    monkeypatch.setattr(Scanner, 'finish', interrupted)
    assert run(bag, tmp_path / 'out') == 3
    content = summary(tmp_path / 'out')
    assert (content['result'], content['reason']) == ('no_model', 'interrupted')
    assert content['frames']['used'] == len(read_tum(tmp_path / 'out' / 'odometry.tum')) > 0
