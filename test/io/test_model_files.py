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

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.frames import Model
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.model_files import cloud_pcd, cloud_ply, mesh_ply, mesh_vtk, vertex_normals

VERTICES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32) * 0.1
TRIANGLES = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], np.int32
)


@pytest.fixture
def model():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3)).astype(np.float32)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    rgb = rng.integers(0, 256, (50, 3), dtype=np.uint8)
    rgb[0] = 255, 128, 0  # alpha 255 with red above 127 is a NaN to who mistakes it for a float
    return Model(points, normals, VERTICES, TRIANGLES, rgb)


@pytest.fixture(scope='module')
def o3d():
    return load_open3d()


def without_colour(model):
    return dataclasses.replace(model, rgb=None)


def split(content, end):
    header, body = content.split(end, 1)
    return header.decode().splitlines(), body


def test_vertex_normals_point_outwards():
    normals = vertex_normals(VERTICES, TRIANGLES)
    np.testing.assert_allclose(normals, VERTICES / 0.1, atol=1e-6)


def test_vertex_without_triangle_has_no_normal():
    vertices = np.vstack([VERTICES, [[5, 5, 5]]]).astype(np.float32)
    assert vertex_normals(vertices, TRIANGLES)[-1].tolist() == [0.0, 0.0, 0.0]


def test_pcd_with_colour_is_xyzrgba(model):
    header, body = split(cloud_pcd(model), b'DATA binary\n')
    assert 'FIELDS x y z rgba normal_x normal_y normal_z' in header
    assert 'TYPE F F F U F F F' in header
    assert 'POINTS 50' in header
    table = np.frombuffer(body, [('xyz', '<f4', 3), ('rgba', '<u4'), ('n', '<f4', 3)])
    np.testing.assert_array_equal(table['xyz'], model.points)
    np.testing.assert_array_equal(table['n'], model.normals)
    assert table['rgba'][0] == 0xFFFF8000
    np.testing.assert_array_equal((table['rgba'] >> 16) & 255, model.rgb[:, 0])


def test_pcd_without_colour_has_normals(model):
    header, body = split(cloud_pcd(without_colour(model)), b'DATA binary\n')
    assert 'FIELDS x y z normal_x normal_y normal_z' in header
    table = np.frombuffer(body, '<f4').reshape(50, 6)
    np.testing.assert_array_equal(table, np.hstack([model.points, model.normals]))


@pytest.mark.parametrize(('encode', 'name'), [(cloud_pcd, 'm.pcd'), (cloud_ply, 'm.ply')])
@pytest.mark.parametrize('coloured', [True, False])
def test_open3d_reads_the_cloud(model, o3d, tmp_path, encode, name, coloured):
    given = model if coloured else without_colour(model)
    (tmp_path / name).write_bytes(encode(given))
    cloud = o3d.io.read_point_cloud(str(tmp_path / name))
    np.testing.assert_allclose(np.asarray(cloud.points), model.points, atol=1e-7)
    np.testing.assert_allclose(np.asarray(cloud.normals), model.normals, atol=1e-6)
    assert cloud.has_colors() == coloured
    if coloured:
        np.testing.assert_allclose(np.asarray(cloud.colors) * 255, model.rgb, atol=0.01)


def test_open3d_reads_the_mesh(model, o3d, tmp_path):
    (tmp_path / 'm.ply').write_bytes(mesh_ply(model))
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / 'm.ply'))
    np.testing.assert_allclose(np.asarray(mesh.vertices), VERTICES, atol=1e-7)
    np.testing.assert_array_equal(np.asarray(mesh.triangles), TRIANGLES)
    assert (np.einsum('ij,ij->i', np.asarray(mesh.vertex_normals), VERTICES) > 0).all()
    assert mesh.get_volume() == pytest.approx(4 / 3 * 0.1**3, rel=1e-5)


def test_vtk_is_big_endian_polygon_data(model):
    lines, body = split(mesh_vtk(model), b'POINTS 6 float\n')
    assert lines[0] == '# vtk DataFile Version 3.0'
    assert lines[2:] == ['BINARY', 'DATASET POLYDATA']
    np.testing.assert_array_equal(np.frombuffer(body[:72], '>f4').reshape(6, 3), VERTICES)
    keyword = b'\nPOLYGONS 8 32\n'
    assert body[72:].startswith(keyword)
    polygons = body[72 + len(keyword) :]
    table = np.frombuffer(polygons[:128], '>i4').reshape(8, 4)
    assert (table[:, 0] == 3).all()
    np.testing.assert_array_equal(table[:, 1:], TRIANGLES)
    keyword = b'\nPOINT_DATA 6\nNORMALS normals float\n'
    assert polygons[128:].startswith(keyword)
    normals = np.frombuffer(polygons[128 + len(keyword) : -1], '>f4').reshape(6, 3)
    np.testing.assert_allclose(normals, VERTICES / 0.1, atol=1e-6)


def test_same_model_same_bytes(model):
    for encode in (cloud_pcd, cloud_ply, mesh_ply, mesh_vtk):
        assert encode(model) == encode(model)


def test_empty_mesh_gives_valid_headers(model):
    bare = dataclasses.replace(
        model, vertices=np.zeros((0, 3), np.float32), triangles=np.zeros((0, 3), np.int32)
    )
    assert b'element face 0\n' in mesh_ply(bare)
    assert b'POLYGONS 0 0\n' in mesh_vtk(bare)
