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

"""Meshes are read, written and thinned."""

import numpy as np
import pytest

from debris_scanner.io.mesh_files import MeshFileError, decimated, read_mesh, write_mesh_ply
from debris_scanner.sim.shapes import box, sphere, volume


def test_ply_round_trip(tmp_path):
    vertices, triangles = box((1, 2, 3))
    write_mesh_ply(tmp_path / 'a.ply', vertices, triangles)
    back = read_mesh(tmp_path / 'a.ply')
    np.testing.assert_allclose(back[0], vertices)
    np.testing.assert_array_equal(back[1], triangles)
    assert [p.name for p in tmp_path.iterdir()] == ['a.ply']


def test_an_empty_mesh_is_read_only_where_allowed(tmp_path):
    write_mesh_ply(tmp_path / 'a.ply', np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert [len(x) for x in read_mesh(tmp_path / 'a.ply', allow_empty=True)] == [0, 0]
    with pytest.raises(MeshFileError, match='no triangles'):
        read_mesh(tmp_path / 'a.ply')


def test_obj_with_normals_polygons_and_indices_from_the_end(tmp_path):
    path = tmp_path / 'cube.obj'
    path.write_text(
        '# cube\nmtllib missing.mtl\no cube\n'
        + ''.join(f'v {x} {y} {z}\n' for x in (0, 1) for y in (0, 1) for z in (0, 1))
        + 'vn 0 0 1\nusemtl red\nf 1//1 2//1 4//1 3//1\nf 5 7 8 6\nf 1/1/1 5/1/1 6/1/1 2/1/1\n'
        + 'f -6 -5 -1 -2\nf 1 3 7 5\nf 2 6 8 4\n'
    )
    solid = read_mesh(path)
    assert len(solid[1]) == 12
    assert abs(volume(solid)) == pytest.approx(1)


def test_obj_of_two_materials_with_a_texture_stays_one_surface(tmp_path):
    path = tmp_path / 'a.obj'
    corners = 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 1\n'
    path.write_text(f'{corners}usemtl a\nf 1/1 2/2 3/1\nusemtl b\nf 2/1 4/2 3/2\n')
    vertices, triangles = read_mesh(path)
    assert vertices.shape == (4, 3)
    assert triangles.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('a.obj', 'v 0 0 x\n', 'not an OBJ'),
        ('a.obj', '', 'no triangles'),
        ('a.obj', 'v 0 0 0\nv 1 0 0\nf 1 2 3\n', 'broken'),
        ('a.obj', 'v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n', 'broken'),
        ('a.obj', 'v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n', 'degenerate'),
        ('a.ply', 'not a ply', 'no triangles'),
        ('a.stl', 'not an stl', 'no triangles'),
    ],
)
def test_files_without_a_mesh_are_named(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(MeshFileError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert name in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MeshFileError, match=r'not found.*none\.stl'):
        read_mesh(tmp_path / 'none.stl')


def test_decimated_mesh_keeps_the_shape():
    vertices, triangles = decimated(*sphere(6), 2000)
    assert 1000 < len(triangles) <= 2000
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1.0, atol=0.02)
    assert np.abs(vertices).max(axis=0) == pytest.approx(1.0, abs=0.02)
    few = sphere(2)
    assert decimated(*few, 2000)[1] is few[1]
