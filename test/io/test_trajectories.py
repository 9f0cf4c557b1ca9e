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

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from debris_scanner.core.geometry import exp_se3, exp_so3, inverse, transform
from debris_scanner.core.results import GraphEdge, StampedPose
from debris_scanner.io.trajectories import TrajectoryFileError, read_tum, write_g2o, write_tum

LINE = '1.5 1 2 3 0 0 0 1'


def random_poses(stamps):
    rng = np.random.default_rng(0)
    return [StampedPose(s, transform(exp_so3(rng.normal(size=3)), rng.normal(size=3))) for s in stamps]


def test_round_trip_keeps_every_nanosecond(tmp_path):
    # as doubles of seconds these would lose their last digits
    stamps = [0, 1, 1_000_000_000, 1_763_725_887_123_456_789, 1_763_725_887_123_456_790]
    poses = random_poses(stamps)
    write_tum(tmp_path / 'a.tum', poses)
    back = read_tum(tmp_path / 'a.tum')
    assert [p.stamp_ns for p in back] == stamps
    for a, b in zip(poses, back, strict=True):
        np.testing.assert_allclose(a.T_sensor_target, b.T_sensor_target, atol=1e-8)
    assert [p.name for p in tmp_path.iterdir()] == ['a.tum']


def test_the_line_is_seconds_position_and_scalar_last_quaternion(tmp_path):
    turned = transform(exp_so3(np.array([0, 0, np.pi / 2])), np.array([0.1, -0.2, 0.8]))
    write_tum(tmp_path / 'a.tum', [StampedPose(2_000_000_003, turned)])
    words = (tmp_path / 'a.tum').read_text().split()
    assert words[0] == '2.000000003'
    np.testing.assert_allclose(
        [float(w) for w in words[1:]], [0.1, -0.2, 0.8, 0, 0, 0.5**0.5, 0.5**0.5], atol=1e-9
    )


def test_comments_blank_lines_and_other_writers_numbers_are_read(tmp_path):
    path = tmp_path / 'a.tum'
    path.write_text('# t tx ty tz qx qy qz qw\n\n1.5e0 1 2 3 0 0 0 1.0001\n  2  0 0 0 0 0 0 -1\n')
    poses = read_tum(path)
    assert [p.stamp_ns for p in poses] == [1_500_000_000, 2_000_000_000]
    np.testing.assert_allclose(poses[0].T_sensor_target[:3, 3], [1, 2, 3])
    for pose in poses:
        np.testing.assert_allclose(pose.T_sensor_target[:3, :3], np.eye(3), atol=1e-12)


def test_an_empty_file_has_no_poses(tmp_path):
    write_tum(tmp_path / 'a.tum', [])
    assert read_tum(tmp_path / 'a.tum') == []


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('1.5 1 2 3 0 0 0', 'expected 8 numbers, found 7'),
        ('one 1 2 3 0 0 0 1', 'line 2'),
        ('nan 1 2 3 0 0 0 1', 'whole number of nanoseconds'),
        ('1.0000000001 1 2 3 0 0 0 1', 'whole number of nanoseconds'),
        ('1.5 1 2 x 0 0 0 1', "'x'"),
        ('1.5 1 2 inf 0 0 0 1', 'finite'),
        ('1.5 1 2 3 0 0 0 0', 'unit length'),
    ],
)
def test_bad_lines_are_named(tmp_path, line, message):
    (tmp_path / 'a.tum').write_text(f'{LINE}\n{line}\n')
    with pytest.raises(TrajectoryFileError, match=message) as caught:
        read_tum(tmp_path / 'a.tum')
    assert 'a.tum, line 2' in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(TrajectoryFileError, match=r'none\.tum'):
        read_tum(tmp_path / 'none.tum')


