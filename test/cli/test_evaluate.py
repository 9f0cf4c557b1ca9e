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

"""Figures of a scan from the command line, and the bounds that real and simulated scans must keep."""

import json
import shutil

import numpy as np
import pytest

from debris_scanner.cli.evaluate import evaluate_and_print, recorded_frames
from debris_scanner.cli.main import main
from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import NO_CLOSURE, StampedPose
from debris_scanner.evaluation.true_surface import sample_mesh
from debris_scanner.io.mesh_files import read_mesh
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.io.trajectories import read_tum

CONTRACT = {
    'attitude_deg',
    'position_mm',
    'model_mm',
    'mesh_mm',
    'completeness',
    'closures',
    'drift',
    'verdict',
}
TURN = transform(exp_so3(np.array([0.2, -0.4, 0.1])), np.array([0.01, 0.0, -0.02]))  # T_truth_target


def run(directory, truth, *options):
    return main(['evaluate', str(directory), '--truth', str(truth), *options])


def metrics(directory):
    return json.loads((directory / 'metrics.json').read_text())


@pytest.fixture(scope='module')
def perfect_once(brief_bag, tmp_path_factory):
    vertices, triangles = read_mesh(brief_bag / 'truth_mesh.ply')
    inverse_turn = np.linalg.inv(TURN)
    moved = vertices @ inverse_turn[:3, :3].T + inverse_turn[:3, 3]
    points = sample_mesh(moved, triangles, 60_000).astype(np.float32)
    model = Model(points, np.zeros_like(points), moved.astype(np.float32), triangles.astype(np.int32))
    poses = [StampedPose(p.stamp_ns, p.T_sensor_target @ TURN) for p in read_tum(brief_bag / 'truth.tum')]
    result = ScanResult(None, model, poses=poses, odometry=poses, frames_read=len(poses))
    folder = tmp_path_factory.mktemp('once') / 'perfect'
    write_results(folder, result, 1.0)
    return folder


@pytest.fixture
def perfect(perfect_once, tmp_path):
    """A result that is the truth itself, in another target frame; a copy, to change and to damage."""
    return shutil.copytree(perfect_once, tmp_path / 'perfect')


def test_figures_go_to_the_file_and_the_table(perfect, brief_bag, capsys):
    assert run(perfect, brief_bag) == 0
    found = metrics(perfect)
    assert found.keys() >= CONTRACT
    assert found['attitude_deg']['max'] < 0.01
    assert found['model_mm']['rmse'] < 0.01
    assert found['completeness'] > 0.99
    assert found['verdict'] == 'right'
    out = capsys.readouterr().out
    for text in ('attitude error', 'completeness', 'verdict', 'right', str(perfect / 'metrics.json')):
        assert text in out


def test_no_model_is_evaluated_too(brief_bag, tmp_path, capsys):
    write_results(tmp_path, ScanResult(NO_CLOSURE, None, frames_read=45), 1.0)
    assert run(tmp_path, brief_bag) == 0
    found = metrics(tmp_path)
    assert (found['verdict'], found['attitude_deg'], found['model_mm']) == ('wrong', None, None)
    assert 'a model was missed' in capsys.readouterr().out


def test_live_evaluates_frames_that_were_never_recorded(perfect, brief_bag, capsys):
    frames = [f for k, f in enumerate(recorded_frames(brief_bag)) if k % 9 == 0]
    found = evaluate_and_print(perfect, brief_bag, frames)
    assert found == metrics(perfect)
    assert 0.9 < found['completeness'] <= 1.0
    assert 'verdict' in capsys.readouterr().out


@pytest.mark.parametrize('name', ['summary.json', 'target_pose.tum', 'model.ply', 'mesh.ply'])
def test_missing_result_is_named(perfect, brief_bag, capsys, name):
    (perfect / name).unlink()
    assert run(perfect, brief_bag) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1 and name in err and err.startswith('debris-scan evaluate: ')
    assert not (perfect / 'metrics.json').exists()


@pytest.mark.parametrize(
    ('name', 'word'),
    [
        ('truth.tum', 'truth.tum'),
        ('truth_mesh.ply', 'truth_mesh.ply'),
        ('brief.mcap', 'no .mcap'),
    ],
)
def test_missing_truth_is_named(perfect, brief_bag, tmp_path, capsys, name, word):
    shutil.copytree(brief_bag, tmp_path / 'bag')
    (tmp_path / 'bag' / name).unlink()
    assert run(perfect, tmp_path / 'bag') == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1 and word in err


@pytest.mark.parametrize('text', ['{', '[]', '{"result": "perhaps"}'])
def test_damaged_summary(perfect, brief_bag, capsys, text):
    (perfect / 'summary.json').write_text(text)
    assert run(perfect, brief_bag) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1 and 'summary.json' in err


def scan_and_evaluate(bag, out):
    assert main(['scan', str(bag), '--out', str(out)]) == 0
    assert run(out, bag) == 0
    return metrics(out)


def test_recorded_session_keeps_its_bounds(session_bag, session_result, tmp_path):
    out = shutil.copytree(session_result, tmp_path / 'shuttle')
    assert run(out, session_bag) == 0
    found = metrics(out)
    assert found['attitude_deg']['median'] <= 0.3
    assert found['attitude_deg']['max'] <= 1.0
    assert found['model_mm']['rmse'] <= 1.0
    assert found['completeness'] >= 0.95
    assert found['closures']['false'] == 0
    assert found['closures']['precision'] == 1.0
    assert found['closures_by'] == 'pose'
    assert found['verdict'] == 'right'


@pytest.mark.slow
def test_real_recording_keeps_its_bounds(bunny_bag, tmp_path):
    """A PrimeSense before a turntable, 10 degrees a frame; truth from its marker board."""
    out = tmp_path / 'out'
    found = scan_and_evaluate(bunny_bag, out)
    assert found['attitude_deg']['median'] <= 1.0
    assert found['attitude_deg']['max'] <= 2.5
    assert found['model_mm']['median'] <= 0.7
    assert found['verdict'] == 'right'
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['result'] == 'model'
    accepted = [c for c in summary['closures'] if c['accepted']]
    # the loop over the full turn: from the first frames to the last ones, 7 s later
    assert max(c['to_stamp_ns'] - c['from_stamp_ns'] for c in accepted) > 6.5e9
