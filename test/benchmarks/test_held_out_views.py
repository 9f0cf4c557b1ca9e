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

"""Rendered views beside true ones: the figure that tells how well a textured mesh looks."""

import dataclasses

import numpy as np
import pytest

from benchmarks.held_out_views import Caster, likeness, of_vertices
from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import ClosedMesh, DepthFrame
from debris_scanner.core.geometry import inverse, transform
from debris_scanner.modelling.closing import close
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import integrated
from debris_scanner.modelling.texture import textured
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import paint_at
from debris_scanner.stages import make_preprocessor


@pytest.fixture(scope='module')
def simulation():
    """One turn, from so far that the target is small."""
    return Simulation(
        SimulationSettings('shuttle_stack', seconds=13.0, rate_hz=2.0, range_m=1.6, colour=True)
    )


@pytest.fixture(scope='module')
def posed(simulation):
    """Each target with its true pose."""
    preprocessor = make_preprocessor(Settings())
    frames = [DepthFrame(f.stamp_ns, f.depth, f.camera, f.rgb) for f in simulation]
    return [(preprocessor.process(f), inverse(simulation.pose(n))) for n, f in enumerate(frames)]


def test_held_out_views_look_as_they_are(simulation, posed):
    mesh = textured(close(integrated(posed, FusionSettings()), posed), posed[::2])
    held_out = [simulation.pose(n) for n in range(1, len(posed), 4)]
    found = likeness(mesh, simulation, held_out, np.eye(4))
    assert found.whole > 24
    assert found.covered > 28
    assert found.missing < 0.03


def test_the_true_mesh_in_true_colours_looks_right(simulation):
    target = simulation.target
    mesh = ClosedMesh(target.vertices, target.triangles, np.ones(len(target.triangles), bool))
    mesh = dataclasses.replace(mesh, rgb=np.full((len(mesh.vertices), 3), 128, np.uint8))

    def true(mesh, faces, shares):
        return paint_at(np.einsum('nk,nki->ni', shares, mesh.vertices[mesh.triangles[faces]].astype(float)))

    poses = [simulation.pose(3)]
    assert likeness(mesh, simulation, poses, np.eye(4), true).whole > 50
    assert likeness(mesh, simulation, poses, np.eye(4), lambda *x: 0.8 * true(*x)).whole < 25
    assert likeness(mesh, simulation, poses, np.eye(4), lambda *x: 0.8 * true(*x), True).whole > 45
    assert likeness(mesh, simulation, poses, np.eye(4), of_vertices).whole < 20
    beside = likeness(mesh, simulation, poses, transform(np.eye(3), np.array([0.05, 0, 0])), true)
    assert beside.missing > 0.1
    assert beside.whole < beside.covered


def test_rays_meet_the_mesh_where_it_is():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0]], np.float32)
    camera = Camera(10.0, 10.0, 0.0, 0.0, 4, 4)
    met, faces, shares, points = Caster(vertices, np.array([[0, 2, 1]])).cast(
        camera, transform(np.eye(3), np.array([-0.01, -0.01, 5.0]))
    )
    v, u = np.nonzero(met)
    assert len(v) > 8
    assert (faces == 0).all()
    assert points == pytest.approx(np.column_stack([u * 0.5 + 0.01, v * 0.5 + 0.01, 0 * u]), abs=1e-5)
    assert shares @ vertices[[0, 2, 1]] == pytest.approx(points, abs=1e-5)
