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
