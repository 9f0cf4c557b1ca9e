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

"""Clouds made fit to be drawn."""

import numpy as np
import pytest

from debris_scanner.viewer.drawing import (
    GRAZED,
    WELL_SEEN,
    SeenCloud,
    borders_reached,
    by_direction,
    coverage_parts,
    depth_picture,
    drawn_in,
    frusta,
    lit,
    thinned,
)


@pytest.mark.parametrize(('count', 'most', 'left'), [(0, 10, 0), (10, 10, 10), (11, 10, 6), (1000, 7, 7)])
def test_thinned_leaves_at_most_so_many(count, most, left):
    assert len(np.arange(count)[thinned(count, most)]) == left <= most


def test_light_falls_on_what_faces_the_sensor():
    points = np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 1.0]], np.float32)
    normals = np.array([[0, 0, -1.0], [0.6, 0, -0.8], [1.0, 0, 0]], np.float32)
    shades = lit(points, normals, (200, 100, 0))
    assert shades.dtype == np.uint8
    assert shades[:, 0].tolist() == [200, 174, 70]
    assert shades[0].tolist() == [200, 100, 0]


def test_directions_differ_in_colour():
    colours = by_direction(np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32))
    assert len(np.unique(colours, axis=0)) == 6


def dome():
    """Vertices and triangles of the upper half of a ball of 0.1 m, open below."""
    azimuth = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rings = [
        np.stack([np.cos(azimuth) * np.cos(e), np.sin(azimuth) * np.cos(e), np.full(24, np.sin(e))], axis=1)
        for e in np.linspace(0, 1.4, 8)
    ]
    vertices = np.concatenate([*rings, [[0, 0, 1]]]).astype(np.float32) * np.float32(0.1)
    triangles = []
    for ring in range(7):
        for k in range(24):
            a, b = ring * 24 + k, ring * 24 + (k + 1) % 24
            triangles += [(a, b, b + 24), (a, b + 24, a + 24)]
    triangles += [(7 * 24 + k, 7 * 24 + (k + 1) % 24, 8 * 24) for k in range(24)]
    return vertices, np.array(triangles, np.int32)


def test_coverage_is_painted_by_the_best_line_of_sight_and_openings_have_a_rim():
    vertices, triangles = dome()
    above = np.float32([[0, 0, 1]])

    def colour_of(parts, triangle):
        return next(colour for colour, part in parts if (part == triangle).all(axis=1).any())

    parts, rims = coverage_parts(vertices, triangles, above)
    assert sum(len(part) for _, part in parts) == len(triangles)
    assert colour_of(parts, triangles[-1]) == WELL_SEEN
    assert colour_of(parts, triangles[0]) == GRAZED
    assert rims.shape == (24, 2, 3)
    assert np.allclose(rims[..., 2], 0)
    around, _ = coverage_parts(vertices, triangles, np.float32([[1, 0, 0], *above]))
    assert colour_of(around, triangles[0]) == WELL_SEEN
    assert colour_of(around, triangles[24]) == GRAZED
    assert coverage_parts(vertices, triangles, above[:0])[0][0][0] == WELL_SEEN


@pytest.mark.parametrize('radius', [0.05, 2.0])
def test_frusta_stay_near_the_target_and_look_at_it(radius):
    positions = np.float32([[0, 0, -20], [20, 0, 0], [0, 20, 0.1]]) * radius
    lines = frusta(positions, radius)
    assert lines.shape == (3 * 8, 2, 3)
    far = np.linalg.norm(lines, axis=2)
    assert far.max() < 2.1 * radius
    assert far.min() > 1.8 * radius
    directions = drawn_in(positions, radius) / (2 * radius)
    np.testing.assert_allclose(directions, positions / np.linalg.norm(positions, axis=1)[:, None], atol=1e-6)
    np.testing.assert_allclose(drawn_in(positions / 100, radius), positions / 100, rtol=1e-6)


def test_what_was_seen_is_thinned_to_a_grid_and_bounded():
    rng = np.random.default_rng(0)
    seen = SeenCloud()
    seen.add(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    for _ in range(3):
        points = rng.normal(size=(30_000, 3)).astype(np.float32)
        seen.add(points, by_direction(points))
    assert len(seen.points) == len(seen.colours) <= 40_000
    again = len(seen.points)
    seen.add(seen.points.copy(), seen.colours.copy())
    assert len(seen.points) == again


def test_a_window_beyond_the_image_is_cut():
    depth = np.ones((10, 10), np.float32)
    picture = depth_picture(depth, (-5, 75), (60, 80))
    assert picture.shape == (60, 80, 3)
    assert np.argwhere(picture.max(axis=2) > 34).tolist() == [[v, u] for v in range(5) for u in range(75, 80)]
    assert depth_picture(depth, (0, 0), (960, 1280)).shape[1] <= 240
    assert borders_reached(depth, (20, 20), (60, 80)) == set()
    assert borders_reached(depth, (50, 70), (60, 80)) == {'bottom', 'right'}
