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
import errno
import json
import os
import shutil
import signal
import stat
import sys
import time

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, Model, Texture
from debris_scanner.core.geometry import exp_se3, exp_so3, from_quaternion, transform
from debris_scanner.core.results import (
    NO_CLOSURE,
    Check,
    ClosureRecord,
    Descriptions,
    Forecast,
    GraphEdge,
    RateSample,
    StampedPose,
    at_least,
    at_most,
)
from debris_scanner.io.result_files import (
    OutputError,
    ScanResult,
    check_output_dir,
    claim,
    complete,
    newest_since,
    summaries,
    summary,
    write_results,
)
from debris_scanner.io.trajectories import read_tum
from debris_scanner.mapping.closure_matrices import ClosureMatrices

ALL = {
    'model.pcd', 'model.ply', 'mesh.ply', 'mesh.vtk', 'target_pose.tum', 'odometry.tum', 'rates.csv',
    'forecast.csv', 'graph.g2o', 'summary.json',
}  # fmt: skip
T_FROM_TO = transform(exp_so3(np.array([0, 0, np.pi / 2])), np.array([0.1, -0.2, 0.03]))
CHECKS = (at_least('overlap', 0.8, 0.4), Check('correction_deg', 3.5))
OF_THE_MODEL = {'model.pcd', 'model.ply', 'mesh.ply', 'mesh.vtk', 'forecast.csv'}


@pytest.fixture
def found():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(20, 3)).astype(np.float32)
    model = Model(points, points.copy(), points[:3], np.array([[0, 1, 2]], np.int32))
    poses = [StampedPose(k * 100_000_000, exp_se3(rng.normal(size=6))) for k in range(8)]
    return ScanResult(
        reason=None,
        checks=(at_most('gain', 0.1, 0.15),),
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
            ClosureRecord(0, 600_000_000, 0.91, True, 'overlap 0.8', T_FROM_TO, CHECKS),
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


def contents(directory):
    """The bytes of each file that is no folder, nor hidden."""
    return {p.name: p.read_bytes() for p in directory.iterdir() if p.is_file() and p.name[0] != '.'}


def read_summary(directory):
    return json.loads((directory / 'summary.json').read_text())


def test_writes_every_file_of_the_contract_and_nothing_else(found, tmp_path):
    write_results(tmp_path / 'deep' / 'out', found, 12.3456)
    assert names(tmp_path / 'deep' / 'out') == ALL


def test_summary_has_exactly_the_contracted_keys(found, tmp_path):
    write_results(tmp_path, found, 12.3456)
    content = read_summary(tmp_path)
    assert list(content) == [
        'result', 'reason', 'checks', 'frames', 'keyframes', 'closures', 'rotation_period_s',
        'rotation_axis_sensor', 'symmetry', 'sensor', 'model', 'coverage', 'mass_properties', 'errors',
        'timing', 'wall_s', 'peak_rss_mb', 'versions',
    ]  # fmt: skip
    assert content['result'] == 'model'
    assert content['reason'] is None
    assert content['frames'] == {'read': 11, 'used': 8, 'rejected': {'no_target': 2, 'too_few_points': 1}}
    assert content['checks'] == [{'name': 'gain', 'value': 0.1, 'bound': 0.15, 'passed': True}]
    assert content['keyframes'] == 4
    assert content['closures'] == [
        {
            'from_stamp_ns': 0,
            'to_stamp_ns': 600_000_000,
            'T_from_to': pytest.approx([0.1, -0.2, 0.03, 0, 0, np.sqrt(0.5), np.sqrt(0.5)]),
            'probability': 0.91,
            'accepted': True,
            'why': 'overlap 0.8',
            'checks': [
                {'name': 'overlap', 'value': 0.8, 'bound': 0.4, 'passed': True},
                {'name': 'correction_deg', 'value': 3.5, 'bound': None, 'passed': True},
            ],
        },
        {
            'from_stamp_ns': 0,
            'to_stamp_ns': 200_000_000,
            'T_from_to': None,
            'probability': 0.31,
            'accepted': False,
            'why': 'the views do not overlap',
            'checks': [],
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


def test_a_scan_without_a_model_leaves_that_of_an_earlier_one(found, failed, tmp_path):
    (tmp_path / 'notes.txt').write_text('mine')
    assert write_results(tmp_path, found, 1.0) == tmp_path
    (tmp_path / 'metrics.json').write_text('of its model')
    before = contents(tmp_path)
    assert write_results(tmp_path, failed, 1.0) == tmp_path / 'no_model'
    assert contents(tmp_path) == before
    assert names(tmp_path / 'no_model') == ALL - OF_THE_MODEL
    (tmp_path / 'summary.json').unlink()  # cut short by an older release, or the user's own mesh
    assert write_results(tmp_path, failed, 1.0) == tmp_path / 'no_model'


def test_a_model_that_its_own_scan_gives_up_does_not_stay(found, failed, tmp_path):
    (tmp_path / 'notes.txt').write_text('mine')
    write_results(tmp_path, found, 1.0)
    assert write_results(tmp_path, failed, 1.0, owned=True) == tmp_path
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


def test_nothing_changes_before_all_is_written_and_the_summary_is_first(found, tmp_path, monkeypatch):
    write_results(tmp_path, found, 1.0)
    before, real, written = contents(tmp_path), os.fsync, []

    def record(fd):
        if stat.S_ISREG(os.fstat(fd).st_mode):
            written.append(contents(tmp_path) == before)
            if len(written) == 2:
                assert 'summary.json' in names(tmp_path / '.saving')
        real(fd)

    monkeypatch.setattr(os, 'fsync', record)
    write_results(tmp_path, found, 2.0)
    assert len(written) > len(ALL) and all(written)


class Faults:
    """In a child process: has the step number ``at`` of those that change a folder fail, or be the last."""

    def __init__(self, folder, at, how):
        self.folder, self.at, self.how, self.count = str(folder), at, how, 0
        os.fsync = lambda fd: self.step()
        sys.addaudithook(self.audit)

    def audit(self, event, args):
        moves = event in ('os.rename', 'os.remove', 'os.rmdir')
        if (moves or event in ('open', 'os.mkdir')) and str(args[0]).startswith(f'{self.folder}/'):
            self.step(moves)

    def step(self, without_space=False):
        self.count += 1
        if self.how == 'killed' and self.count == self.at:
            os._exit(ENDS.index('killed'))
        failing = self.count == self.at if self.how == 'one fails' else self.count >= self.at
        if failing and not (self.how == 'full' and without_space):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


ENDS = ('undisturbed', 'saved all the same', 'not saved', 'killed')


def in_a_child(task):
    """What a process that does this comes to: its result, or 'not saved', or 'killed'."""
    pid = os.fork()
    if pid == 0:
        code = 5
        try:
            code = ENDS.index(task())
        except OutputError:
            code = ENDS.index('not saved')
        finally:
            os._exit(code)
    return ENDS[os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])]


@pytest.mark.parametrize('how', ['killed', 'full', 'one fails'])
def test_at_each_step_of_saving_the_old_result_is_whole_or_the_new(found, tmp_path, monkeypatch, how):
    monkeypatch.setattr('debris_scanner.io.result_files._peak_rss_mb', lambda: 0.0)
    monkeypatch.setattr('debris_scanner.io.result_files._versions', dict)  # which takes its time
    later = dataclasses.replace(found, poses=found.poses[:3], forecast=None, frames_read=12)
    write_results(tmp_path / 'later', later, 2.0)
    new = contents(tmp_path / 'later') | {'notes.txt': b'mine'}
    write_results(tmp_path / 'earlier', found, 1.0)
    (tmp_path / 'earlier' / 'notes.txt').write_text('mine')
    (tmp_path / 'earlier' / 'metrics.json').write_text('of the earlier scan')
    old, seen = contents(tmp_path / 'earlier'), []
    monkeypatch.setattr(os, 'fsync', lambda fd: None)
    end, at = '', 0
    while end != 'undisturbed':
        at += 1
        folder = tmp_path / str(at)
        shutil.copytree(tmp_path / 'earlier', folder)

        def save(folder=folder, at=at):
            faults = Faults(folder, at, how)
            write_results(folder, later, 2.0)
            return ENDS[faults.count >= at]

        end = in_a_child(save)
        half = contents(folder)
        assert half in (old, new) or 'summary.json' not in half, 'whoever does not ask sees no mixture'
        complete(folder)
        assert contents(folder) in (old, new)
        seen.append((end, contents(folder) == new))
        assert seen[-1] not in (('undisturbed', False), ('saved all the same', False))
        write_results(folder, later, 2.0)
        assert contents(folder) == new
        assert not [n for n in names(folder) if n.startswith('.')]
    ended = 'killed' if how == 'killed' else 'not saved'
    assert seen.count((ended, False)) > 2 * len(ALL)
    assert seen.count((ended, True)) > len(ALL) or how == 'full'


def test_a_full_disk_names_the_folder_and_says_that_the_earlier_result_is_there(found, tmp_path, monkeypatch):
    def full(fd):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    write_results(tmp_path, found, 1.0)
    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OutputError) as raised:
        write_results(tmp_path, found, 1.0)
    assert str(raised.value) == (
        f'cannot write to {tmp_path}: No space left on device; the earlier result there is as it was'
    )
    assert names(tmp_path) == ALL


