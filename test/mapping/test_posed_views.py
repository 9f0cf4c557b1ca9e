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

"""Which views are paired, and what a right pair's likelihood is."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.mapping.posed_views import RINGS, PosedViews
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import angles_between

EVERY = range(0, 126, 4)


@pytest.fixture(scope='module')
def posed(recording):
    views = [recording.views[k] for k in EVERY]
    return PosedViews(views, [recording.pose(k) for k in EVERY], typical_sensor(views))


def test_neighbours_in_time_are_paired_wherever_they_are_posed(posed):
    away = transform(exp_so3(np.array([0.0, 2.0, 0.0])), np.zeros(3))
    inside = np.arange(len(posed.views)) >= 16
    moved = posed.posed([compose(away, T) if k else T for k, T in zip(inside, posed.poses, strict=True)])
    for views in (posed, moved):
        assert {(k, k + 1) for k in range(len(posed.views) - 1)} <= set(views.pairs)


def test_pairs_look_from_similar_directions(posed):
    angles = angles_between(posed.views, posed.poses)
    assert max(angles[i, j] for i, j in posed.pairs) < RINGS[-1]
    assert len(posed.pairs) < 8 * len(posed.views)


def test_the_turn_is_closed_by_pairs_of_first_and_last(posed):
    n = len(posed.views)
    assert any(j - i > n // 2 for i, j in posed.pairs)


def test_a_twist_moves_those_inside_about_the_centre(posed):
    inside = np.zeros(len(posed.views), np.bool_)
    inside[3] = True
    moved = posed.moved(inside, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.02]), posed.poses)
    assert all(
        np.array_equal(a, b) for k, (a, b) in enumerate(zip(moved, posed.poses, strict=True)) if k != 3
    )
    back = moved[3] @ np.linalg.inv(posed.poses[3])
    centre = back[:3, :3] @ posed.centre + back[:3, 3]
    np.testing.assert_allclose(centre - posed.centre, [0.0, 0.0, 0.02], atol=1e-9)


def test_without_some_views_the_other_pairs_are_known(posed):
    few = posed.without([3, 4])
    assert len(few.views) == len(posed.views) - 2
    kept = [k for k in range(len(posed.views)) if k not in (3, 4)]
    for i, j in few.pairs[:20]:
        alone = posed.pair(kept[i], kept[j])
        assert few.pair(i, j).log_likelihood == pytest.approx(alone.log_likelihood, rel=1e-12)


def test_few_points_say_about_the_same(posed):
    few = posed.coarse()
    assert few is few.coarse() is posed.coarse()
    of_all, of_few = ([p.log_likelihood / p.points for p in q.pairs_at(q.pairs)] for q in (posed, few))
    assert np.median(np.abs(np.subtract(of_all, of_few))) < 0.15
