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

"""A known model that looks the same in several attitudes is turned as its colours show."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import ClosedMesh, DepthFrame, Model
from debris_scanner.core.geometry import compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.io.known_models import as_known_model
from debris_scanner.modelling.painted import Paint
from debris_scanner.modelling.placement import KnownModel
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import make_target, paint_at
from debris_scanner.stages import make_preprocessor

pytestmark = pytest.mark.slow
MIN_LEAD = 0.2
FINE_M = 0.004  # edges of the painted mesh
ROLLED = transform(exp_so3(np.radians(100) * np.array([0.0, 0.0, 1.0])), np.zeros(3))


@cache
def painted(target='cylinder'):
    """The exact mesh of a target with the simulator's stripes, in its own frame."""
    mesh = make_target(target)
    vertices, triangles = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.triangles, FINE_M, max_iter=20)
    bare = as_known_model(trimesh.Trimesh(vertices, triangles, process=False))
    return replace(bare, rgb=paint_at(bare.points), vertex_rgb=paint_at(bare.vertices))


@cache
def known(target='cylinder'):
    return KnownModel(painted(target))


@cache
def session(target='cylinder', colour=True):
    """Three views of the spinning target, 12 degrees apart, and their true T_target_view (4, 4)."""
    preprocessor, views, poses = make_preprocessor(Settings()), [], []
    for n, f in enumerate(Simulation(SimulationSettings(target=target, colour=True, seconds=2.0, seed=4))):
        target_frame = preprocessor.process(
            DepthFrame(f.stamp_ns, f.depth, f.camera, f.rgb if colour else None)
        )
        if n >= 8 and n % 4 == 0:
            views.append(View(target_frame))
            poses.append(inverse(f.T_sensor_target))
    return views, poses


def off_deg(T):
    return np.degrees(rotation_angle(T[:3, :3]))


def test_paint_shows_how_a_body_of_revolution_is_rolled():
    found = Paint(known()).placed(*session(), ROLLED, MIN_LEAD)
    assert off_deg(found.T_model_scan) < 0.3
    assert [(c.name, c.passed) for c in found.checks] == [('picture_lead', True)]


def test_paint_tells_the_halves_of_a_box_apart():
    model = known('prism')
    half = max(Paint(model)._symmetry.turns, key=off_deg)
    assert off_deg(half) > 175
    found = Paint(model).placed(*session('prism'), half, MIN_LEAD)
    assert off_deg(found.T_model_scan) < 3  # the shape's fit decides the rest


def test_without_pictures_or_colours_the_shape_decides():
    views, poses = session(colour=False)
    bare = KnownModel(replace(painted(), rgb=None, vertex_rgb=None))
    for model, seen in ((known(), views), (bare, session()[0])):
        found = Paint(model).placed(seen, poses, ROLLED, MIN_LEAD)
        assert found.T_model_scan is ROLLED and not found.checks


def test_a_plain_model_is_not_turned():
    grey = np.full((len(painted().vertices), 3), 128, np.uint8)
    plain = KnownModel(replace(painted(), vertex_rgb=grey))
    assert Paint(plain).placed(*session(), ROLLED, MIN_LEAD).T_model_scan is ROLLED


def test_paint_out_of_sight_is_waited_for():
    """The model has one end alone, the views show the side."""
    model: Model = painted()
    middle = model.vertices[model.triangles].mean(axis=1)
    end = middle[:, 2] > np.quantile(middle[:, 2], 0.9)
    closed = ClosedMesh(model.vertices, model.triangles, end, model.vertex_rgb)
    found = Paint(KnownModel(replace(model, closed=closed))).placed(*session(), ROLLED, MIN_LEAD)
    assert found.T_model_scan is None
    assert [(c.name, c.passed) for c in found.checks] == [('picture_lead', False)]


def test_a_view_is_rolled_by_its_picture_alone():
    view, pose = session()[0][1], session()[1][1]
    off = compose(transform(exp_so3(np.radians(3) * np.array([0.0, 0.0, 1.0])), np.zeros(3)), pose)
    T, _ = Paint(known()).refined(view, off)
    assert off_deg(compose(T, inverse(pose))) < 0.5
    T, _ = Paint(known()).refined(session(colour=False)[0][1], off)
    assert off_deg(compose(T, inverse(off))) < 1.0