@pytest.fixture
def graph():
    rng = np.random.default_rng(0)
    poses = [StampedPose(10**18 + k, exp_se3(rng.normal(size=6))) for k in range(4)]
    edges = []
    for i, j in ((0, 1), (1, 2), (2, 3), (0, 3)):
        A = rng.normal(size=(6, 6))
        T_i_j = poses[i].T_sensor_target @ inverse(poses[j].T_sensor_target)
        edges.append(GraphEdge(i, j, T_i_j, A @ A.T))
    return poses, edges


def pose_of(numbers):
    T = np.eye(4)
    T[:3, 3] = numbers[:3]
    T[:3, :3] = Rotation.from_quat(numbers[3:7]).as_matrix()
    return T


def read(path):
    """Vertices by id and edges (i, j, T, information) as g2o reads them."""
    vertices, edges = {}, []
    for line in path.read_text().splitlines():
        tag, *words = line.split()
        if tag == 'VERTEX_SE3:QUAT':
            assert len(words) == 8
            vertices[int(words[0])] = pose_of([float(w) for w in words[1:]])
        elif tag == 'EDGE_SE3:QUAT':
            assert len(words) == 2 + 7 + 21
            numbers = [float(w) for w in words[2:]]
            information = np.zeros((6, 6))
            entries = iter(numbers[7:])
            for row in range(6):
                for column in range(row, 6):
                    information[row, column] = information[column, row] = next(entries)
            edges.append((int(words[0]), int(words[1]), pose_of(numbers), information))
        else:
            assert tag.startswith('#')
    return vertices, edges


def test_vertices_hold_the_sensor_in_the_target_frame(graph, tmp_path):
    poses, _ = graph
    write_g2o(tmp_path / 'graph.g2o', *graph)
    vertices, _ = read(tmp_path / 'graph.g2o')
    assert list(vertices) == [0, 1, 2, 3]
    for k, T in vertices.items():
        np.testing.assert_allclose(T @ poses[k].T_sensor_target, np.eye(4), atol=1e-8)


def test_edges_agree_with_the_vertices_as_g2o_composes_them(graph, tmp_path):
    write_g2o(tmp_path / 'graph.g2o', *graph)
    vertices, edges = read(tmp_path / 'graph.g2o')
    assert [(i, j) for i, j, _, _ in edges] == [(0, 1), (1, 2), (2, 3), (0, 3)]
    for i, j, T_i_j, _ in edges:
        np.testing.assert_allclose(inverse(vertices[i]) @ vertices[j], T_i_j, atol=1e-7)


def test_information_weighs_the_same_error_the_same(graph, tmp_path):
    _, given = graph
    write_g2o(tmp_path / 'graph.g2o', *graph)
    _, edges = read(tmp_path / 'graph.g2o')
    twist = np.array([1e-3, -2e-3, 5e-4, 2e-3, 1e-3, -3e-3])  # metres, radians
    # g2o takes the vector part of the error's quaternion.
    g2o_error = np.concatenate([twist[:3], Rotation.from_rotvec(twist[3:]).as_quat()[:3]])
    for edge, (_, _, _, information) in zip(given, edges, strict=True):
        assert g2o_error @ information @ g2o_error == pytest.approx(
            twist @ edge.information @ twist, rel=1e-4
        )


def test_stamps_stand_in_comments(graph, tmp_path):
    write_g2o(tmp_path / 'graph.g2o', *graph)
    assert '# vertex 2 stamp_ns 1000000000000000002' in (tmp_path / 'graph.g2o').read_text().splitlines()


def test_no_key_frames_give_a_readable_file(tmp_path):
    write_g2o(tmp_path / 'graph.g2o', [], [])
    assert read(tmp_path / 'graph.g2o') == ({}, [])


def test_refuses_edges_that_do_not_fit(graph, tmp_path):
    poses, edges = graph
    with pytest.raises(ValueError, match='names no vertex'):
        write_g2o(tmp_path / 'graph.g2o', poses[:3], edges)
    flat = GraphEdge(0, 1, np.eye(4), np.ones(6))
    with pytest.raises(ValueError, match='information of edge 0-1'):
        write_g2o(tmp_path / 'graph.g2o', poses, [flat])
    assert list(tmp_path.iterdir()) == []
