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

"""Parts of one object are joined, whatever frames they are in; parts of two are not."""

import dataclasses

import numpy as np
import pytest
import trimesh

from debris_scanner import merging
from debris_scanner.core.frames import KeyFrame, Model
from debris_scanner.core.geometry import apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import AMBIGUOUS, NO_OVERLAP
from debris_scanner.merging import extended, looks, merge
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.placement import KnownModel, MatchSettings
from debris_scanner.modelling.solid import coverage
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.shapes import box

BOUNDS = MatchSettings(max_excess=0.3, min_lead=0.2)
FUSION = dataclasses.replace(FusionSettings(), max_voxels=100)
T_FIRST_SECOND = transform(exp_so3(np.array([1.0, -0.4, 2.2])), np.array([0.3, 0.1, -0.2]))


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Fewer and smaller images: all attitudes are searched from each view that is searched from."""
    few = {'SEARCH_VIEWS': 8, 'SEARCH_PIXELS': 200, 'FUSED_VIEWS': 24, 'MOST_PIXELS': 120}
    for name, value in few.items():
        monkeypatch.setattr(merging, name, value)


def part(vertices, triangles, kept, T=None):
    """A model of the triangles whose middle is kept, moved by T (4, 4)."""
    T = np.eye(4) if T is None else T
    triangles = triangles[kept(vertices[triangles].mean(axis=1))]
    mesh = trimesh.Trimesh(apply(T, vertices), triangles, process=False)
    points, face = trimesh.sample.sample_surface(mesh, 15_000, seed=0)
    return Model(
        points.astype(np.float32),
        mesh.face_normals[face].astype(np.float32),
        np.asarray(mesh.vertices, np.float32),
        np.asarray(triangles, np.int32),
    )


@pytest.fixture(scope='module')
def asteroid():
    target = Simulation(SimulationSettings(target='asteroid', seconds=1.0)).target
    return np.asarray(target.vertices, float), np.asarray(target.triangles)


@pytest.mark.slow
def test_two_parts_of_one_object_become_whole(asteroid):
    vertices, triangles = asteroid
    low, high = np.percentile(vertices[:, 0], [25, 75])
    first = part(vertices, triangles, lambda c: c[:, 0] > low)
    second = part(vertices, triangles, lambda c: c[:, 0] < high, inverse(T_FIRST_SECOND))
    done = []
    merged = merge([first, second], FUSION, BOUNDS, lambda *what: done.append(what))
    assert merged.reason is None, merged.why
    off = compose(merged.T_first_scan[1], inverse(T_FIRST_SECOND))
    assert np.degrees(rotation_angle(off[:3, :3])) < 0.3
    middle = apply(inverse(T_FIRST_SECOND), vertices).mean(axis=0)
    assert np.linalg.norm(apply(merged.T_first_scan[1], middle) - apply(T_FIRST_SECOND, middle)) < 5e-4
    closed = merged.model.closed
    whole = trimesh.Trimesh(closed.vertices, closed.triangles, process=False)
    assert whole.is_watertight
    assert whole.volume == pytest.approx(abs(trimesh.Trimesh(vertices, triangles).volume), rel=0.03)
    assert [d[0] for d in done] == ['place', 'look', 'look', 'close']


def test_a_model_gets_what_it_lacks(asteroid):
    vertices, triangles = asteroid
    low = np.percentile(vertices[:, 0], 30)
    lacking = KnownModel(part(vertices, triangles, lambda c: c[:, 0] > low))
    frames = looks(KnownModel(part(vertices, triangles, lambda c: c[:, 0] > -9)), 24, 120)
    model = extended(lacking, frames, FUSION)
    assert coverage(model)['observed_share'] > 0.99
    assert model.points[:, 0].min() < vertices[:, 0].min() + 0.003
    closed = trimesh.Trimesh(model.closed.vertices, model.closed.triangles, process=False)
    assert closed.volume == pytest.approx(abs(trimesh.Trimesh(vertices, triangles).volume), rel=0.03)


def test_colours_of_the_parts_are_kept(asteroid):
    """Each part has a colour of its own; the surface that both have gets the mean."""
    vertices, triangles = asteroid
    middle = np.median(vertices[:, 0])
    parts = []
    for side, colour in ((1, (200, 40, 40)), (-1, (40, 40, 200))):
        model = part(vertices, triangles, lambda c, side=side: side * (c[:, 0] - middle) > -0.03)
        rgb = np.tile(np.array(colour, np.uint8), (len(model.vertices), 1))
        parts.append(dataclasses.replace(model, vertex_rgb=rgb))
    known = KnownModel(parts[0])
    frames = looks(KnownModel(parts[1]), 24, 120)
    coloured = [KeyFrame(frame, T, 0.0) for frame, T in frames]
    model = extended(known, frames, FUSION, coloured)
    aside = model.points[:, 0] - middle
    np.testing.assert_allclose(model.rgb[aside > 0.05], np.tile((200, 40, 40), ((aside > 0.05).sum(), 1)))
    np.testing.assert_allclose(model.rgb[aside < -0.05], np.tile((40, 40, 200), ((aside < -0.05).sum(), 1)))
    common = model.closed.rgb[np.abs(model.closed.vertices[:, 0] - middle) < 0.01]
    assert np.median(common[:, 0]) == pytest.approx(120, abs=40)
    grey = extended(KnownModel(part(vertices, triangles, lambda c: c[:, 0] > -9)), [], FUSION)
    assert grey.rgb is None and grey.closed.rgb is None


@pytest.mark.slow
def test_two_objects_are_not_joined(asteroid):
    other = Simulation(SimulationSettings(target='shuttle_stack', seconds=1.0)).target
    models = [
        part(*asteroid, lambda c: c[:, 0] > -9),
        part(np.asarray(other.vertices, float), np.asarray(other.triangles), lambda c: c[:, 0] > -9),
    ]
    merged = merge(models, FUSION, BOUNDS)
    assert (merged.model, merged.reason) == (None, NO_OVERLAP)
    assert 'scan 2' in merged.why


@pytest.mark.parametrize('count', [0, 1, 60])
@pytest.mark.parametrize('first', [True, False])
def test_what_shows_no_surface_is_refused(asteroid, count, first):
    line = np.linspace(0, 0.3, count)[:, None] * np.float32([1, 0, 0])
    line = line.astype(np.float32)
    bare = Model(line, np.zeros_like(line), line, np.zeros((0, 3), np.int32))
    whole = part(*asteroid, lambda c: c[:, 0] > -9)
    models = [bare, whole] if first else [whole, bare]
    merged = merge(models, FUSION, BOUNDS)
    assert (merged.model, merged.reason) == (None, NO_OVERLAP)
    assert merged.why == f'scan {1 if first else 2}: it shows no surface'


@pytest.mark.slow
def test_a_placing_that_cannot_be_told_is_refused():
    """Corners of a cube fit each other in more than one way."""
    vertices, triangles = box((0.2, 0.2, 0.2))
    vertices, triangles = trimesh.remesh.subdivide_loop(vertices, triangles, 0)
    vertices, triangles = trimesh.remesh.subdivide_to_size(vertices, triangles, 0.02)
    models = [
        part(vertices, triangles, lambda c: (c > -0.05).all(axis=1)),
        part(vertices, triangles, lambda c: (c > -0.05).all(axis=1), inverse(T_FIRST_SECOND)),
    ]
    merged = merge(models, FUSION, BOUNDS)
    assert (merged.model, merged.reason) == (None, AMBIGUOUS)


def test_looks_come_from_all_sides_and_show_the_model(asteroid):
    model = part(*asteroid, lambda c: c[:, 0] > -9)
    posed = looks(KnownModel(model), 20, 100)
    assert len(posed) == 20
    sights = np.array([T[:3, 2] for _, T in posed])
    assert np.linalg.norm(sights.mean(axis=0)) < 0.1
    for frame, T in posed:
        assert 0.03 < np.count_nonzero(frame.depth) / frame.depth.size < 0.9
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
        assert not frame.depth[0].any() and not frame.depth[:, 0].any()
