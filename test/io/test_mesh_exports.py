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

"""The closed mesh's files, read by other programs."""

import dataclasses
import io
import json
import struct
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from debris_scanner.core.atlas import make_atlas
from debris_scanner.core.frames import ClosedMesh, Texture
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.mesh_exports import CLOSED_FILES, DENSITY, FILLED, TEXTURE_FILES
from debris_scanner.io.mesh_files import read_mesh

SIZE = (0.1, 0.2, 0.4)


@pytest.fixture(params=[False, True], ids=['grey', 'coloured'])
def mesh(request):
    brick = trimesh.creation.box(SIZE)
    observed = brick.face_normals[:, 2] < 0.5
    rgb = (40 + 200 * (brick.vertices > 0)).astype(np.uint8) if request.param else None
    vertices = np.asarray(brick.vertices + [0, 0, 0.05], np.float32)
    return ClosedMesh(vertices, np.asarray(brick.faces, np.int32), observed, rgb)


@pytest.fixture
def folder(mesh, tmp_path):
    for name, encode in CLOSED_FILES.items():
        (tmp_path / name).write_bytes(encode(mesh))
    return tmp_path


@pytest.mark.parametrize(
    ('name', 'unit'), [('mesh_closed.ply', 1), ('mesh_closed.stl', 1000), ('mesh_closed.obj', 1)]
)
def test_other_programs_read_the_same_mesh(folder, name, unit):
    found = load_open3d().io.read_triangle_mesh(str(folder / name))
    assert np.ptp(np.asarray(found.vertices), axis=0) == pytest.approx(np.multiply(unit, SIZE))
    assert np.asarray(found.vertices).mean(axis=0) == pytest.approx([0, 0, 0.05 * unit], abs=1e-6)
    assert len(found.triangles) == 12
    found.merge_close_vertices(1e-9)
    assert found.is_watertight()
    assert found.get_volume() == pytest.approx(np.prod(SIZE) * unit**3)


def test_ply_says_which_faces_were_seen(folder, mesh):
    faces = trimesh.load(folder / 'mesh_closed.ply', process=False).metadata['_ply_raw']['face']['data']
    assert (np.asarray(faces['observed']).reshape(-1) == mesh.observed).all()
    assert len(read_mesh(folder / 'mesh_closed.ply')[1]) == 12


def test_glb_is_coloured_and_darker_where_nobody_saw(folder, mesh):
    data = (folder / 'mesh.glb').read_bytes()
    assert data[:4] == b'glTF'
    length = struct.unpack('<I', data[12:16])[0]
    header = json.loads(data[20 : 20 + length])
    assert 'COLOR_0' in header['meshes'][0]['primitives'][0]['attributes']
    found = trimesh.load(folder / 'mesh.glb', force='mesh')
    assert found.extents == pytest.approx(SIZE)
    rgb = found.visual.vertex_colors[:, :3]
    usual = np.full((8, 3), 190) if mesh.rgb is None else mesh.rgb
    order = [int(np.argmin(np.linalg.norm(found.vertices - v, axis=1))) for v in mesh.vertices]
    seen = np.isin(np.arange(8), mesh.triangles[mesh.observed])
    assert (rgb[order][seen] == usual[seen]).all()
    assert rgb[order][~seen] == pytest.approx((usual[~seen] * FILLED).astype(int))


def test_obj_keeps_colour(folder, mesh):
    found = trimesh.load(folder / 'mesh_closed.obj', process=False)
    if mesh.rgb is not None:
        assert (found.visual.vertex_colors[:, :3] == mesh.rgb).all()


def test_mujoco_takes_the_urdf(folder):
    model = mujoco.MjModel.from_xml_path(str(folder / 'target.urdf'))
    mass = DENSITY * np.prod(SIZE)
    body = model.body('target').id
    assert model.body_mass[body] == pytest.approx(mass)
    assert model.body_ipos[body] == pytest.approx([0, 0, 0.05], abs=1e-6)
    x, y, z = np.square(SIZE)
    assert sorted(model.body_inertia[body]) == pytest.approx(
        sorted(mass / 12 * np.array([y + z, x + z, x + y]))
    )
    assert model.nmesh == 1


def test_bullet_takes_the_sdf_and_the_urdf(folder):
    bullet = pytest.importorskip('pybullet', reason='pybullet has no wheel for this Python')
    world = bullet.connect(bullet.DIRECT)
    try:
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        (body,) = bullet.loadSDF(str(folder / 'target.sdf'))
        other = bullet.loadURDF(str(folder / 'target.urdf'), flags=flags)
        mass = DENSITY * np.prod(SIZE)
        for b in (body, other):
            mass_, _, inertia, at, *_ = bullet.getDynamicsInfo(b, -1)
            assert mass_ == pytest.approx(mass)
            assert at == pytest.approx([0, 0, 0.05], abs=1e-6)
            assert len(bullet.getVisualShapeData(b)) == len(bullet.getCollisionShapeData(b, -1)) == 1
            low, high = bullet.getAABB(b)
            assert np.subtract(high, low) == pytest.approx(SIZE, abs=0.05)
        x, y, z = np.square(SIZE)
        assert inertia == pytest.approx(mass / 12 * np.array([y + z, x + z, x + y]))
    finally:
        bullet.disconnect(world)


