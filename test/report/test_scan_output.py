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

"""What a scan wrote comes back as it was."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import exp_so3, inverse, transform
from debris_scanner.core.results import (
    NO_CLOSURE,
    ClosureRecord,
    Descriptions,
    GraphEdge,
    RateSample,
    StampedPose,
)
from debris_scanner.io.result_files import ScanResult, write_results
from debris_scanner.report.scan_output import ScanOutputError, read_scan

START = 1_700_000_000_000_000_123
T_FROM_TO = transform(exp_so3([0.1, 0.2, 0.3]), np.array([0.3, 0.2, 0.1]))


def pose(k, per_step=0.3):
    """T_sensor_target of a target that turns about y."""
    return StampedPose(
        START + k * 10**8, transform(exp_so3([0.0, k * per_step, 0.0]), np.array([0.0, 0.0, 0.8]))
    )


@pytest.fixture
def result():
    rng = np.random.default_rng(0)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    points = rng.random((9, 3)).astype(np.float32)
    rgb = rng.integers(0, 256, (9, 3)).astype(np.uint8)
    poses = [pose(k) for k in range(25)]
    return ScanResult(
        None,
        Model(points, points, corners, faces, rgb),
        poses=poses,
        odometry=poses[:-1],
        rates=[
            RateSample(p.stamp_ns, np.array([0, 0.3, k]), np.full(3, 0.1), k != 3)
            for k, p in enumerate(poses)
        ],
        keyframe_poses=poses[::2],
        edges=[GraphEdge(0, 1, np.eye(4), np.eye(6)), GraphEdge(0, 12, np.eye(4), np.eye(6))],
        closures=[
            ClosureRecord(poses[0].stamp_ns, poses[22].stamp_ns, 0.7, False, 'overlap 0.5 not >= 0.72'),
            ClosureRecord(poses[0].stamp_ns, poses[20].stamp_ns, 0.8, True, 'overlap 0.9'),
            ClosureRecord(poses[2].stamp_ns, poses[22].stamp_ns, 0.9, True, 'overlap 0.8', T_FROM_TO),
        ],
        frames_read=25,
        descriptions=Descriptions(
            np.array([p.stamp_ns for p in poses[::2]], dtype=np.int64),
            rng.random((13, 180)).astype(np.float32),
            np.array([p.T_sensor_target[:3, :3].T for p in poses[::2]]),
        ),
    )


def test_everything_comes_back(result, tmp_path):
    write_results(tmp_path / 'scan', result, 1.0)
    scan = read_scan(tmp_path / 'scan')
    assert scan.name == 'scan'
    assert scan.start_ns == START
    assert scan.metrics is None
    assert scan.rates.stamps_ns.tolist() == [p.stamp_ns for p in result.poses]
    np.testing.assert_allclose(scan.rates.omega, [r.omega for r in result.rates])
    np.testing.assert_allclose(scan.rates.sigma, 0.1)
    assert np.flatnonzero(~scan.rates.accepted).tolist() == [3]
    assert (len(scan.poses), len(scan.odometry)) == (25, 24)
    np.testing.assert_allclose(
        scan.keyframes.T_target_sensor, [inverse(p.T_sensor_target) for p in result.keyframe_poses], atol=1e-8
    )
    assert scan.keyframes.stamps_ns.tolist() == [p.stamp_ns for p in result.keyframe_poses]
    assert scan.keyframes.edges.tolist() == [[0, 1], [0, 12]]
    assert scan.closures == result.closures
    assert scan.closures[0].T_from_to is None
    np.testing.assert_allclose(scan.closures[2].T_from_to, T_FROM_TO, atol=1e-15)
    assert scan.matrices.stamps_ns.tolist() == scan.keyframes.stamps_ns.tolist()
    assert scan.surface.triangles.shape == (4, 3)
    np.testing.assert_allclose(scan.surface.points, result.model.points, rtol=1e-6)
    np.testing.assert_allclose(scan.surface.rgb * 255, result.model.rgb, atol=0.01)


def test_the_closed_mesh_takes_the_place_of_what_was_seen(result, tmp_path):
    model = result.model
    rgb = np.full((4, 3), 9, np.uint8)
    observed = np.array([True, False, True, True])
    for colours in (None, rgb):
        closed = ClosedMesh(2 * model.vertices, model.triangles, observed, colours)
        result.model = dataclasses.replace(model, closed=closed)
        write_results(tmp_path, result, 1.0)
        surface = read_scan(tmp_path).surface
        np.testing.assert_allclose(surface.vertices, closed.vertices)
        assert surface.triangles.tolist() == closed.triangles.tolist()
        assert surface.observed.tolist() == observed.tolist()
        assert surface.coarse.observed.tolist() == observed.tolist()


def test_without_a_closed_mesh_nothing_is_said_of_what_was_seen(result, tmp_path):
    write_results(tmp_path, result, 1.0)
    surface = read_scan(tmp_path).surface
    assert surface.observed is None
    assert surface.coarse.observed.all()


@pytest.mark.parametrize(
    ('damage', 'said'),
    [
        (lambda data: data[:-3], 'is cut short'),
        (lambda data: data.replace(b'property uchar observed\n', b''), 'is not a closed mesh'),
        (lambda data: b'ply', 'is not a closed mesh'),
        (lambda data: data[:-5] + b'\x7f' + data[-4:], 'broken vertices or indices'),
    ],
)
def test_a_damaged_closed_mesh_is_named(result, tmp_path, damage, said):
    closed = ClosedMesh(result.model.vertices, result.model.triangles, np.ones(4, bool))
    result.model = dataclasses.replace(result.model, closed=closed)
    write_results(tmp_path, result, 1.0)
    path = tmp_path / 'mesh_closed.ply'
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ScanOutputError, match=f'mesh_closed.ply.*{said}'):
        read_scan(tmp_path)


def test_the_turn_is_that_of_the_odometry(result, tmp_path):
    result.odometry = [pose(k, 0.15) for k in range(25)]
    write_results(tmp_path, result, 1.0)
    assert read_scan(tmp_path).turn_shown == pytest.approx(24 * 0.15, abs=1e-6)


def test_path_is_the_rotation_travelled_also_beyond_a_turn(result, tmp_path):
    write_results(tmp_path, result, 1.0)
    scan = read_scan(tmp_path)
    np.testing.assert_allclose(scan.keyframes.path_rad, 0.6 * np.arange(13), atol=1e-6)
    np.testing.assert_allclose(scan.seconds(scan.keyframes.stamps_ns), 0.2 * np.arange(13), atol=1e-9)


def test_first_closure_is_the_earliest_accepted(result, tmp_path):
    write_results(tmp_path, result, 1.0)
    assert read_scan(tmp_path).first_closure == result.closures[1]


def test_empty_scan_is_read_too(tmp_path):
    write_results(tmp_path, ScanResult(NO_CLOSURE, None), 1.0)
    scan = read_scan(tmp_path)
    assert scan.start_ns == 0
    assert scan.first_closure is scan.surface is scan.matrices is scan.turn_shown is None
    assert scan.keyframes.path_rad.shape == (0,)
    assert scan.rates.omega.shape == (0, 3)


def test_probability_that_json_could_not_hold(result, tmp_path):
    result.closures = [ClosureRecord(START, START + 10**8, float('nan'), False, '')]
    write_results(tmp_path, result, 1.0)
    assert np.isnan(read_scan(tmp_path).closures[0].probability)


def test_edge_without_a_vertex_is_refused(result, tmp_path):
    write_results(tmp_path, result, 1.0)
    path = tmp_path / 'graph.g2o'
    path.write_text(path.read_text().replace('EDGE_SE3:QUAT 0 12', 'EDGE_SE3:QUAT 0 13'))
    with pytest.raises(ScanOutputError, match=r'graph\.g2o: an edge names no vertex'):
        read_scan(tmp_path)
