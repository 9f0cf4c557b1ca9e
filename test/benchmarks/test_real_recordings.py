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

"""Real recordings: their frames and truth in the product's axes, and what a person expects of them."""

from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from benchmarks.real_recordings import REAL, all_points, depth_folder, kinect2_clouds, range_grids
from benchmarks.scorecard.cases import QUICK, all_cases
from benchmarks.scorecard.document import scorecard
from benchmarks.scorecard.outcome import ERROR, FALSE_REJECT, RIGHT, WRONG_MODEL, WRONG_REASON, score
from benchmarks.scorecard.run_case import turned
from benchmarks.scorecard.tables import real_table
from debris_scanner.core.geometry import apply, compose, exp_so3, inverse, to_quaternion, transform
from debris_scanner.io.mesh_files import write_mesh_ply

CASES = {c.target.name: c for c in all_cases() if c.target.name in REAL}


def said(reason=None, hint='', **more):
    scan = {'reason': reason, 'why': 'numbers', 'hint': hint, 'frames': {'used': 9, 'read': 10}}
    return {'scan': scan, 'metrics': None, 'turned': {'deg': 83.5, 'true_deg': 90.0}, **more}


def about_y(degrees):
    return exp_so3(np.array([0.0, np.radians(degrees), 0.0]))


def test_every_one_is_among_the_quick_cases():
    assert {c.name for c in CASES.values()} <= set(QUICK)
    assert len(CASES) == len(REAL) >= 14


def test_a_laser_s_grids_lie_where_the_truth_has_them(tmp_path):
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(4000, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1, keepdims=True)
    ball[:, 0] += 0.05
    truth = [transform(about_y(-24.0 * k), np.array([0.01, 0.0, 0.02])) for k in range(2)]
    grids = {f'points_{24 * k:03}': apply(inverse(T), ball).reshape(40, 100, 3) for k, T in enumerate(truth)}
    poses = [[*T[:3, 3], *to_quaternion(T[:3, :3].T)] for T in truth]
    np.savez(tmp_path / 'range_grids.npz', truth_txyz_qxyzw=poses, **grids)
    found = list(range_grids(tmp_path))
    assert len(found) == 2 and found[0][0].stamp_ns < found[1][0].stamp_ns
    posed = ((frame, inverse(T)) for frame, T in found)
    radius = np.linalg.norm(all_points(posed) - [0.05, 0, 0], axis=1)
    assert np.median(np.abs(radius - 0.1)) < 0.002
    for frame, T_sensor_target in found:
        points = frame.camera.back_project(frame.depth)[frame.depth > 0]
        assert points[:, 2].min() > 0.5
        radius = np.linalg.norm(apply(inverse(T_sensor_target), points) - [0.05, 0, 0], axis=1)
        assert np.median(np.abs(radius - 0.1)) < 0.002


def test_clouds_of_a_board_come_in_the_order_of_its_turn(tmp_path):
    for name, degrees in (('L_toy001', 10.0), ('L_toy000', 5.0), ('R_toy000', -5.0), ('R_toy001', -10.0)):
        vertices = np.array([[-0.1, 0.2, 0.8], [0.1, 0.2, 0.8], [0.0, -0.2, 0.8], [0.0, 0.0, 0.7]])
        write_mesh_ply(tmp_path / f'{name}.ply', vertices.astype(np.float32), np.array([[0, 1, 2]], np.int32))
        T = transform(about_y(degrees), np.array([0.1, 0.2, 0.9]))
        (tmp_path / f'{name}_extrinsic.txt').write_text('\n'.join(str(x) for x in T.ravel()))
    (tmp_path / 'L_gtpose.txt').write_text('')
    poses = [T for _, T in kinect2_clouds(tmp_path)]
    steps = [np.degrees(np.arccos((np.trace(b[:3, :3] @ a[:3, :3].T) - 1) / 2)) for a, b in pairwise(poses)]
    np.testing.assert_allclose(steps, [5, 10, 5], atol=1e-6)
    np.testing.assert_allclose(poses[0][:3, 3], [-0.1, -0.2, 0.9])
    assert turned(dict(enumerate(poses)), {}) == {'deg': pytest.approx(20.0), 'true_deg': None}


def test_what_is_not_decoded_is_read_as_millimetres(tmp_path):
    for folder, name, value in (
        ('depth', 'frame-000000.png', 380),
        ('raw', 'frame-000000.depth.png', 30_000),
    ):
        (tmp_path / folder).mkdir()
        Image.fromarray(np.full((4, 5), value, np.uint16)).save(tmp_path / folder / name)
    (tmp_path / 'Intrinsic.txt').write_text('500 0 2 0 500 2 0 0 1')
    assert next(depth_folder(tmp_path))[0].depth.max() == pytest.approx(0.38)
    assert next(depth_folder(tmp_path, undecoded=True))[0].depth.max() == pytest.approx(30)


@pytest.mark.parametrize(
    ('name', 'record', 'outcome'),
    [
        ('custard_box', said(), RIGHT),
        ('custard_box', said('no_closure'), RIGHT),
        ('custard_box', said('no_target'), FALSE_REJECT),
        ('tiger', said(), WRONG_MODEL),
        ('apc_undecoded', said('no_target', 'its median is 30 m away'), RIGHT),
        ('apc_undecoded', said('no_target'), WRONG_REASON),
        ('realsense_sdk', {'error': 'Traceback\nno camera_info; its topics: a'}, RIGHT),
        ('realsense_sdk', {'error': 'Traceback\nKeyError: 3'}, ERROR),
        ('tiger', {'error': 'Traceback\nKeyError: 3'}, ERROR),
    ],
)
def test_an_outcome_is_what_a_person_expects(name, record, outcome):
    assert score(CASES[name], record).outcome == outcome


def test_the_table_has_what_is_expected_and_how_far_odometry_turned():
    rows = [score(CASES['tiger'], said('no_closure')), score(CASES['custard_box'], said('no_target'))]
    table = real_table(rows)
    assert '| tiger | Kinect v2 | no full turn: 90° | right |' in table
    assert '83.5 | 90.0 | -7.2 |' in table
    text = scorecard(rows, 'a command')
    assert table in text and 'Not at hand: apc_box_shelf,' in text


def test_sums_of_steps_are_those_of_a_whole_turn():
    poses = {k: transform(about_y(10.0 * k), np.zeros(3)) for k in range(37)}
    short = {k: compose(T, transform(about_y(-0.5 * k), np.zeros(3))) for k, T in poses.items()}
    found = turned(short, poses)
    assert found == {'deg': pytest.approx(342.0), 'true_deg': pytest.approx(360.0)}
