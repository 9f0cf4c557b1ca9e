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

""""""

import csv
import dataclasses
import json
import os
import stat

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, Model, Texture
from debris_scanner.core.geometry import exp_se3, exp_so3, from_quaternion, transform
from debris_scanner.core.results import (
    NO_CLOSURE,
    ClosureRecord,
    Descriptions,
    Forecast,
    GraphEdge,
    RateSample,
    ScanResult,
    StampedPose,
)
from debris_scanner.io.result_files import OutputError, check_output_dir, summary, write_results
from debris_scanner.io.trajectories import read_tum
from debris_scanner.mapping.closure_matrices import ClosureMatrices

ALL = {
    'model.pcd', 'model.ply', 'mesh.ply', 'mesh.vtk', 'target_pose.tum', 'odometry.tum', 'rates.csv',
    'forecast.csv', 'graph.g2o', 'summary.json',
}  # fmt: skip
T_FROM_TO = transform(exp_so3(np.array([0, 0, np.pi / 2])), np.array([0.1, -0.2, 0.03]))
OF_THE_MODEL = {'model.pcd', 'model.ply', 'mesh.ply', 'mesh.vtk', 'forecast.csv'}


@pytest.fixture
def found():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(20, 3)).astype(np.float32)
    model = Model(points, points.copy(), points[:3], np.array([[0, 1, 2]], np.int32))
    poses = [StampedPose(k * 100_000_000, exp_se3(rng.normal(size=6))) for k in range(8)]
    return ScanResult(
        reason=None,
        model=model,
        poses=poses,
        odometry=poses[:5],
        rates=[
            RateSample(5, np.array([0.1, 0.2, -0.3]), np.full(3, 0.01), True),
            RateSample(6, np.array([1.0, 2.0, 3.0]), np.full(3, 0.02), False),
        ],
        keyframe_poses=poses[::2],
        edges=[GraphEdge(0, 1, np.eye(4), np.eye(6))],
        closures=[
            ClosureRecord(0, 600_000_000, 0.91, True, 'overlap 0.8', T_FROM_TO),
            ClosureRecord(0, 200_000_000, 0.31, False, 'the views do not overlap'),
        ],
        frames_read=11,
        frames_rejected={'too_few_points': 1, 'no_target': 2},
        rotation_period_s=22.5,
        rotation_axis_sensor=np.array([0.0, 1.0, 0.0]),
        symmetry=2,
        forecast=Forecast(
            [1_700_000_000, 2_700_000_000],
            np.array([exp_se3(rng.normal(size=6)) for _ in range(2)]),
            *rng.normal(size=(4, 2, 3)),
        ),
        timing={'odometry': {'count': 8, 'p50_ms': 9.0, 'p99_ms': 20.0}},
    )


@pytest.fixture
def failed(found):
    return ScanResult(reason=NO_CLOSURE, model=None, odometry=found.odometry, frames_read=5)


def names(directory):
    return {p.name for p in directory.iterdir()}


def read_summary(directory):
    return json.loads((directory / 'summary.json').read_text())


def test_writes_every_file_of_the_contract_and_nothing_else(found, tmp_path):
    write_results(tmp_path / 'deep' / 'out', found, 12.3456)
    assert names(tmp_path / 'deep' / 'out') == ALL


def test_summary_has_exactly_the_contracted_keys(found, tmp_path):
    write_results(tmp_path, found, 12.3456)
    content = read_summary(tmp_path)
    assert list(content) == [
        'result', 'reason', 'frames', 'keyframes', 'closures', 'rotation_period_s', 'rotation_axis_sensor',
        'symmetry', 'sensor', 'model', 'coverage', 'mass_properties', 'timing', 'wall_s', 'peak_rss_mb',
        'versions',
    ]  # fmt: skip
    assert content['result'] == 'model'
    assert content['reason'] is None
    assert content['frames'] == {'read': 11, 'used': 8, 'rejected': {'no_target': 2, 'too_few_points': 1}}
    assert content['keyframes'] == 4
    assert content['closures'] == [
        {
            'from_stamp_ns': 0,
            'to_stamp_ns': 600_000_000,
            'T_from_to': pytest.approx([0.1, -0.2, 0.03, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]),
            'probability': 0.91,
            'accepted': True,
            'why': 'overlap 0.8',
        },
        {
            'from_stamp_ns': 0,
            'to_stamp_ns': 200_000_000,
            'T_from_to': None,
            'probability': 0.31,
            'accepted': False,
            'why': 'the views do not overlap',
        },
    ]
    assert content['rotation_period_s'] == 22.5
    assert content['rotation_axis_sensor'] == [0.0, 1.0, 0.0]
    assert content['symmetry'] == 2
    assert content['model'] == {'points': 20, 'triangles': 1}
    assert content['timing'] == found.timing
    assert content['wall_s'] == 12.346
    assert 10 < content['peak_rss_mb'] < 1e5
    assert {'debris_scanner', 'python', 'numpy'} <= set(content['versions'])


