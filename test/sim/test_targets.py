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

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.evaluation.true_surface import sample_mesh
from debris_scanner.sim.shapes import volume
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import DEFAULT_FILE_SIZE, TARGET_NAMES, make_target

BODIES = [name for name in TARGET_NAMES if name != 'empty']


def changed_by(target, R):
    """Largest distance, metres, of the turned or mirrored target from itself."""
    points = sample_mesh(target.vertices, target.triangles, 3000)
    return Surface(target.vertices, target.triangles).distance(points @ R.T).max()


@pytest.mark.parametrize('name', BODIES)
def test_bodies_are_outward_centred_and_of_bench_size(name):
    target = make_target(name)
    assert target.vertices.dtype == np.float32 and target.triangles.dtype == np.int32
    assert 0.25 <= np.ptp(target.vertices, axis=0).max() <= 0.4 + 1e-6
    assert target.radius < 0.25
    assert volume((target.vertices.astype(float), target.triangles)) > 0
    centroid = sample_mesh(target.vertices, target.triangles, 50_000).mean(axis=0)
    np.testing.assert_allclose(centroid, 0, atol=2e-4)


@pytest.mark.parametrize('name', BODIES)
def test_rays_from_outside_meet_front_faces(name):
    target = make_target(name)
    rng = np.random.default_rng(0)
    surface = Surface(target.vertices, target.triangles)
    for direction in rng.normal(size=(6, 3)):
        direction /= np.linalg.norm(direction)
        aim = rng.uniform(-0.1, 0.1, (500, 3))
        start = (-direction).astype(np.float32)
        depth, normals = surface.cast(start, (aim - start).astype(np.float32))
        hit = np.isfinite(depth)
        assert hit.any()
        facing = np.einsum('ij,ij->i', normals[hit], (aim - start)[hit])
        assert (facing < 1e-6).mean() > 0.995


def test_symmetries_are_those_of_the_real_bodies():
    mirror = {axis: np.diag([-1.0 if k == i else 1.0 for k in range(3)]) for i, axis in enumerate('xyz')}
    half = exp_so3(np.array([0, 0, np.pi]))
    shuttle, tank = make_target('shuttle_stack'), make_target('tank_boosters')
    assert changed_by(shuttle, mirror['x']) < 1e-3 and changed_by(shuttle, mirror['y']) > 0.02
    assert changed_by(tank, mirror['x']) < 2e-4 and changed_by(shuttle, half) > 0.02
    prism = make_target('prism')
    assert changed_by(prism, half) < 1e-6 and changed_by(prism, exp_so3(np.array([0, 0, np.pi / 2]))) > 0.02
    turn = exp_so3(np.array([0, 0, 0.777]))
    assert changed_by(make_target('cylinder'), turn) < 1e-4
    assert 0.003 < changed_by(make_target('upper_stage'), turn) < 0.04
    for name in ('asteroid', 'defunct_satellite'):
        body = make_target(name)
        assert min(changed_by(body, m) for m in (half, *mirror.values())) > 0.01


def test_size_is_the_largest_extent():
    assert np.ptp(make_target('cubesat', 0.2).vertices, axis=0).max() == pytest.approx(0.2, rel=1e-5)
    for size in (0.0, -1.0, float('nan'), float('inf')):
        with pytest.raises(ValueError, match='size'):
            make_target('cubesat', size)


def test_an_empty_scene_has_no_mesh():
    empty = make_target('empty')
    assert len(empty.vertices) == len(empty.triangles) == 0 and empty.radius == 0


def test_an_unknown_name_lists_the_choices():
    with pytest.raises(ValueError, match=r"'teapot'.*shuttle_stack.*empty.*\.obj"):
        make_target('teapot')


@pytest.mark.parametrize(
    'file',
    ['Atlantis.obj', 'Mir.obj', 'Carina.obj', 'Rosetta.stl', 'Juno.stl', '25143itokawa.obj', 'churyumov.obj'],
)
def test_real_meshes_load_at_bench_size(shared_data, file):
    target = make_target(shared_data / 'meshes' / file)
    assert len(target.triangles) > 500
    assert np.ptp(target.vertices, axis=0).max() == pytest.approx(DEFAULT_FILE_SIZE, rel=1e-5)
    centroid = sample_mesh(target.vertices, target.triangles, 50_000).mean(axis=0)
    np.testing.assert_allclose(centroid, 0, atol=3e-4)
