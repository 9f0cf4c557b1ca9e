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

"""A model that is known beforehand is read from a scan's folder or from a mesh."""

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.io.files import SAVED
from debris_scanner.io.known_models import read_known_model
from debris_scanner.io.mesh_exports import obj, stl
from debris_scanner.io.mesh_files import MeshFileError, read_mesh, write_mesh_ply
from debris_scanner.io.model_files import closed_ply, mesh_ply
from debris_scanner.sim.shapes import box, sphere


def test_a_mesh_becomes_points_on_it(tmp_path):
    vertices, triangles = box((0.2, 0.3, 0.4))
    write_mesh_ply(tmp_path / 'a.ply', vertices, triangles)
    model = read_known_model(tmp_path / 'a.ply')
    assert model.closed is None and len(model.points) > 5000
    outside = np.abs(model.points) / [0.1, 0.15, 0.2]
    # on the box, but for leaves across its edges, whose mean lies within
    assert (outside.max(axis=1) > 0.98).all() and outside.max() < 1.0001
    assert np.median(np.abs(model.normals).max(axis=1)) == pytest.approx(1.0)
    assert ((model.points * model.normals).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(read_known_model(tmp_path / 'a.ply').points, model.points)


def test_a_folder_gives_what_was_observed_too(tmp_path):
    vertices, triangles = sphere(3)
    vertices = 0.1 * vertices
    observed = np.arange(len(triangles)) % 3 > 0
    write_mesh_ply(tmp_path / 'mesh.ply', vertices, triangles)
    closed = ClosedMesh(vertices.astype(np.float32), triangles.astype(np.int32), observed)
    (tmp_path / 'mesh_closed.ply').write_bytes(closed_ply(closed))
    (tmp_path / 'summary.json').write_text('{"model": {}}')
    found = read_known_model(tmp_path).closed
    np.testing.assert_array_equal(found.observed, observed)
    np.testing.assert_allclose(found.vertices, vertices, atol=1e-7)
    normals = read_known_model(tmp_path).normals
    assert (normals * read_known_model(tmp_path).points).sum(axis=1).min() > 0.099 - 0.002


def painted_box():
    """A model of a box, finely meshed; its colour is the place in the box."""
    vertices, triangles = trimesh.remesh.subdivide_to_size(*box((0.2, 0.3, 0.4)), 0.02)
    vertices = vertices.astype(np.float32)
    rgb = colours_at(vertices).astype(np.uint8)
    triangles = triangles.astype(np.int32)
    closed = ClosedMesh(vertices, triangles, np.ones(len(triangles), bool), rgb)
    return Model(vertices, np.zeros_like(vertices), vertices, triangles, rgb, rgb, closed)


def colours_at(points):
    return np.rint(255 * (points / [0.2, 0.3, 0.4] + 0.5))


@pytest.mark.parametrize('name', ['mesh.ply', 'mesh_closed.obj'])
def test_a_mesh_keeps_its_colours(tmp_path, name):
    model = painted_box()
    data = mesh_ply(model) if name == 'mesh.ply' else obj(model.closed)
    (tmp_path / name).write_bytes(data)
    found = read_known_model(tmp_path / name)
    np.testing.assert_allclose(found.vertex_rgb, colours_at(found.vertices), atol=1.01)
    assert np.abs(found.rgb - colours_at(found.points)).max() < 8
    write_mesh_ply(tmp_path / 'grey.ply', model.vertices, model.triangles)
    assert read_known_model(tmp_path / 'grey.ply').rgb is None


def test_a_folder_keeps_the_colours_of_its_closed_mesh(tmp_path):
    model = painted_box()
    (tmp_path / 'mesh.ply').write_bytes(mesh_ply(model))
    (tmp_path / 'mesh_closed.ply').write_bytes(closed_ply(model.closed))
    (tmp_path / 'summary.json').write_text('{"model": {}}')
    found = read_known_model(tmp_path)
    np.testing.assert_array_equal(found.closed.rgb, model.closed.rgb)
    np.testing.assert_array_equal(found.vertex_rgb, model.vertex_rgb)
    assert mesh_ply(found) == mesh_ply(model)  # as it was


def test_errors_say_what_is_missing(tmp_path):
    for content, why in (
        (None, r'it has no summary\.json of a finished scan'),
        ('{', r'it has no summary\.json of a finished scan'),
        ('{"model": null}', 'that scan ended without one'),
        ('{"model": {}}', r'it has no mesh\.ply'),
    ):
        if content is not None:
            (tmp_path / 'summary.json').write_text(content)
        with pytest.raises(MeshFileError, match=f'no model in {tmp_path}: {why}'):
            read_known_model(tmp_path)
    with pytest.raises(MeshFileError, match='not found'):
        read_known_model(tmp_path / 'nothing.ply')
    vertices, triangles = box((200, 300, 400))
    write_mesh_ply(tmp_path / 'mm.ply', vertices, triangles)
    with pytest.raises(MeshFileError, match=r'400 m large: is it in millimetres\? A model must be in metres'):
        read_known_model(tmp_path / 'mm.ply')
    write_mesh_ply(tmp_path / 'mesh.ply', *box((0.2, 0.3, 0.4)))
    write_mesh_ply(tmp_path / 'mesh_closed.ply', *box((0.2, 0.3, 0.4)))
    with pytest.raises(MeshFileError, match='no property "observed"'):
        read_known_model(tmp_path)


def test_a_result_that_is_not_all_in_place_is_put_there_first(tmp_path):
    """As a scan leaves it that is killed once all of it is written."""
    saved = tmp_path / SAVED
    saved.mkdir()
    write_mesh_ply(saved / 'mesh.ply', *box((0.2, 0.3, 0.4)))
    (saved / 'summary.json').write_text('{"model": {}}')
    (saved / '.gone').write_text('model.ply')
    (tmp_path / 'model.ply').write_text('of the earlier scan')
    assert read_known_model(tmp_path).closed is None
    assert {path.name for path in tmp_path.iterdir()} == {'mesh.ply', 'summary.json'}


@pytest.mark.parametrize('name', ['mesh_closed.stl', 'renamed.STL'])
def test_our_own_stl_is_read_as_the_millimetres_it_is_in(tmp_path, name):
    vertices, triangles = box((0.2, 0.3, 0.4))
    mesh = ClosedMesh(vertices.astype(np.float32), triangles, np.ones(len(triangles), bool))
    (tmp_path / name).write_bytes(stl(mesh))
    assert np.ptp(read_mesh(tmp_path / name)[0], axis=0).max() == pytest.approx(400)  # of the file
    assert np.ptp(read_known_model(tmp_path / name).points, axis=0).max() == pytest.approx(0.4, abs=0.01)


def test_a_toy_in_millimetres_is_asked_for_its_unit(tmp_path):
    write_mesh_ply(tmp_path / 'toy.ply', *box((40, 60, 80)))
    with pytest.raises(MeshFileError, match=r'toy\.ply is 80 m large: is it in millimetres\?'):
        read_known_model(tmp_path / 'toy.ply')
