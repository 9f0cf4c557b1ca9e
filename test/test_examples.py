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

"""The examples do what they say. A scan of theirs takes ten seconds."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

import debris_scanner as ds
from debris_scanner.cli.main import main
from debris_scanner.core.geometry import rotation_angle

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / 'examples'


def example(name):
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(f'example_{name}', EXAMPLES / f'{name}.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope='module')
def scanned(tmp_path_factory):
    out = tmp_path_factory.mktemp('scan')
    return out, example('scan_arrays').main(out)


@pytest.mark.slow
def test_arrays_are_scanned_and_saved(scanned):
    out, result = scanned
    assert result
    summary = json.loads((out / 'summary.json').read_text())
    assert (summary['result'], summary['wall_s']) == ('model', pytest.approx(result.wall_s, abs=0.01))
    assert summary['frames']['used'] == len(result.poses) == 45


@pytest.mark.slow
def test_a_saved_model_is_used(scanned, capsys):
    import open3d as o3d  # not by each worker that collects this test: it loads plotters and classifiers

    out, result = scanned
    model = example('use_model').main(out)
    assert trimesh.load(out / 'seen.stl').extents == pytest.approx(model.to_trimesh().extents, abs=1e-6)
    shown = model.to_open3d()
    assert isinstance(shown, o3d.geometry.TriangleMesh)
    assert shown.has_vertex_normals()
    assert shown.get_max_bound() == pytest.approx(model.vertices.max(axis=0))
    assert str(len(result.model.triangles)) in capsys.readouterr().out


@pytest.mark.slow
def test_a_mesh_and_a_scans_model_are_tracked(scanned, capsys):
    track = example('track_model')
    by_mesh, by_scan = (track.main(model) for model in (track.mesh, scanned[1]))
    for estimates in (by_mesh, by_scan):
        found = [e for e in estimates if e.in_model_frame]
        assert len(found) > len(estimates) / 2
        assert all(e.state == 'tracking' for e in found)
    assert 'deg/s' in capsys.readouterr().out
    truth = {f.stamp_ns: f.T_sensor_target for f in track.frames}
    for e in (e for e in by_mesh if e.in_model_frame):
        turn = e.T_sensor_target[:3, :3] @ truth[e.stamp_ns][:3, :3].T
        assert np.degrees(rotation_angle(turn)) < 2.0
        assert np.linalg.norm(e.T_sensor_target[:3, 3] - truth[e.stamp_ns][:3, 3]) < 0.01


@pytest.mark.slow
def test_two_views_are_registered(capsys):
    found = example('register_views').main()
    assert found
    assert np.degrees(rotation_angle(found.T_a_b[:3, :3])) == pytest.approx(5.0, abs=0.3)
    assert 'turned by' in capsys.readouterr().out


@pytest.mark.slow
def test_a_scan_is_evaluated():
    figures = example('evaluate_scan').main()
    assert figures['verdict'] == 'right'
    assert figures['attitude_deg']['median'] < 1.0
    assert figures['completeness'] > 0.8


def test_a_recording_is_scanned(tmp_path):
    bag, out = tmp_path / 'bag', tmp_path / 'out'
    assert main(['simulate', 'prism', '--seconds', '1.5', '--out', str(bag)]) == 0
    result = example('scan_recording').main(bag, out)
    assert (result.frames_read, result.reason, len(result.poses)) == (15, 'no_closure', 15)
    assert json.loads((out / 'summary.json').read_text())['reason'] == 'no_closure'


@pytest.mark.slow
def test_the_notebook_runs(monkeypatch):
    import matplotlib as mpl

    monkeypatch.setattr('matplotlib.pyplot.show', lambda: None)
    mpl.use('agg')
    notebook = json.loads((EXAMPLES / 'scan.ipynb').read_text())
    names = {}
    for cell in notebook['cells']:
        if cell['cell_type'] == 'code':
            exec(compile(''.join(cell['source']), cell['id'], 'exec'), names)
            assert cell['outputs'] == []  # none is kept
    assert names['figures']['verdict'] == 'right'
    assert isinstance(names['result'], ds.ScanResult)


def test_the_readme_names_every_example():
    readme = (ROOT / 'README.md').read_text()
    for path in EXAMPLES.iterdir():
        assert path.suffix not in ('.py', '.ipynb') or f'examples/{path.name}' in readme, path.name
