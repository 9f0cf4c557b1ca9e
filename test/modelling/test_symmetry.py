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

"""The symmetry of simulated targets' surfaces, noisy as a model is, and in any attitude."""

import numpy as np
import pytest

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.voxel_grid import voxel_grid_with_normals
from debris_scanner.modelling.symmetry import rotational_symmetry, symmetry_of
from debris_scanner.sim.targets import make_target

SPACING = 0.002  # m, of a model's points


def model(target, noise=0.0004, keep=None):
    rng = np.random.default_rng(2)
    t = make_target(target)
    corners = t.vertices[t.triangles].astype(float)
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face, axis=1)
    k = rng.choice(len(corners), 30000, p=area / area.sum())
    points = (corners[k] * rng.dirichlet([1, 1, 1], len(k))[:, :, None]).sum(axis=1)
    normals = face[k] / area[k, None]
    points += rng.normal(0, noise, (len(points), 1)) * normals
    if keep is not None:
        seen = keep(points)
        points, normals = points[seen], normals[seen]
    points, normals = voxel_grid_with_normals(points, normals, SPACING)
    facing = normals.any(axis=1)
    points, normals = points[facing], normals[facing]
    R = exp_so3(np.array([0.4, -1.1, 0.7]))
    none = np.zeros((0, 3))
    return Model(
        (points @ R.T).astype(np.float32), (normals @ R.T).astype(np.float32),
        none.astype(np.float32), none.astype(np.int32),
    )  # fmt: skip


@pytest.mark.parametrize(('target', 'order'), [('prism', 2), ('tank_boosters', 2), ('cylinder', 12)])
def test_a_symmetric_target_tells_its_order(target, order):
    assert rotational_symmetry(model(target)) == order


@pytest.mark.parametrize('target', ['shuttle_stack', 'asteroid', 'defunct_satellite'])
def test_an_irregular_target_has_none(target):
    assert rotational_symmetry(model(target)) is None


def test_a_model_with_a_side_missing_claims_none():
    assert rotational_symmetry(model('prism', keep=lambda p: p @ [1.0, 0.7, 0.4] < 0.05)) is None


def test_turns_that_leave_a_surface_and_its_axis_of_revolution():
    round_one, box = model('cylinder'), model('prism')
    found = symmetry_of(round_one.points, round_one.normals, round_one.spacing, 12)
    assert len(found.turns) >= 23  # a dozen, each from either end, but for none at all
    along = exp_so3(np.array([0.4, -1.1, 0.7])) @ [0.0, 0.0, 1.0]
    assert abs(found.axis[:3] @ along) > 0.999
    assert np.linalg.norm(found.axis[3:]) < 0.001  # it leads through the origin
    halves = symmetry_of(box.points, box.normals, box.spacing, 12)
    assert len(halves.turns) == 3 and halves.axis is None
