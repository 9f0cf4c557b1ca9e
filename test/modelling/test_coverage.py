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

"""Coverage of a box with a face that nobody saw."""

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, Model
from debris_scanner.modelling.coverage import coverage


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
