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

"""Does a target that changes while it turns show, whatever its poses, and does a rigid one never?"""

import dataclasses

import numpy as np
import pytest
import trimesh

from debris_scanner.core.frames import DepthFrame, Model
from debris_scanner.core.geometry import compose, exp_se3, inverse
from debris_scanner.core.results import NOT_RIGID
from debris_scanner.mapping.posed_views import PosedViews
from debris_scanner.modelling.placement import KnownModel
from debris_scanner.modelling.rigidity import CHANCE, MOST_OFF, change_over_time, disagreement, signed_rank
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings

TWO_TURNS = SimulationSettings(spin_rad_s=1.0, rate_hz=6.0, seconds=12.5, seed=5)
HALF = len(Simulation(TWO_TURNS)) // 2
SCATTER = np.random.default_rng(3).normal(size=(2 * HALF, 6)) * np.repeat([np.radians(0.15), 0.0005], 3)


def changed(mesh):
    """The target of the second turn."""
    target = Simulation(TWO_TURNS).target
    vertices, triangles = mesh(target.vertices.astype(float), target.triangles)
    return dataclasses.replace(
        target, vertices=vertices.astype(np.float32), triangles=triangles.astype(np.int32)
    )


def with_knob(vertices, triangles):
    """50 mm in all directions, on the flank."""
    middle = np.abs(vertices[:, 2]) < 0.05
    where = vertices[middle][np.argmax(vertices[middle][:, 0])]
    knob = trimesh.creation.box((0.05, 0.05, 0.05))
    corners = knob.vertices + where
    return np.concatenate([vertices, corners]), np.concatenate([triangles, knob.faces + len(vertices)])


def stretched(vertices, triangles):
    """By 4 % along one axis."""
    return vertices * [1, 1, 1.04], triangles


def model_of(target):
    """As read from a mesh file."""
    mesh = trimesh.Trimesh(target.vertices, target.triangles, process=False)
    points, face = trimesh.sample.sample_surface(mesh, 20_000, seed=1)
    normals = mesh.face_normals[face].astype(np.float32)
    return Model(points.astype(np.float32), normals, target.vertices, target.triangles)


def bent(vertices, triangles):
    """By 15 mm at its end."""
    along = (vertices[:, 2] - vertices[:, 2].min()) / np.ptp(vertices[:, 2])
    return vertices + np.outer(along**2, [0.015, 0, 0]), triangles


def frames(second):
    """Depth frames of two turns and their true poses; of the second turn the target may be another."""
    first = Simulation(TWO_TURNS)
    later = first if second is None else Simulation(TWO_TURNS, changed(second))
    for k in range(2 * HALF):
        frame = (first if k < HALF else later).frame(k)
        yield DepthFrame(frame.stamp_ns, frame.depth, frame.camera), inverse(frame.T_sensor_target)


def key_frames(second):
    """Their views and true poses."""
    preprocessor = Preprocessor(Settings().isolation, Settings().normals)
    seen = [(View(preprocessor.process(frame)), T) for frame, T in frames(second)]
    return [view for view, _ in seen], [T for _, T in seen]


@pytest.mark.parametrize('second', [None, with_knob, bent], ids=['rigid', 'with a knob', 'bent'])
def test_a_change_shows_and_scattered_poses_are_none(second):
    views, poses = key_frames(second)
    poses = [compose(exp_se3(twist), T) for twist, T in zip(SCATTER, poses, strict=True)]
    found = change_over_time(PosedViews(views, poses, typical_sensor(views)))
    if second is None:
        assert found is None
        return
    assert found.deviations > CHANCE and f'> {CHANCE:.1f} standard deviations' in found.words
    assert found.before_ns < views[HALF].frame.stamp_ns <= found.after_ns
    if second is with_knob:
        knob = with_knob(*map(np.asarray, (Simulation(TWO_TURNS).target.vertices, np.zeros((0, 3), int))))[0]
        assert np.linalg.norm(found.at - knob[-8:].mean(axis=0)) < 0.05  # its half diagonal is 43 mm
        assert 0.01 < found.by < 0.09


@pytest.mark.slow
def test_a_scan_of_a_target_that_was_bent_after_its_model_was_made_ends_without_one():
    scanner = Scanner(Settings())
    for frame, _ in frames(bent):
        scanner.process(frame)
    result = scanner.finish()
    assert (result.reason, result.model) == (NOT_RIGID, None)


def test_one_turn_shows_no_side_twice_and_says_nothing():
    views, poses = (some[:HALF] for some in key_frames(bent))
    assert change_over_time(PosedViews(views, poses, typical_sensor(views))) is None


@pytest.mark.parametrize('given', [None, with_knob, stretched], ids=['exact', 'with a knob', 'stretched'])
def test_a_given_model_that_differs_says_where(given):
    """The target is the first turn's; the model may be another."""
    views, poses = key_frames(None)
    target = Simulation(TWO_TURNS).target if given is None else changed(given)
    known = KnownModel(model_of(target))
    shown = [(v, T, known.seen_from(v, T)) for v, T in zip(views[:HALF], poses[:HALF], strict=True)]
    found = disagreement(shown, 0.0017)
    assert found.told()['share'] == found.share
    if given is None:
        assert found.deviations < 0.8 * MOST_OFF and found.refused == ''
        return
    assert found.deviations > MOST_OFF and 'that of the model' in found.refused
    if given is with_knob:
        assert found.by < -0.01, 'the target lacks it'


def test_a_model_that_was_hardly_seen_is_not_contradicted():
    assert disagreement([], 0.001) is None


def test_the_signed_rank_is_that_of_the_literature():
    stats = pytest.importorskip('scipy.stats')
    values = np.random.default_rng(1).normal(0.3, 1, 80)
    test = stats.wilcoxon(values, alternative='greater', method='asymptotic')
    assert signed_rank(values) == pytest.approx(stats.norm.isf(test.pvalue), abs=1e-6)
    assert abs(signed_rank(np.array([1.0, -1.0, 2.0, -2.0]))) < 0.5
