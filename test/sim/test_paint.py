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

"""Paint turns with the target, and a scan carries it to the model."""

import numpy as np
import pytest
import trimesh

from debris_scanner.cli.main import main
from debris_scanner.core.geometry import apply, inverse
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sim.paint import BACKGROUND, paint, paint_at
from debris_scanner.sim.session import SimulationSettings, simulate
from msg_adapters.bags import open_session


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
    options = ['--range', '1.6', '--spin', '1.0', '--rate', '6', '--seconds', '7.5', '--seed', '3']
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
    posed = read_tum(out / 'target_pose.tum')[40]
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
