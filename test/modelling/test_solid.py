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

"""Mass properties against those of known bodies, and the coverage of a box with a face that nobody saw."""

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.core.geometry import exp_so3
from debris_scanner.modelling.solid import coverage, solid


def closed(mesh):
    faces = np.asarray(mesh.faces, np.int32)
    return ClosedMesh(np.asarray(mesh.vertices, np.float32), faces, np.ones(len(faces), bool))


@pytest.fixture
def brick():
    R = exp_so3(np.array([0.3, -0.5, 0.2]))
    mesh = trimesh.creation.box((0.1, 0.2, 0.4))
    mesh.vertices = mesh.vertices @ R.T + [0.5, -0.3, 0.2]
    return mesh, R


def test_a_turned_brick_beside_the_origin(brick):
    mesh, R = brick
    body = solid(closed(mesh))
    assert body.volume == pytest.approx(0.008)
    assert body.centroid == pytest.approx([0.5, -0.3, 0.2], abs=1e-6)
    expected = R @ np.diag([0.2**2 + 0.4**2, 0.1**2 + 0.4**2, 0.1**2 + 0.2**2]) @ R.T / 12
    assert body.inertia == pytest.approx(expected, abs=1e-8)
    moments, axes = body.principal
    assert (np.diff(moments) > 0).all()
    assert np.linalg.det(axes) == pytest.approx(1)


def test_any_mesh_as_another_library_has_it():
    mesh = trimesh.creation.annulus(0.05, 0.1, 0.3)
    body = solid(closed(mesh))
    assert body.volume == pytest.approx(mesh.volume, rel=1e-5)
    assert body.centroid == pytest.approx(mesh.center_mass, abs=1e-6)
    assert body.inertia == pytest.approx(mesh.moment_inertia / mesh.volume, rel=1e-4, abs=1e-8)


def test_told_beside_what_the_motion_tells(brick):
    mesh, R = brick
    body = solid(closed(mesh))
    assert 'centre_of_mass_apart_m' not in body.told(None)
    assert 'centre_of_mass_apart_m' not in body.told({'observable': False})
    motion = {
        'observable': True,
        'principal_axes': (R @ exp_so3(np.radians([0, 0, 2.0]))).T[[2, 1, 0]].tolist(),
        'centre_of_mass_m': [0.5, -0.3, 0.25],
    }
    told = body.told(motion)
    assert told['centre_of_mass_apart_m'] == pytest.approx(0.05, abs=1e-6)
    assert told['principal_axes_apart_deg'] == pytest.approx([0, 2, 2], abs=0.05)
    assert told['inertia_ratios'] == pytest.approx([0.05 / 0.2, 0.17 / 0.2])


def model(unseen):
    cube = trimesh.creation.box((1.0, 1.0, 1.0))
    observed = (
        ~(cube.face_normals @ np.asarray(unseen, float) > 0.5) if unseen is not None else np.ones(12, bool)
    )
    mesh = ClosedMesh(np.asarray(cube.vertices, np.float32), np.asarray(cube.faces, np.int32), observed)
    none = np.zeros((0, 3), np.float32)
    return Model(none, none, mesh.vertices, mesh.triangles[observed], closed=mesh)


def test_one_face_unseen():
    told = coverage(model([0, 0, -1]))
    assert told['observed_share'] == pytest.approx(5 / 6)
    assert told['openings'] == {'number': 1, 'area_m2': pytest.approx(1.0)}
    assert told['unseen_directions'] == [[0, 0, -1]]


def test_all_seen():
    told = coverage(model([0, 0, 0]))
    assert told == {'observed_share': 1.0, 'openings': {'number': 0, 'area_m2': 0.0}, 'unseen_directions': []}


def test_without_a_closed_surface_nothing_is_told():
    none = np.zeros((0, 3), np.float32)
    assert coverage(Model(none, none, none, np.zeros((0, 3), np.int32))) is None
