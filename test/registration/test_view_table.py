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

"""Many pairs in one call of a kernel say what they say one by one."""

from dataclasses import astuple

import numpy as np
import pytest

from debris_scanner.registration.likelihood import pair_likelihood, pair_likelihoods, typical_beam
from debris_scanner.registration.projective import linearise_pair, linearise_pairs
from debris_scanner.registration.view_table import ViewTable, both_directions
from debris_scanner.sensing.views import View

CHOSEN = (0, 4, 8, 12, 60)
PAIRS = [(1, 0), (2, 1), (3, 2), (0, 3), (4, 2)]  # the last two views of which share next to nothing
GATE = 5.5
CENTRE = np.array([0.01, -0.02, 0.005])


@pytest.fixture(scope='module')
def scene(recording):
    """Views, one of them partially occluded, one porous and one thinned, and their poses."""
    views = [View(recording.views[k].frame) for k in CHOSEN]
    views[1].unoccluded = False
    views[2] = views[2].thinned(3)
    views[3]._prepare()
    views[3].porous = True
    return views, [recording.pose(k) for k in CHOSEN]


def test_pairs_are_linearised_as_one_by_one(scene):
    views, poses = scene
    together = linearise_pairs(ViewTable(views), poses, PAIRS, GATE)
    for (i, j), found in zip(PAIRS, together, strict=True):
        alone = linearise_pair(views[i], poses[i], views[j], poses[j], GATE)
        np.testing.assert_allclose(found.H, alone.H, rtol=1e-9, atol=1e-9 * alone.H.max())
        np.testing.assert_allclose(found.g, alone.g, rtol=1e-9, atol=1e-9 * np.abs(alone.g).max())
        assert astuple(found.stats) == pytest.approx(astuple(alone.stats), rel=1e-12)


@pytest.mark.parametrize('widen', [1.0, 4.0])
def test_pairs_are_as_likely_as_one_by_one(scene, widen):
    views, poses = scene
    beam = typical_beam(views[0])
    together = pair_likelihoods(ViewTable(views), poses, PAIRS, beam, CENTRE, widen)
    for (i, j), found in zip(PAIRS, together, strict=True):
        alone = pair_likelihood(views[i], poses[i], views[j], poses[j], beam, CENTRE, widen)
        for name in ('H', 'g', 'counts', 'nats', 'numbers'):
            expected = getattr(alone, name)
            tolerance = 1e-9 * float(np.abs(expected).max())
            np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-9, atol=tolerance)


def test_a_part_of_a_table_is_the_table_of_a_part(scene):
    views, poses = scene
    part = ViewTable(views).some([3, 1, 2])
    found = linearise_pairs(part, [poses[k] for k in (3, 1, 2)], [(0, 2), (2, 1)], GATE)
    there = linearise_pairs(ViewTable(views), poses, [(3, 2), (2, 1)], GATE)
    assert all(np.array_equal(a.H, b.H) for a, b in zip(found, there, strict=True))


def test_pairs_are_taken_by_the_image_that_is_projected_into():
    directions, order = both_directions([(3, 1), (2, 1), (3, 2)])
    assert directions.tolist() == [[1, 3], [1, 2], [2, 3], [3, 1], [2, 1], [3, 2]]
    assert directions[order][:, 1].tolist() == [1, 1, 2, 2, 3, 3]


def test_arrays_that_are_no_rows_in_memory_are_copied(recording):
    view = View(recording.views[0].frame)
    before = linearise_pairs(ViewTable([view, view]), [np.eye(4)] * 2, [(1, 0)], GATE)[0]
    view.points = np.asfortranarray(view.points)
    again = linearise_pairs(ViewTable([view, view]), [np.eye(4)] * 2, [(1, 0)], GATE)[0]
    np.testing.assert_array_equal(again.H, before.H)
