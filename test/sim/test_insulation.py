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

from debris_scanner.sim.insulation import Insulation
from debris_scanner.sim.targets import make_target


def returns(degrees):
    """Mean chance over a flat blanket of 0.3 m, seen at an angle."""
    x, y = np.meshgrid(np.linspace(0, 0.3, 200), np.linspace(0, 0.3, 200))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).astype(np.float32)
    normals = np.broadcast_to(np.array([0, 0, 1], np.float32), points.shape)
    angle = np.radians(degrees)
    to_sensor = np.broadcast_to(np.array([np.sin(angle), 0, np.cos(angle)], np.float32), points.shape)
    return Insulation(make_target('cubesat')).returns(points, normals, to_sensor)


def test_returns_fall_with_incidence_as_quoted():
    assert 0.6 < returns(0).mean() <= 1
    assert 0.35 < returns(20).mean() < 0.55
    assert returns(40).mean() < 0.12
    assert returns(60).max() < 0.03


def test_crinkles_make_bright_and_dark_patches_that_stay():
    chance = returns(20)
    assert chance.std() > 0.1
    # patches are centimetres wide: neighbours 1.5 mm apart agree
    assert np.abs(np.diff(chance, axis=1)).mean() < 0.5 * chance.std()
    np.testing.assert_array_equal(chance, returns(20))


@pytest.mark.parametrize('share', [0.0, 0.4, 1.0])
def test_it_covers_the_share_asked_for_in_large_patches(share):
    target = make_target('asteroid')
    corners = target.vertices[target.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    covered = Insulation(target, share).covers(corners)
    assert np.average(covered.mean(axis=1), weights=area) == pytest.approx(share, abs=0.04)
    split = covered.any(axis=1) & ~covered.all(axis=1)  # triangles across an edge of a patch
    assert np.average(split, weights=area) < 0.15


def test_what_it_leaves_bare_returns_at_any_incidence():
    target = make_target('asteroid')
    points = target.vertices[:, None]
    normal, aslant = (np.broadcast_to(np.array(a, np.float32), points.shape) for a in ([0, 0, 1], [1, 0, 0]))
    half = Insulation(target, 0.5)
    bare = ~half.covers(points)
    assert (half.returns(points, normal, aslant) == bare).all() and 0.2 < bare.mean() < 0.8
