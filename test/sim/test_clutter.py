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

"""What the target stands on: a desk that stays, a turntable's plate that turns along."""

import numpy as np
import pytest

from debris_scanner.core.geometry import apply, transform
from debris_scanner.sim.clutter import CLUTTER_NAMES, make_clutter, make_desk, make_hand, on_plate
from debris_scanner.sim.targets import make_target

AXIS = np.array([0.0, 1.0, 0.0])  # down in the image
AHEAD = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.05, 0.0, 0.8]))


@pytest.fixture(scope='module')
def target():
    return make_target('cubesat')


def test_the_desk_touches_the_lowest_point(target):
    vertices = apply(AHEAD, target.vertices.astype(float))
    desk = make_desk(vertices, AXIS)
    assert desk.vertices[:, 1].min() == pytest.approx(vertices[:, 1].max(), abs=1e-6)


@pytest.mark.parametrize('axis', [AXIS, -AXIS])
def test_the_plate_is_below_the_target_and_round_about_the_axis(target, axis):
    body = apply(AHEAD, target.vertices.astype(float))
    both = apply(AHEAD, on_plate(target, AHEAD, axis).vertices.astype(float))
    plate = both[len(body) :]
    np.testing.assert_allclose(both[: len(body)], body, atol=1e-6)
    assert plate[:, 1].min() == pytest.approx(body[:, 1].max(), abs=1e-5)
    centre = body.mean(axis=0)
    np.testing.assert_allclose(plate.mean(axis=0)[[0, 2]], centre[[0, 2]], atol=1e-3)
    radius = np.hypot(plate[:, 0] - centre[0], plate[:, 2] - centre[2])
    rim = plate[radius > 0.99 * radius.max()] - centre
    bearing = np.arctan2(rim[:, 2], rim[:, 0])
    assert np.diff(np.sort(bearing)).max() < 0.1  # all round


def test_the_hand_touches_the_target_and_leaves_to_the_right(target):
    vertices = apply(AHEAD, target.vertices.astype(float))
    hand, way = make_hand(vertices, AXIS)
    assert way @ [1.0, 0.0, 0.0] == pytest.approx(np.linalg.norm(way))
    assert hand.vertices[:, 0].min() < vertices[:, 0].max()
    assert (hand.vertices + way)[:, 0].min() > vertices[:, 0].max() + 0.3


def test_an_unknown_scene_is_told_what_there_is():
    with pytest.raises(ValueError, match='desk, plate'):
        make_clutter('garden')
    assert all(len(make_clutter(name).triangles) for name in CLUTTER_NAMES)
