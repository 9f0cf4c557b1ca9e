"""Clouds made fit to be drawn."""

import numpy as np
import pytest

from debris_scanner.viewer.drawing import by_direction, lit, thinned


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