def test_no_model_says_why(failed, tmp_path):
    write_results(tmp_path, failed, 1.0)
    content = read_summary(tmp_path)
    assert (content['result'], content['reason'], content['model']) == ('no_model', 'no_closure', None)
    assert content['rotation_axis_sensor'] is None
    assert names(tmp_path) == ALL - OF_THE_MODEL


def test_the_model_of_an_earlier_scan_does_not_stay(found, failed, tmp_path):
    (tmp_path / 'notes.txt').write_text('mine')
    write_results(tmp_path, found, 1.0)
    write_results(tmp_path, failed, 1.0)
    assert names(tmp_path) == (ALL - OF_THE_MODEL) | {'notes.txt'}
    assert read_tum(tmp_path / 'target_pose.tum') == []


def test_the_texture_of_an_earlier_scan_does_not_stay(found, tmp_path):
    ball = trimesh.creation.icosphere(1)
    vertices, triangles = ball.vertices.astype(np.float32), ball.faces.astype(np.int32)
    uv = (vertices[:, :2] + 1) / 2
    image, observed = np.full((8, 8, 3), 50, np.uint8), np.ones((8, 8), bool)
    texture = Texture(image, observed, np.arange(len(vertices), dtype=np.int32), triangles, uv)
    plain = ClosedMesh(vertices, triangles, np.ones(len(triangles), bool))
    textured = dataclasses.replace(plain, texture=texture)
    written = []
    for closed in (plain, textured, plain):
        model = dataclasses.replace(found.model, closed=closed)
        write_results(tmp_path, dataclasses.replace(found, model=model), 1.0)
        written.append({p.name: p.read_bytes() for p in tmp_path.iterdir() if p.name != 'summary.json'})
    assert written[1].keys() - written[0].keys() == {'mesh_closed.mtl', 'mesh_closed.png'}
    assert written[2] == written[0]


def test_poses_and_rates_can_be_read_back(found, tmp_path):
    write_results(tmp_path, found, 1.0)
    assert [p.stamp_ns for p in read_tum(tmp_path / 'target_pose.tum')] == [p.stamp_ns for p in found.poses]
    assert len(read_tum(tmp_path / 'odometry.tum')) == 5
    with (tmp_path / 'rates.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {
        'stamp_ns': '5', 'omega_x_rad_s': '0.1', 'omega_y_rad_s': '0.2', 'omega_z_rad_s': '-0.3',
        'sigma_x_rad_s': '0.01', 'sigma_y_rad_s': '0.01', 'sigma_z_rad_s': '0.01', 'gate': 'accepted',
    }  # fmt: skip
    assert rows[1]['gate'] == 'rejected'


def test_same_scan_same_bytes(found, tmp_path):
    write_results(tmp_path / 'a', found, 1.0)
    write_results(tmp_path / 'b', found, 2.0)
    for name in ALL - {'summary.json'}:
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()
    a, b = read_summary(tmp_path / 'a'), read_summary(tmp_path / 'b')
    changing = {'wall_s', 'peak_rss_mb', 'timing'}
    assert {k: v for k, v in a.items() if k not in changing} == {
        k: v for k, v in b.items() if k not in changing
    }


def test_numbers_that_json_cannot_hold_become_null(found, tmp_path):
    found.rotation_period_s = float('inf')
    found.closures = [ClosureRecord(0, 1, np.float64('nan'), False, '')]
    found.symmetry = np.int64(3)
    write_results(tmp_path, found, 1.0)
    content = read_summary(tmp_path)
    assert content['rotation_period_s'] is None
    assert content['closures'][0]['probability'] is None
    assert content['symmetry'] == 3


