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

"""The rim of a view: where the target ends in the image, and which parts of that are edges of the target.

It gives two kinds of evidence. Any point of the target projects inside the silhouette of every view
(visual hull). And where a face ends while it still faces the sensor, the rim is a line on the target itself,
by which two views can be registered; without it nothing constrains a flat face sideways.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.sensing.silhouette import blurred, eroded, open_sides

Image = NDArray[np.float32]

INSET_PX = 0.8  # the outermost pixel that still returns lies this far inside the true outline
MIN_EDGE_COS = 0.7  # at an edge the face still faces the sensor; a rounded side ends where it turns away
FLAT_REACH_PX = 5  # at an edge the face is flat for this far inwards
FLAT_COS = 0.975
MAX_STEP = 2.7  # px: a rim pixel further off its face belongs to a sliver of the next one
OUTLINE_BLUR_PX = 1.5
DIRECTED = 0.9  # squared length of a direction, which is 1, or next to 0 where there is none
MOST_EDGES = 65535  # pixels, of one image


@dataclass
class Rim:
    """Points (n, 3) on a surface that must project inside another view's silhouette, with their normals.

    ``edge`` (n,) is 1 for points on an edge of the target, which other views' silhouettes show as well.
    """

    points: Image
    normals: Image
    edge: NDArray[np.uint8]


@dataclass
class Edges:
    """The target's edges in an image: its edge pixels, and the direction out of the target at each.

    ``index`` (h, w) counts the edge pixels from 1, and is 0 elsewhere; ``outward`` (n + 1, 2) holds nothing
    first, then their unit directions, columns and rows.
    """

    index: NDArray[np.uint16]
    outward: Image


NO_EDGES = Edges(np.zeros((1, 1), np.uint16), np.zeros((1, 2), np.float32))


def find_rim(frame: TargetFrame, intrinsics: Array, closed: NDArray[np.bool_]) -> tuple[Rim, Edges]:
    """The rim of a frame, view frame, and the target's edges in its image.

    Args:
        frame: the target.
        intrinsics: fx, fy, cx, cy.
        closed: the silhouette (h, w), small holes closed.

    Returns:
        Every other rim pixel as a point; and the edges.
    """
    left, right, above, below = open_sides(closed)
    h, w = closed.shape
    inside = eroded(closed, 1)
    # the image ends there, not the target
    inside[: int(above)] = inside[h - below :] = inside[:, : int(left)] = inside[:, w - right :] = True
    v, u = np.nonzero((frame.depth_fit > 0) & closed & ~inside)
    outward = _outward(closed, v, u)
    # out of the middle of a panel one pixel wide no direction leads
    edge = _on_edge(frame, intrinsics, v, u, outward) & ((outward**2).sum(axis=1) > DIRECTED)
    counted = np.flatnonzero(edge)[:MOST_EDGES]
    index = np.zeros(closed.shape, np.uint16)
    index[v[counted], u[counted]] = np.arange(1, len(counted) + 1)
    edges = Edges(index, np.concatenate([np.zeros((1, 2), np.float32), outward[counted]]))
    every = slice(None, None, 2)
    points = _moved_out(frame, intrinsics, v[every], u[every], outward[every])
    return Rim(points, frame.normals[v[every], u[every]], edge[every].astype(np.uint8)), edges


@dataclass
class EdgePoints:
    """Points (n, 3) at which a face ends, its normals there, and the unit directions in it that lead out."""

    points: Image
    normals: Image
    outward: Image


def edge_points(frame: TargetFrame, intrinsics: Array, edges: Edges) -> EdgePoints:
    """Every other edge pixel of a frame as a point, view frame."""
    v, u = (a[::2] for a in np.nonzero(edges.index))
    outward = edges.outward[edges.index[v, u]]
    points = _moved_out(frame, intrinsics, v, u, outward)
    fx, fy, cx, cy = intrinsics
    ray = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(len(u))], axis=1)
    along = points - ray * frame.depth_fit[v, u][:, None]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    return EdgePoints(points, frame.normals[v, u], np.asarray(along / np.maximum(length, 1e-12), np.float32))


def _outward(closed: NDArray[np.bool_], v: NDArray[np.intp], u: NDArray[np.intp]) -> Image:
    """Unit direction (n, 2), columns then rows, out of the mask at the pixels v, u."""
    h, w = closed.shape
    outline = blurred(closed, OUTLINE_BLUR_PX)
    above, below = np.maximum(v - 1, 0), np.minimum(v + 1, h - 1)
    left, right = np.maximum(u - 1, 0), np.minimum(u + 1, w - 1)
    rows, columns = (np.maximum(n, 1).astype(np.float32) for n in (below - above, right - left))
    down = (outline[below, u] - outline[above, u]) / rows
    across = (outline[v, right] - outline[v, left]) / columns
    direction = -np.stack([across, down], axis=-1)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction / np.maximum(length, 1e-6), np.float32)


def _on_edge(
    frame: TargetFrame, intrinsics: Array, v: NDArray[np.intp], u: NDArray[np.intp], outward: Image
) -> NDArray[np.bool_]:
    """Which rim pixels (n,) end a face that faces the sensor and is flat up to there."""
    fx, fy, cx, cy = intrinsics
    h, w = frame.depth.shape
    v_in = np.clip(np.rint(v - FLAT_REACH_PX * outward[:, 1]).astype(int), 0, h - 1)
    u_in = np.clip(np.rint(u - FLAT_REACH_PX * outward[:, 0]).astype(int), 0, w - 1)
    n = frame.normals[v, u]
    flat = (frame.normals[v_in, u_in] * n).sum(axis=1) > FLAT_COS
    level = np.abs(frame.depth[v, u] - frame.depth_fit[v, u]) < MAX_STEP * frame.footprint
    ray = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(len(u))], axis=1)
    facing = -(n * ray).sum(axis=1) > MIN_EDGE_COS * np.linalg.norm(ray, axis=1)
    return np.asarray(flat & level & facing)


def _moved_out(
    frame: TargetFrame, intrinsics: Array, v: NDArray[np.intp], u: NDArray[np.intp], outward: Image
) -> Image:
    """Rim points (n, 3) moved along their face to the true outline.

    Unmoved, they would lie inside it, oblique ones more, and the motion of every pair would be overestimated.
    """
    fx, fy, cx, cy = intrinsics
    n = frame.normals[v, u]
    ray = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(len(u))], axis=1)
    out = ray.copy()
    out[:, :2] += INSET_PX * outward / (fx, fy)
    level = (n * ray).sum(axis=1) * frame.depth_fit[v, u]
    return np.asarray(out * (level / np.minimum((n * out).sum(axis=1), -0.1))[:, None], np.float32)
