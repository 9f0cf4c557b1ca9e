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

"""The table and the one line that a finished scan leaves its user with."""

import re
from pathlib import Path

import numpy as np
import pytest

from debris_scanner.cli.outcome import REASONS, format_outcome, report_outcome
from debris_scanner.core import results
from debris_scanner.core.frames import Model
from debris_scanner.core.results import ClosureRecord
from debris_scanner.io.outcome import loss_words
from debris_scanner.io.result_files import ScanResult, summary, write_results

POINTS = np.eye(3, dtype=np.float32)
MODEL = Model(POINTS, POINTS, POINTS, np.array([[0, 1, 2]], np.int32))
CLOSURES = [ClosureRecord(1, 2, 0.9, True, 'good'), ClosureRecord(1, 3, 0.5, False, 'bad')]


def test_model_is_done(tmp_path, capsys):
    found = ScanResult(
        None,
        MODEL,
        closures=CLOSURES,
        frames_read=10,
        frames_rejected={'no_target': 3},
        rotation_period_s=12.5,
    )
    write_results(tmp_path, found, 2.0)
    assert report_outcome(tmp_path, tmp_path, 'scan') == 0
    printed = capsys.readouterr()
    assert printed.err == ''
    *table, after = printed.out.splitlines()
    rows = dict(re.split(r'  +', line, maxsplit=1) for line in table if line[0] != ' ')
    assert rows['result'] == 'model'
    assert after == f'Next: debris-scan report {tmp_path}'
    assert rows['frames'] == '7 of 10 used (3 no_target)'
    assert rows['closures'] == '1 of 2 accepted'
    assert rows['rotation period'] == '12.50 s'
    assert rows['model'] == '3 points, 1 triangles'
    assert rows['coverage'] == '-'
    for name in ('model.ply', 'mesh.ply', 'target_pose.tum', 'summary.json'):
        assert str(tmp_path / name) in printed.out
        assert (tmp_path / name).is_file()


@pytest.mark.parametrize('reason', sorted(REASONS))
def test_no_model_says_why_in_one_line(tmp_path, capsys, reason):
    write_results(tmp_path, ScanResult(reason, None, frames_read=4), 1.0)
    code = report_outcome(tmp_path, tmp_path, 'live', 'residual 3 mm\n > 2 mm')
    assert code == (2 if reason == 'camera_info' else 3)  # bad input is no verdict
    printed = capsys.readouterr()
    assert printed.err == f'debris-scan live: no model: {reason}: {REASONS[reason]} (residual 3 mm > 2 mm)\n'
    assert f'no model: {reason}' in printed.out
    assert 'model.ply' not in printed.out


def test_the_line_ends_with_what_is_odd_about_the_input(tmp_path, capsys):
    write_results(tmp_path, ScanResult('no_target', None, hint='all stamps are 0'), 1.0)
    assert report_outcome(tmp_path, tmp_path, 'scan', '0 frames') == 3
    printed = capsys.readouterr()
    assert printed.err.endswith(f'{REASONS["no_target"]} (0 frames; all stamps are 0)\n')
    assert re.search('^hint +all stamps are 0$', printed.out, re.MULTILINE)


@pytest.mark.parametrize(('lost', 'said'), [(16, 'lost in transport: 16 of 69 frames (23 %)'), (2, '')])
def test_frames_lost_in_transport_are_said_beyond_a_share(tmp_path, capsys, lost, said):
    found = ScanResult(None, MODEL, frames_read=69, frames_rejected={'lost_in_transport': lost})
    write_results(tmp_path, found, 1.0)
    assert report_outcome(tmp_path, tmp_path, 'live') == 0
    assert capsys.readouterr().err == (f'debris-scan live: warning: {said}\n' if said else '')


def test_a_single_loss_is_no_share():
    assert not loss_words(1, 30, 'frames')
    assert not loss_words(2, 29, 'frames')
    assert loss_words(2, 40, 'frames') == 'lost in transport: 2 of 40 frames (5 %)'


def test_every_reason_of_the_contract_has_words():
    declared = {
        getattr(results, name)
        for name in dir(results)
        if name.isupper() and isinstance(getattr(results, name), str)
    }
    assert declared == REASONS.keys()


def test_table_needs_no_more_than_the_summary():
    text = format_outcome(summary(ScanResult('no_target', None), 0.5), Path('out'))
    assert 'rotation period   -' in text
    assert '0 of 0 used' in text
