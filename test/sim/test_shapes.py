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

from debris_scanner.sim.shapes import (
    box,
    dome,
    extrude,
    join,
    lathe,
    loft,
    mirror_x,
    outward,
    place,
    rod,
    sphere,
    volume,
)


def edges_are_shared_once_each_way(solid):
    """Closed and consistently oriented: every directed edge has exactly its opposite."""
    _, triangles = solid
    directed = [tuple(t[[i, (i + 1) % 3]]) for t in triangles for i in range(3)]
    return len(set(directed)) == len(directed) and {(b, a) for a, b in directed} == set(directed)


SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])

SOLIDS = {
    'box': (box((1, 2, 3)), 6.0),
    'lathe': (lathe([(0, 0), (1, 0), (1, 2), (0, 2)], 256), 2 * np.pi),
    'cone with tips': (lathe([(0, -1), (1, 0), (0, 1)], 256), 2 * np.pi / 3),
    'open ends': (lathe([(1, 0), (1, 2)], 256), 2 * np.pi),
    'dome': (lathe([*reversed(dome(1.0, -1.0, 0.0, 64)), *dome(1.0, 1.0, 0.0, 64)[1:]], 256), 4 / 3 * np.pi),
    'extrusion along x': (extrude(SQUARE, -1, 2, axis=0), 6.0),
    'extrusion along y': (extrude(SQUARE, -1, 2, axis=1), 6.0),
    'rod': (rod((0, 0, 0), (1, 1, 1), 0.1, 128), np.sqrt(3) * np.pi * 0.01),
    'sphere': (sphere(5), 4 / 3 * np.pi),
    'mirrored': (mirror_x(place(box((1, 1, 1)), (3, 0, 0))), 1.0),
}


@pytest.mark.parametrize('name', SOLIDS)
def test_solids_are_closed_face_outwards_and_have_their_volume(name):
    solid, expected = SOLIDS[name]
    assert edges_are_shared_once_each_way(solid)
    assert volume(solid) == pytest.approx(expected, rel=3e-3)


def test_inside_out_solids_are_turned():
    vertices, triangles = box((1, 1, 1))
    assert volume((vertices, triangles[:, ::-1])) == pytest.approx(-1)
    assert volume(outward((vertices, triangles[:, ::-1]))) == pytest.approx(1)


def test_joining_keeps_every_solid_where_it_is():
    vertices, triangles = join([box((1, 1, 1)), box((1, 1, 1), (5, 0, 0))])
    assert volume((vertices, triangles)) == pytest.approx(2)
    assert vertices[:, 0].max() == pytest.approx(5.5)


def test_outlines_that_hide_a_corner_are_refused():
    angle = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 1.0], [1.0, 1.0], [1.0, 9.0], [0.0, 9.0]])
    with pytest.raises(ValueError, match='star-shaped'):
        extrude(angle, 0, 1)


def test_a_loft_goes_through_its_rings():
    ring = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, -1.0, 0]])
    vertices, _ = loft(np.stack([ring, 2 * ring + [0, 0, 1.0]]))
    assert {tuple(v) for v in ring} <= {tuple(v) for v in vertices}
