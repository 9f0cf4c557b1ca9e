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
import trimesh

from debris_scanner.cli.main import main
from debris_scanner.core.geometry import apply, exp_so3, inverse
from debris_scanner.evaluation.true_surface import sample_mesh
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.sim.shapes import volume
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import (
    BACKGROUND,
    DEFAULT_FILE_SIZE,
    TARGET_NAMES,
    make_target,
    paint,
    paint_at,
)
from msg_adapters.bags import open_session

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


def coloured(**given):
    return simulate(SimulationSettings(colour=True, noise=False, seconds=4.0, rate_hz=1.0, **given))


def test_a_point_keeps_its_colour_as_the_target_turns():
    simulation = coloured()
    first, second = simulation.frame(0), simulation.frame(1)
    assert first.rgb.shape == (480, 640, 3)
    assert first.rgb.dtype == np.uint8
    assert (first.rgb[first.depth_mm == 0] == BACKGROUND).all()
    v, u = np.nonzero(second.depth_mm)
    points = simulation.camera.back_project(second.depth_mm * np.float32(0.001))[v, u]
    expected = paint_at(apply(inverse(second.T_sensor_target), points))
    assert np.abs(second.rgb[v, u].astype(int) - expected).max() <= 1
    assert len(np.unique(second.rgb.reshape(-1, 3), axis=0)) > 1000
    assert not np.array_equal(first.rgb, second.rgb)


def test_no_colour_unless_it_is_asked_for():
    assert simulate(SimulationSettings(seconds=1.0)).frame(0).rgb is None


def test_paint_of_nothing_is_background():
    simulation = coloured()
    rgb = paint(np.zeros((480, 640), np.uint16), simulation.camera, np.eye(4))
    assert (rgb == BACKGROUND).all()


@pytest.mark.slow
def test_a_scan_carries_the_colour_to_the_model(tmp_path):
    bag, out = tmp_path / 'bag', tmp_path / 'out'
    options = ['--range', '1.6', '--spin', '1.0', '--rate', '4', '--seconds', '7.5', '--seed', '3']
    assert main(['simulate', 'shuttle_stack', '--out', str(bag), '--colour', *options]) == 0
    with open_session(bag) as session:
        assert session.colour_topic == '/rgb/image_raw'
        frames = [frame for _, frame in session]
        assert all(frame.rgb is not None for frame in frames)
    assert main(['scan', str(bag), '--out', str(out)]) == 0
    model = read_ply(out / 'model.ply')
    assert b'FIELDS x y z rgba ' in (out / 'model.pcd').read_bytes()[:200]
    # poses say where the model's frame lies in the true one
    truth = {p.stamp_ns: p.T_sensor_target for p in read_tum(bag / 'truth.tum')}
    posed = read_tum(out / 'target_pose.tum')[-5]
    stamp_ns = min(truth, key=lambda s: abs(s - posed.stamp_ns))
    T_true_model = inverse(truth[stamp_ns]) @ posed.T_sensor_target
    expected = paint_at(apply(T_true_model, model[0]))
    error = np.abs(expected.astype(int) - model[1]).max(axis=1)
    assert np.median(error) < 12
    assert np.percentile(error, 90) < 40
    # the closed mesh's texture as well, where it was seen
    obj = trimesh.load(out / 'mesh_closed.obj', process=False)
    observed = trimesh.load(out / 'mesh_closed.ply', process=False).metadata['_ply_raw']['face']['data'][
        'observed'
    ]
    places = obj.visual.uv[obj.faces].mean(axis=1)
    shown = trimesh.visual.color.uv_to_color(places, obj.visual.material.image)[:, :3].astype(int)
    error = np.abs(paint_at(apply(T_true_model, obj.triangles_center)) - shown).max(axis=1)
    assert np.median(error[observed.reshape(-1) > 0]) < 12
    assert b'image/png' in (out / 'mesh.glb').read_bytes()[:2000]


def read_ply(path):
    """Points and colours of a binary PLY."""
    import open3d

    cloud = open3d.io.read_point_cloud(str(path))
    return np.asarray(cloud.points), np.rint(np.asarray(cloud.colors) * 255).astype(int)
