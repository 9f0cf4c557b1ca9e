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

"""Clouds prepared for drawing: thinned if too large, shaded if without colour."""

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
Colours = NDArray[np.uint8]

TARGET_COLOUR = (255, 176, 64)
_DARKEST = 0.35  # brightness of a surface seen edge-on


def thinned(count: int, most: int) -> slice:
    """Every n-th of ``count``, so that at most ``most`` remain."""
    return slice(None, None, max(1, -(-count // most)))


def lit(points: Points, normals: Points, colour: tuple[int, int, int] = TARGET_COLOUR) -> Colours:
    """Colours (n, 3) of a surface lit by a lamp at the origin.

    Args:
        points: (n, 3), none of them at the origin.
        normals: (n, 3), unit, or 0 where unknown.
        colour: where it faces the lamp.
    """
    distance = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
    facing = np.abs(np.einsum('ij,ij->i', points, normals)) / distance
    shade = _DARKEST + (1 - _DARKEST) * np.clip(facing, 0, 1)
    return np.asarray(np.rint(shade[:, None] * np.array(colour)), np.uint8)


def by_direction(normals: Points) -> Colours:
    """Colours (n, 3) that encode the directions of normals (n, 3)."""
    return np.asarray(np.rint((np.clip(normals, -1, 1) * 0.5 + 0.5) * 255), np.uint8)
