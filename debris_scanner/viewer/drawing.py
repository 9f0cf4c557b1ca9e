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

"""What is drawn: clouds thinned and shaded, coverage painted, key frames as frusta, depth as a picture."""

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
Colours = NDArray[np.uint8]

TARGET_COLOUR = (255, 176, 64)
_DARKEST = 0.35  # brightness of a surface seen edge-on
SEEN_COLOUR = (90, 150, 235)
WELL_SEEN, GRAZED = (120, 190, 130), (240, 230, 110)
_STRAIGHT, _GRAZING = np.cos(np.radians(40)), np.cos(np.radians(75))  # of normal and line of sight
_LEVELS = 3  # of coverage
_RING, _FRUSTUM = 2.0, 0.07  # of the target's radius: where frusta stand, and their size
_CORNERS = ((-0.6, -0.45), (0.6, -0.45), (0.6, 0.45), (-0.6, 0.45))  # of a frustum, of its length
_CELLS = 60  # of the target's radius: grid of what was seen
MOST_SEEN = 40_000  # points of it
PICTURE = 240  # pixels of the longer side of a thumbnail, at most
_NEAR, _FAR = (255, 214, 130), (92, 48, 110)
_BORDER = 3  # pixels: what is nearer to the border of the image may go on beyond it


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


def extent_of(points: Points) -> float:
    """Half of the diagonal of the box around points (n, 3); 0 for none. Metres, of what is not an outlier."""
    if not len(points):
        return 0.0
    low, high = np.percentile(points, (2, 98), axis=0)
    return float(np.linalg.norm(high - low) / 2)


def coverage_parts(
    vertices: Points, triangles: NDArray[np.int32], sensors: Points
) -> tuple[list[tuple[tuple[int, int, int], NDArray[np.int32]]], NDArray[np.float32]]:
    """What of a surface was seen how well, in three steps, as a mesh of the page has one colour.

    Args:
        vertices: (m, 3), metres, target frame.
        triangles: (t, 3), normals outward.
        sensors: (k, 3), where the sensor stood at the key frames.

    Returns:
        Colour and triangles (t', 3) of each part with triangles, by the least angle between normal and line
        of sight; and the edges (n, 2, 3) of the surface's openings.
    """
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_vertex = np.zeros(vertices.shape, np.float64)
    for column in range(3):
        np.add.at(at_vertex, triangles[:, column], normals)
    at_vertex /= np.maximum(np.linalg.norm(at_vertex, axis=1), 1e-12)[:, None]
    best = np.full(len(vertices), -1.0)
    for sensor in sensors:
        sight = sensor - vertices
        cosine = np.einsum('ij,ij->i', at_vertex, sight) / np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
        best = np.maximum(best, cosine)
    share = np.clip((best - _GRAZING) / (_STRAIGHT - _GRAZING), 0, 1) if len(sensors) else best * 0 + 1
    level = np.rint((_LEVELS - 1) * share[triangles].mean(axis=1)).astype(int)
    parts = []
    for k in range(_LEVELS):
        mixed = np.rint(np.array(GRAZED) + (np.array(WELL_SEEN) - np.array(GRAZED)) * k / (_LEVELS - 1))
        if (level == k).any():
            parts.append(((int(mixed[0]), int(mixed[1]), int(mixed[2])), triangles[level == k]))
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    alone, times = np.unique(edges, axis=0, return_counts=True)
    return parts, vertices[alone[times == 1]]


def frusta(positions: Points, radius: float) -> NDArray[np.float32]:
    """Lines (n, 2, 3) of a small pyramid a key frame, which looks at the target.

    Args:
        positions: (k, 3) of the sensor, target frame.
        radius: of the target, metres. The pyramids stand on a sphere around it, in the direction of the
            sensor and not as far away: so they neither dwarf nor leave the picture.
    """
    size = radius * _FRUSTUM
    at = drawn_in(positions, radius)
    inward = -at / np.maximum(np.linalg.norm(at, axis=1), 1e-9)[:, None]
    helper = np.where(np.abs(inward[:, [1]]) < 0.9, np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]))
    right = np.cross(helper, inward)
    right /= np.maximum(np.linalg.norm(right, axis=1), 1e-9)[:, None]
    down = np.cross(inward, right)
    corners = [at + size * (inward + x * right + y * down) for x, y in _CORNERS]
    lines = [(at, corner) for corner in corners]
    lines += [(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    return np.concatenate([np.stack(line, axis=1) for line in lines]).astype(np.float32)


def drawn_in(positions: Points, radius: float) -> Points:
    """Positions (..., 3) moved along their directions on to the sphere of the frusta; radius 0: unchanged."""
    far = np.linalg.norm(positions, axis=-1, keepdims=True)
    near = np.minimum(far, _RING * radius if radius > 0 else far)
    return np.asarray(positions * (near / np.maximum(far, 1e-9)), np.float32)


class SeenCloud:
    """All that key frames have shown, thinned to a grid; target frame, metres."""

    def __init__(self) -> None:
        self.points: Points = np.zeros((0, 3), np.float32)
        self.colours: Colours = np.zeros((0, 3), np.uint8)
        self._cell = 0.0

    def add(self, points: Points, colours: Colours) -> None:
        """Add points (n, 3) with colours (n, 3); those in a cell that is taken are dropped."""
        if not len(points):
            return
        self._cell = self._cell or extent_of(points) / _CELLS
        points = np.concatenate([self.points, points])
        colours = np.concatenate([self.colours, colours])
        cells = np.floor(points / max(self._cell, 1e-6)).astype(np.int64)
        kept = np.sort(np.unique(cells, axis=0, return_index=True)[1])[:MOST_SEEN]
        self.points, self.colours = points[kept], colours[kept]


def depth_picture(
    depth: NDArray[np.float32], corner: tuple[int, int], shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """Picture (h, w, 3) of the target's depth where it is in the image; near is bright.

    Args:
        depth: (h, w) of a window, metres, 0 or NaN where there is none.
        corner: row and column of the window's first pixel in the image; may be negative.
        shape: rows and columns of the image.
    """
    step = max(1, -(-max(shape) // PICTURE))
    whole = np.zeros(shape, np.float32)
    top, left = corner
    v0, u0 = max(top, 0), max(left, 0)
    v1, u1 = min(top + depth.shape[0], shape[0]), min(left + depth.shape[1], shape[1])
    if v1 > v0 and u1 > u0:
        whole[v0:v1, u0:u1] = np.nan_to_num(depth[v0 - top : v1 - top, u0 - left : u1 - left])
    small = whole[::step, ::step]
    seen = small > 0
    picture = np.full((*small.shape, 3), 34, np.uint8)
    if seen.any():
        low, high = np.percentile(small[seen], (2, 98))
        share = np.clip((high - small[seen]) / max(high - low, 1e-6), 0, 1)[:, None]
        picture[seen] = np.rint((1 - share) * np.array(_FAR) + share * np.array(_NEAR)).astype(np.uint8)
    return picture


def borders_reached(
    depth: NDArray[np.float32], corner: tuple[int, int], shape: tuple[int, int]
) -> frozenset[str]:
    """Borders of the image that the target reaches; arguments as of :func:`depth_picture`."""
    v, u = np.nonzero(np.nan_to_num(depth) > 0)
    if not len(v):
        return frozenset()
    v, u = v + corner[0], u + corner[1]
    within = {
        'top': v.min() < _BORDER,
        'left': u.min() < _BORDER,
        'bottom': v.max() >= shape[0] - _BORDER,
        'right': u.max() >= shape[1] - _BORDER,
    }
    return frozenset(name for name, reached in within.items() if reached)
