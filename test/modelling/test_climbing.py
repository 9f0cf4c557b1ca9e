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

"""Scans whose steps fall short by a little are climbed out of; right ones stay."""

import numpy as np
import pytest
import trimesh
from coarse_frames import coarse
from posed_frames import posed_views, simulated

from debris_scanner.core.geometry import compose, inverse, rotation_angle
from debris_scanner.modelling.climbing import climbed, main_axes, moved_far, travelled, turned_along
from debris_scanner.modelling.consistency import agreement
from debris_scanner.sim.session import SimulationSettings
from debris_scanner.sim.targets import Target

TEETH = 9


def gear():
    """Of equal teeth, but for a hub beside its middle: a tooth taken for the next one fits nearly as well."""
    angle = np.linspace(0, 2 * np.pi, 4 * TEETH, endpoint=False)
    radius = np.where(np.arange(4 * TEETH) % 4 < 2, 0.2, 0.16)
    outline = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    fan = np.array([[0, k + 1, (k + 1) % len(outline) + 1] for k in range(len(outline))])
    disc = trimesh.creation.extrude_triangulation(np.vstack([[[0.0, 0.0]], outline]), fan, 0.08)
    hub = trimesh.creation.box((0.08, 0.05, 0.05)).apply_translation((0.05, 0.0, 0.1))
    mesh = trimesh.util.concatenate([disc, hub])
    vertices = mesh.vertices - mesh.vertices.mean(axis=0)
    return Target('gear', vertices.astype(np.float32), np.asarray(mesh.faces, np.int32))


@pytest.fixture(scope='module')
def truth():
    settings = SimulationSettings(target='prism', motion='tumble', seconds=24.0, rate_hz=2.0)
    return posed_views(simulated(settings, gear(), seen=coarse))


def errors_deg(poses, truth):
    off = [compose(T, inverse(S))[:3, :3] for T, S in zip(poses, truth, strict=True)]
    return np.degrees([rotation_angle(off[0].T @ R) for R in off])


def test_what_lies_right_stays(truth):
    poses = climbed(truth)
    assert poses is None or errors_deg(poses, truth.poses).max() < 3.0


@pytest.mark.parametrize('end_deg', [-20.0, 12.0])
def test_steps_that_fall_short_are_climbed_out_of(truth, end_deg):
    path = travelled(truth.poses)
    # faster at first, as where one side says more than another
    by = np.radians(end_deg) * np.sqrt(path / path[-1])
    short = truth.posed(turned_along(truth, by, main_axes(truth)[0]))
    assert errors_deg(short.poses, truth.poses).max() == pytest.approx(abs(end_deg), abs=0.1)
    found = climbed(short)
    assert agreement(truth.posed(found)) > agreement(short)
    assert np.median(errors_deg(found, truth.poses)) < 0.3 * abs(end_deg)


def test_a_turn_of_the_whole_is_no_other_place(truth):
    n = len(truth.poses)
    alike = turned_along(truth, np.full(n, 1.0), np.array([0.0, 0.0, 1.0]))
    assert not moved_far(truth.poses, alike)
    assert moved_far(truth.poses, [*alike[:-1], truth.poses[-1]])


def test_the_way_is_the_sum_of_the_turns(truth):
    way = travelled(truth.poses)
    assert way[0] == 0 and (np.diff(way) > 0).all()
    direct = rotation_angle(truth.poses[3][:3, :3] @ truth.poses[0][:3, :3].T)
    assert way[3] >= direct - 1e-9