def test_a_folder_in_the_way_of_a_file_is_told_before_anything_is_changed(found, tmp_path):
    (tmp_path / 'model.ply').mkdir()
    with pytest.raises(OutputError, match='Is a directory'):
        write_results(tmp_path, found, 1.0)
    assert names(tmp_path) == {'model.ply'}


def test_a_second_scan_into_a_folder_is_refused(found, tmp_path):
    def hold():
        with claim(tmp_path / 'out'):
            os.write(ready, b'x')
            time.sleep(60)

    is_ready, ready = os.pipe()
    write_results(tmp_path / 'out', found, 1.0)
    before = contents(tmp_path / 'out')
    if (pid := os.fork()) == 0:
        try:
            hold()
        finally:
            os._exit(0)
    os.read(is_ready, 1)
    try:
        complete(tmp_path / 'out')  # reading does not wait for it
        with pytest.raises(OutputError) as raised:
            write_results(tmp_path / 'out', found, 2.0)
        assert str(raised.value) == (
            f'another scan (process {pid}) writes to {tmp_path / "out"}: '
            'wait for it, end it, or give another folder'
        )
        assert contents(tmp_path / 'out') == before
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(is_ready)
        os.close(ready)
    write_results(tmp_path / 'out', found, 2.0)


def test_the_newest_result_is_found_wherever_it_was_saved(found, failed, tmp_path):
    before = summaries(tmp_path)
    assert newest_since(tmp_path, before) is None
    for result, folder in ((found, tmp_path), (failed, tmp_path / 'no_model'), (found, tmp_path)):
        time.sleep(0.01)  # the clock of a file system is coarse
        assert write_results(tmp_path, result, 1.0) == folder
        assert newest_since(tmp_path, before) == folder
        before = summaries(tmp_path)
        assert newest_since(tmp_path, before) is None


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
    def refuse(**_):
        raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr('tempfile.TemporaryFile', refuse)
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