def test_sdf_and_urdf_say_the_same(folder):
    sdf = ElementTree.parse(folder / 'target.sdf').getroot()
    urdf = ElementTree.parse(folder / 'target.urdf').getroot()
    assert (sdf.tag, sdf.get('version')) == ('sdf', '1.7')
    link, other = sdf.find('model/link'), urdf.find('link')
    pose = link.findtext('inertial/pose').split()
    assert pose == [*other.find('inertial/origin').get('xyz').split(), '0', '0', '0']
    assert link.findtext('inertial/mass') == other.find('inertial/mass').get('value')
    moments = {m.tag: m.text for m in link.find('inertial/inertia')}
    assert moments == dict(other.find('inertial/inertia').items())
    assert list(moments) == ['ixx', 'ixy', 'ixz', 'iyy', 'iyz', 'izz']
    for kind in ('visual', 'collision'):
        assert link.find(kind).get('name') == kind
        uri = link.findtext(f'{kind}/geometry/mesh/uri')
        assert uri == other.find(f'{kind}/geometry/mesh').get('filename')
        assert (folder / uri).is_file()


def painted(points):
    """Colours (n, 3), floats, of points on the brick."""
    return 130 + 300 * np.asarray(points) @ np.array([[1, 0, 0.2], [0, 1, 0], [-0.5, 0, 0.3]])


@pytest.fixture(scope='module')
def textured():
    """A brick whose texture is a colour gradient."""
    brick = trimesh.creation.box(SIZE)
    observed = brick.face_normals[:, 2] < 0.5
    vertices, triangles = np.asarray(brick.vertices + [0, 0, 0.05], np.float32), brick.faces.astype(np.int32)
    atlas = make_atlas(vertices, triangles, 0.002)
    faces = atlas.faces()
    image = np.zeros((*faces.shape, 3))
    for t in range(12):  # on a triangle colour is linear in the place on the image
        rows, columns = np.nonzero(faces == t)
        corners = np.column_stack([atlas.xy[atlas.triangles[t]], np.ones(3)])
        linear = np.linalg.solve(corners, painted(vertices[triangles[t]]))
        image[rows, columns] = np.column_stack([columns, rows, np.ones(len(rows))]) @ linear
    uv = (atlas.xy + 0.5) / [atlas.width, atlas.height]
    texture = Texture(
        np.clip(np.rint(image), 0, 255).astype(np.uint8),
        observed[faces],
        atlas.vertices,
        atlas.triangles,
        uv.astype(np.float32),
    )
    return ClosedMesh(vertices, triangles, observed, texture=texture)


@pytest.fixture
def textured_folder(textured, tmp_path):
    for name, encode in CLOSED_FILES.items():
        (tmp_path / name).write_bytes(encode(textured))
    for name, encode in TEXTURE_FILES.items():
        (tmp_path / name).write_bytes(encode(textured.texture))
    return tmp_path


def shown(found, image):
    """Colours (t, 3) of an image (h, w, 3) in the middles of the triangles, as trimesh reads them."""
    places = found.visual.uv[found.faces].mean(axis=1)
    return trimesh.visual.color.uv_to_color(places, image)[:, :3].astype(float)


def test_glb_carries_the_texture_and_is_darker_where_nobody_saw(textured_folder, textured):
    data = (textured_folder / 'mesh.glb').read_bytes()
    header = json.loads(data[20 : 20 + struct.unpack('<I', data[12:16])[0]])
    material = header['materials'][0]['pbrMetallicRoughness']
    assert (material['metallicFactor'], material['roughnessFactor']) == (0, 1)
    assert [image['mimeType'] for image in header['images']] == ['image/png']
    found = trimesh.load(textured_folder / 'mesh.glb', force='mesh', process=False)
    assert found.extents == pytest.approx(SIZE)
    colours = shown(found, found.visual.material.baseColorTexture)
    shade = np.where(textured.observed, 1, FILLED)[:, None]
    assert colours == pytest.approx(painted(found.triangles_center) * shade, abs=3)


def test_obj_carries_the_texture_and_stays_closed(textured_folder):
    found = trimesh.load(textured_folder / 'mesh_closed.obj', process=False)
    colours = shown(found, found.visual.material.image)
    assert colours == pytest.approx(painted(found.triangles_center), abs=3)
    vertices, triangles = read_mesh(textured_folder / 'mesh_closed.obj')
    assert trimesh.Trimesh(vertices, triangles, process=False).is_watertight
    seen = load_open3d().io.read_triangle_mesh(str(textured_folder / 'mesh_closed.obj'), True)
    assert seen.has_triangle_uvs()
    image = np.asarray(Image.open(textured_folder / 'mesh_closed.png'))
    assert image.shape in [np.asarray(texture).shape for texture in seen.textures]


def test_mujoco_takes_the_urdf_of_a_textured_mesh(textured_folder):
    assert mujoco.MjModel.from_xml_path(str(textured_folder / 'target.urdf')).nmesh == 1


def test_the_same_texture_gives_the_same_bytes(textured):
    for encode in CLOSED_FILES.values():
        assert encode(textured) == encode(textured)
    png = TEXTURE_FILES['mesh_closed.png'](textured.texture)
    assert (np.asarray(Image.open(io.BytesIO(png))) == textured.texture.image).all()


def test_a_texture_changes_nothing_but_glb_and_obj(textured):
    plain = dataclasses.replace(textured, texture=None)
    changed = {name for name, encode in CLOSED_FILES.items() if encode(plain) != encode(textured)}
    assert changed == {'mesh.glb', 'mesh_closed.obj'}
