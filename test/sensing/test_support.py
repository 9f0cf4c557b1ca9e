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


def plane(normal, offset, count, rng):
    """Points (n, 3) of a noisy plane n x = offset, about 1 m in front."""
    n = np.array(normal) / np.linalg.norm(normal)
    points = rng.uniform([-0.8, -0.8, 0.5], [0.8, 0.8, 1.5], (count, 3))
    return points - ((points @ n - offset) + rng.normal(0, NOISE, count))[:, None] * n


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def learnt(points):
    support = SupportPlanes()
    support.learn(points, np.full(len(points), 4 * NOISE))
    return support


def test_a_desk_and_a_wall_are_found(rng):
    desk, wall = plane((0, 0.86, 0.5), 0.5, 4000, rng), plane((0, 0, 1), 1.2, 3000, rng)
    mug = rng.uniform([0.0, -0.1, 0.8], [0.1, 0.0, 0.9], (800, 3))
    support = learnt(np.concatenate([desk, wall, mug]))
    assert len(support.planes) == 2
    for points, normal, offset in ((desk, (0, 0.86, 0.5), 0.5), (wall, (0, 0, 1), 1.2)):
        assert support.hold(points, np.full(len(points), 4 * NOISE)).mean() > 0.99
        n = np.array(normal) / np.linalg.norm(normal)
        best = max(support.planes, key=lambda p: abs(p[:3] @ n))
        assert abs(best[:3] @ n) > 0.9999
        assert abs(abs(best[3]) - offset) < 0.002
    assert support.hold(mug, np.full(len(mug), 4 * NOISE)).mean() < 0.2


def test_what_is_round_has_no_plane(rng):
    v = rng.normal(size=(3000, 3))
    sphere = [0, 0, 1] + 0.2 * v / np.linalg.norm(v, axis=1)[:, None]
    assert len(learnt(sphere).planes) == 0
    assert not learnt(sphere).hold(sphere, np.full(len(sphere), 0.01)).any()


def test_nothing_has_no_plane():
    assert len(learnt(np.zeros((0, 3))).planes) == 0


def test_heights_are_distances():
    assert heights(np.array([[0.0, 0.0, 3.0], [1.0, 1.0, 1.0]]), np.array([0.0, 0.0, 1.0, -1.0])) == (
        pytest.approx([2.0, 0.0])
    )
