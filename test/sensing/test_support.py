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

"""Planes that things stand on: found among other points, told from things that stand on them."""

import numpy as np
import pytest

from debris_scanner.sensing.support import SupportPlanes, heights

NOISE = 0.002


def held(support, points, tolerance):
    """Which points lie in one of its planes, as where the target is isolated."""
    near = np.zeros(len(points), bool)
    for *plane, uneven in support.uneven_planes:
        near |= np.abs(heights(points, np.array(plane))) < uneven * tolerance
    return near


def plane(normal, offset, count, rng):
    """Points (n, 3) of a noisy plane n x = offset, about 1 m in front."""
    n = np.array(normal) / np.linalg.norm(normal)
    points = rng.uniform([-0.8, -0.8, 0.5], [0.8, 0.8, 1.5], (count, 3))
    return points - ((points @ n - offset) + rng.normal(0, NOISE, count))[:, None] * n


@pytest.fixture
def rng():
    return np.random.default_rng(1)


LEAST, SPECK = 100, 40


def learnt(points, inside=0):
    """Planes of points, of which the last ``inside`` do not lie where the view ends."""
    support = SupportPlanes()
    out = np.arange(len(points)) < len(points) - inside
    support.learn(points, points, np.full(len(points), 4 * NOISE), out, LEAST, SPECK)
    return support


def test_a_desk_and_a_wall_are_found(rng):
    desk, wall = plane((0, 0.86, 0.5), 0.5, 4000, rng), plane((0, 0, 1), 1.2, 3000, rng)
    mug = rng.uniform([0.0, -0.1, 0.8], [0.1, 0.0, 0.9], (800, 3))
    support = learnt(np.concatenate([desk, wall, mug]), inside=len(mug))
    assert len(support.planes) == 2
    for points, normal, offset in ((desk, (0, 0.86, 0.5), 0.5), (wall, (0, 0, 1), 1.2)):
        assert held(support, points, np.full(len(points), 4 * NOISE)).mean() > 0.99
        n = np.array(normal) / np.linalg.norm(normal)
        best = max(support.planes, key=lambda p: abs(p[:3] @ n))
        assert abs(best[:3] @ n) > 0.9999
        assert abs(abs(best[3]) - offset) < 0.002
    assert held(support, mug, np.full(len(mug), 4 * NOISE)).mean() < 0.2


def test_a_strip_of_desk_before_a_large_wall_is_found(rng):
    """A twentieth of what stands still, but a third of the image's edge."""
    wall, desk = plane((0, 0, 1), 1.2, 9500, rng), plane((0, 0.86, 0.5), 0.5, 500, rng)
    support = learnt(np.concatenate([wall, desk]))
    for points in (wall, desk):
        assert held(support, points, np.full(len(points), 4 * NOISE)).mean() > 0.99


def test_a_face_of_a_box_reaches_nowhere_and_is_no_support(rng):
    wall, face = plane((0, 0, 1), 1.2, 5000, rng), plane((1, 0, 1), 0.6, 4000, rng)
    support = learnt(np.concatenate([wall, face]), inside=len(face))
    assert len(support.planes) == 1
    assert held(support, face, np.full(len(face), 4 * NOISE)).mean() < 0.1


def test_a_wall_is_held_with_its_unevenness(rng):
    """A real sensor measures bands of a flat wall; what stands out of them is on it."""
    wall = plane((0, 0, 1), 1.2, 8000, rng)
    bands = wall[:, 1] % 0.2 < 0.02
    wall[bands, 2] += 6 * NOISE
    poster = rng.uniform([-0.1, -0.1, 1.2 - 20 * NOISE], [0.1, 0.1, 1.2 - 16 * NOISE], (300, 3))
    support, tolerance = learnt(np.concatenate([wall, poster]), inside=len(poster)), 4 * NOISE
    assert held(support, wall, np.full(len(wall), tolerance)).mean() > 0.98
    assert not held(support, poster, np.full(len(poster), tolerance)).any()
    even = plane((0, 0, 1), 1.2, 8000, rng)
    bump = even + [0, 0, -6 * NOISE]
    assert not held(learnt(even), bump, np.full(len(bump), tolerance)).mean() > 0.2


def test_hardly_a_point_of_a_noisy_wall_stands_out(rng):
    """Its noise is 0.4 of what is taken for noise: one point in a hundred lay beyond."""
    wall = plane((0, 0, 1), 1.2, 200_000, rng)
    support, tolerance = SupportPlanes(), np.full(len(wall), 2.5 * NOISE)
    support.learn(wall, wall, tolerance, np.ones(len(wall), np.bool_), LEAST, SPECK)
    again = plane((0, 0, 1), 1.2, 200_000, rng)
    assert np.count_nonzero(~held(support, again, tolerance)) < 2 * SPECK


def test_a_wall_that_is_hidden_meanwhile_is_held(rng):
    wall = plane((0, 0, 1), 1.2, 5000, rng)
    support, tolerance = SupportPlanes(), np.full(len(wall), 4 * NOISE)
    support.learn(wall, wall * 0.5, tolerance, np.ones(len(wall), np.bool_), LEAST, SPECK)
    assert held(support, wall, tolerance).mean() > 0.99


def test_what_is_round_has_no_plane(rng):
    v = rng.normal(size=(3000, 3))
    sphere = [0, 0, 1] + 0.2 * v / np.linalg.norm(v, axis=1)[:, None]
    assert len(learnt(sphere, inside=3000).planes) == 0
    assert not held(learnt(sphere, inside=3000), sphere, np.full(len(sphere), 0.01)).any()


def test_nothing_has_no_plane():
    assert len(learnt(np.zeros((0, 3))).planes) == 0


def test_heights_are_distances():
    assert heights(np.array([[0.0, 0.0, 3.0], [1.0, 1.0, 1.0]]), np.array([0.0, 0.0, 1.0, -1.0])) == (
        pytest.approx([2.0, 0.0])
    )