def test_summary_comes_last_and_the_old_one_goes_first(found, tmp_path, monkeypatch):
    write_results(tmp_path, found, 1.0)
    real, order = os.fsync, []

    def record(fd):
        order.append((tmp_path / 'summary.json').exists())
        real(fd)

    monkeypatch.setattr(os, 'fsync', record)
    write_results(tmp_path, found, 1.0)
    assert order
    assert not any(order)


def test_an_interrupted_write_leaves_no_summary_and_no_fragments(found, tmp_path, monkeypatch):
    write_results(tmp_path, found, 1.0)
    calls = []

    def full(fd):
        calls.append(fd)
        if len(calls) == 3:
            raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OutputError, match='No space left'):
        write_results(tmp_path, found, 1.0)
    assert names(tmp_path) == ALL - {'summary.json'}


def test_output_folder_is_made_and_left_empty(tmp_path):
    check_output_dir(tmp_path / 'a' / 'b')
    assert names(tmp_path / 'a' / 'b') == set()


def test_output_folder_cannot_be_a_file(tmp_path):
    (tmp_path / 'file').write_text('')
    for path in (tmp_path / 'file', tmp_path / 'file' / 'below'):
        with pytest.raises(OutputError, match=f'cannot write to output folder {path}: a file is in the way'):
            check_output_dir(path)


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write anywhere')
def test_output_folder_must_be_writable(tmp_path):
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(OutputError, match='Permission denied'):
        check_output_dir(tmp_path)


def test_refused_folder_names_the_reason(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr('pathlib.Path.write_bytes', refuse)
    with pytest.raises(OutputError, match='Permission denied'):
        check_output_dir(tmp_path)


def test_used_frames_are_those_read_and_not_rejected(failed):
    failed.frames_rejected = {'lost': 4}
    assert summary(failed, 0.0)['frames'] == {'read': 5, 'used': 1, 'rejected': {'lost': 4}}


def test_closure_probabilities_are_written_where_they_are_known_and_else_removed(found, tmp_path):
    rng = np.random.default_rng(2)
    attitudes = np.array([np.eye(3)] * 4)
    histograms = rng.random((4, 180)).astype(np.float32)
    found.descriptions = Descriptions(np.arange(4, dtype=np.int64), histograms, attitudes)
    write_results(tmp_path, found, 1.0)
    assert names(tmp_path) == ALL | {'closure_probabilities.npz'}
    written = ClosureMatrices.read(tmp_path / 'closure_probabilities.npz')
    assert written.stamps_ns.tolist() == [0, 1, 2, 3]
    found.descriptions = None
    write_results(tmp_path, found, 1.0)
    assert names(tmp_path) == ALL


def test_judgement_and_report_of_an_earlier_scan_are_removed(found, tmp_path):
    for name in ('metrics.json', 'report.html'):
        (tmp_path / name).write_text('of yesterday')
    write_results(tmp_path, found, 1.0)
    assert names(tmp_path) == ALL


def test_a_forecast_can_be_read_back(found, tmp_path):
    write_results(tmp_path, found, 1.0)
    with (tmp_path / 'forecast.csv').open() as file:
        rows = list(csv.DictReader(file))
    forecast = found.forecast
    assert [int(row['stamp_ns']) for row in rows] == forecast.stamps_ns
    for row, T, *values in zip(
        rows,
        forecast.poses,
        forecast.rates,
        forecast.position_sigma,
        forecast.attitude_sigma,
        forecast.rate_sigma,
        strict=True,
    ):
        assert [float(row[f't{a}']) for a in 'xyz'] == pytest.approx(T[:3, 3])
        quaternion = np.array([float(row[f'q{a}']) for a in 'xyzw'])
        np.testing.assert_allclose(from_quaternion(quaternion), T[:3, :3], atol=1e-7)
        for name, value in zip(
            ('omega_{}_rad_s', 'sigma_position_{}_m', 'sigma_attitude_{}_rad', 'sigma_omega_{}_rad_s'),
            values,
            strict=True,
        ):
            assert [float(row[name.format(a)]) for a in 'xyz'] == pytest.approx(value)
