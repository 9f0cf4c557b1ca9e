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

"""Closed triangle meshes of simple solids, the building blocks of the simulated targets.

A solid is a pair ``(vertices (n, 3) float64, triangles (t, 3) int32)``, watertight, its triangles
counter-clockwise seen from outside. Lengths are in whatever unit the caller builds in.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array

Solid = tuple[Array, NDArray[np.int32]]

# Rings thinner than this share of the loft's size close in a point.
_POINT_RING = 1e-9
# Longest triangles of a lathe, in segment widths.
_NEEDLE = 8.0


def volume(solid: Solid) -> float:
    """Signed volume: positive when the triangles of a closed mesh face outwards."""
    corners = solid[0][solid[1]]
    return float(np.einsum('ij,ij->', corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def outward(solid: Solid) -> Solid:
    """The same closed solid with its triangles turned to face outwards."""
    vertices, triangles = solid
    return (vertices, triangles) if volume(solid) >= 0 else (vertices, triangles[:, ::-1].copy())


def join(solids: Sequence[Solid]) -> Solid:
    """One mesh of several solids; where they overlap, both surfaces stay."""
    vertices, triangles, first = [], [], 0
    for points, faces in solids:
        vertices.append(points)
        triangles.append(faces + np.int32(first))
        first += len(points)
    return np.concatenate(vertices), np.concatenate(triangles).astype(np.int32)


def place(solid: Solid, offset: Sequence[float], R: Array | None = None) -> Solid:
    """The solid turned by R (3, 3) about the origin, then shifted by offset (3,)."""
    turned = solid[0] if R is None else solid[0] @ R.T
    return turned + np.asarray(offset, np.float64), solid[1]


def mirror_x(solid: Solid) -> Solid:
    """The solid's mirror image in the plane x = 0, still facing outwards."""
    return solid[0] * np.array([-1.0, 1.0, 1.0]), solid[1][:, ::-1].copy()


def loft(rings: Array) -> Solid:
    """Solid through rings (k, m, 3) of m corresponding points each, closed by flat fans at both ends.

    A first or last ring whose points all coincide becomes a tip instead.
    """
    count, size = rings.shape[:2]
    scale = float(np.ptp(rings.reshape(-1, 3), axis=0).max())
    points: list[Array] = []
    faces: list[tuple[int, int, int]] = []
    starts: list[tuple[int, bool]] = []  # first vertex of each ring, and whether it is a single tip
    total = 0
    for k, ring in enumerate(rings):
        tip = k in (0, count - 1) and float(np.ptp(ring, axis=0).max()) < _POINT_RING * scale
        starts.append((total, tip))
        points.append(ring[:1] if tip else ring)
        total += 1 if tip else size
    for (a, a_tip), (b, b_tip) in pairwise(starts):
        for i in range(size):
            j = (i + 1) % size
            if not a_tip:
                faces.append((a + i, a + j, b if b_tip else b + j))
            if not b_tip:
                faces.append((a if a_tip else a + i, b + j, b + i))
    for (start, tip), ring, flip in ((starts[0], rings[0], True), (starts[-1], rings[-1], False)):
        if tip:
            continue
        points.append(ring.mean(axis=0, keepdims=True))
        for i in range(size):
            j = (i + 1) % size
            faces.append((total, start + j, start + i) if flip else (total, start + i, start + j))
        total += 1
    return outward((np.concatenate(points), np.array(faces, np.int32)))


def lathe(profile: Sequence[tuple[float, float]], segments: int = 64) -> Solid:
    """Body of revolution about z through (radius, z) pairs; a first or last radius of 0 makes a tip."""
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(segments)], axis=-1)
    # rings so close that no triangle is a needle: single precision picks the wrong nearest among needles
    widest = max(r for r, _ in profile) * 2 * np.pi / segments
    stations = [profile[0]]
    for (r0, z0), (r1, z1) in pairwise(profile):
        parts = max(1, int(np.ceil(np.hypot(r1 - r0, z1 - z0) / (_NEEDLE * widest))))
        stations += [(r0 + (r1 - r0) * k / parts, z0 + (z1 - z0) * k / parts) for k in range(1, parts + 1)]
    return loft(np.stack([circle * r + np.array([0.0, 0.0, z]) for r, z in stations]))


def dome(radius: float, height: float, z: float, steps: int = 8) -> list[tuple[float, float]]:
    """Profile of an elliptic cap from its rim at z to its tip at z + height (height may be negative)."""
    angle = np.linspace(0.0, np.pi / 2, steps + 1)
    pairs = [(radius * float(np.cos(a)), z + height * float(np.sin(a))) for a in angle]
    return [*pairs[:-1], (0.0, z + height)]


def box(size: Sequence[float], centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Solid:
    """Box with edges of the given lengths along x, y and z."""
    half = np.asarray(size, np.float64) / 2
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64) * half[:2]
    rings = np.stack([np.column_stack([corner, np.full(4, z)]) for z in (-half[2], half[2])])
    return place(loft(rings), centre)


def extrude(outline: Array, low: float, high: float, axis: int = 2) -> Solid:
    """Plate between low and high along axis, of an outline (m, 2) in the other two axes.

    Raises:
        ValueError: part of the outline cannot be seen from the mean of its corners.
    """
    spokes = outline - outline.mean(axis=0)
    ahead = np.roll(spokes, -1, axis=0)
    turning = spokes[:, 0] * ahead[:, 1] - spokes[:, 1] * ahead[:, 0]
    if not (np.all(turning > 0) or np.all(turning < 0)):
        raise ValueError('the outline is not star-shaped about the mean of its corners')
    others = [i for i in range(3) if i != axis]
    rings = np.zeros((2, len(outline), 3))
    rings[:, :, others] = outline
    rings[0, :, axis], rings[1, :, axis] = low, high
    return loft(rings)


def rod(start: Sequence[float], end: Sequence[float], radius: float, segments: int = 16) -> Solid:
    """Round rod between two points."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    side /= np.linalg.norm(side)
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    circle = radius * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(along, side))
    return loft(np.stack([circle + a, circle + b]))


def sphere(subdivisions: int = 4) -> Solid:
    """Unit sphere made of an octahedron whose triangles were split evenly ``subdivisions`` times."""
    vertices = [tuple(v) for v in np.concatenate([np.eye(3), -np.eye(3)])]
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    for _ in range(subdivisions):
        middle: dict[tuple[int, int], int] = {}

        def between(i: int, j: int, known: dict[tuple[int, int], int] = middle) -> int:
            key = (min(i, j), max(i, j))
            if key not in known:
                known[key] = len(vertices)
                m = np.add(vertices[i], vertices[j])
                vertices.append(tuple(m / np.linalg.norm(m)))
            return known[key]

        split = []
        for a, b, c in faces:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            split += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = split
    return outward((np.array(vertices, np.float64), np.array(faces, np.int32)))


def bumpy_sphere(rng: np.random.Generator, bumps: int, widths: tuple[float, float]) -> Solid:
    """About a unit sphere, with smooth bumps and craters whose widths, rad, are drawn between two bounds."""
    vertices, triangles = sphere(5)
    centres = rng.normal(size=(bumps, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    width = rng.uniform(*widths, bumps)
    heights = rng.normal(0.0, 0.4, bumps) * width
    distance = np.linalg.norm(vertices[:, None] - centres, axis=2)
    radius = 1.0 + (heights * np.exp(-0.5 * (distance / width) ** 2)).sum(axis=1)
    return vertices * radius[:, None], triangles
