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

"""``debris-scan merge``: usage, and the files of a merged model."""

import json

import pytest

from debris_scanner import merging
from debris_scanner.cli.main import main
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.sim.shapes import box


def test_one_scan_is_not_enough(tmp_path, capsys):
    write_mesh_ply(tmp_path / 'a.ply', *box((0.2, 0.3, 0.4)))
    assert main(['merge', str(tmp_path / 'a.ply'), '--out', str(tmp_path / 'out')]) == 2
    assert 'at least two scans' in capsys.readouterr().err


def test_a_scan_is_never_overwritten(tmp_path, capsys):
    folder = str(tmp_path)
    assert main(['merge', folder, str(tmp_path / 'b'), '--out', folder]) == 2
    assert 'is one of the scans' in capsys.readouterr().err


def test_a_folder_without_a_model_is_named(tmp_path, capsys):
    write_mesh_ply(tmp_path / 'a.ply', *box((0.2, 0.3, 0.4)))
    (tmp_path / 'b').mkdir()
    assert main(['merge', str(tmp_path / 'a.ply'), str(tmp_path / 'b'), '--out', str(tmp_path / 'out')]) == 2
    assert 'it has no summary.json' in capsys.readouterr().err


@pytest.mark.slow
def test_a_scan_merges_with_itself(brief_result, tmp_path, monkeypatch, capsys):
    few = {'SEARCH_VIEWS': 8, 'SEARCH_PIXELS': 160, 'FUSED_VIEWS': 20, 'MOST_PIXELS': 160}
    for name, value in few.items():
        monkeypatch.setattr(merging, name, value)
    out = tmp_path / 'out'
    assert main(['merge', str(brief_result), str(brief_result), '--out', str(out)]) == 0
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['result'] == 'model' and len(summary['merged']) == 2
    assert abs(summary['merged'][1]['T_first_scan'][6]) == pytest.approx(1, abs=1e-3)
    assert (out / 'mesh_closed.ply').is_file()
    rows = capsys.readouterr().out.splitlines()
    titles = [row[:18].strip() for row in rows]
    assert titles[:5] == ['result', 'scans placed', 'model', 'coverage', 'time']  # nothing of frames
    assert rows[1].endswith(' 2') and not any('target_pose' in row for row in rows)
