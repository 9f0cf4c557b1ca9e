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

"""The closed surface of a fused field: what nobody saw is filled, where it was not seen to be free.

A voxel is free if frames look through it at a surface behind, or past the target. Of all bodies that agree
with what was measured and what is free, the one with the smallest surface is taken, as a film of soap would
close the gaps. Its surface has no boundary, for the edge of the volume counts as free.
"""

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.frames import ClosedMesh, TargetFrame
from debris_scanner.core.geometry import Array, apply, inverse
from debris_scanner.core.optional import kernel
from debris_scanner.modelling.fusion import Volume, blurred, eroded, gaussian, zero_level

VIEWS = 50  # frames that are asked what is free
SURELY_FREE = 2  # frames that look through a voxel at a surface behind it, or past the target
DROPPED = 0.95  # of the voxels measured to be inside: past a free one more frames look than past these
ASKED_INSIDE = 20_000  # voxels that were measured
BLOCK = 4  # voxels, of which far from the surface one is asked
FAR_IN_FRONT = 2.0  # voxels from a surface, which are free
GOLDEN = 0.5 * (np.sqrt(5) - 1)
COARSEST = 8  # voxels along an edge, where filling begins
ROUNDS, FEWEST_ROUNDS = 200, 6  # of the dynamics there, and at any resolution
BLUR = 1.5  # voxels
SMOOTHED, SWEEPS = 3, 24  # voxels to each side of the surface that fills the gaps
SEEN, SEEN_SCALE = 0.7, 1.5  # share of measured voxels around a vertex that was seen; voxels around it
SPECK = 0.01  # share of the largest part's triangles; a boom has some, but next to no volume

_Flags = NDArray[np.bool_]


def close(volume: Volume, frames: Sequence[tuple[TargetFrame, Array]]) -> ClosedMesh | None:
    """Closed surface of a field, in metres; None if the field has no surface.

    Args:
        volume: that the frames were integrated into.
        frames: with their poses T_target_sensor (4, 4); some are asked what is free.
    """
    measured = volume.field()
    if measured is None:
        return None
    field, known = measured
    # at its rim a field says what a plane would, not what is there
    known = eroded(known)
    matter, held = known & (field < 0), known.copy()
    for axis in range(3):
        held.swapaxes(0, axis)[[0, -1]] = True  # the edge is free
    inside = _filled(matter, held | _free(volume, known, matter, frames))
    far = np.float32(volume.truncation)
    field = np.where(known, field, np.where(inside, -far, far))
    # harmonic near the surface that fills the gaps
    gap = _around(_interface(inside), held, SMOOTHED - 1, SMOOTHED - 1)
    for _ in range(SWEEPS):
        _sweep(field, gap)
    vertices, triangles, _ = zero_level(field)
    kept = _bodies(vertices, triangles)
    if not len(kept):
        return None
    # nearly each vertex is between two voxels
    ends = [np.ravel_multi_index(end(vertices).astype(int).T, known.shape) for end in (np.floor, np.ceil)]
    low, high = (blurred(known, end, gaussian(SEEN_SCALE, 2)) for end in ends)
    share = low + (vertices % 1).max(axis=1) * (high - low)
    vertices, triangles, observed = split(vertices, kept, share - SEEN)
    points = (vertices * volume.voxel + volume.origin).astype(np.float32)
    return ClosedMesh(points, triangles, observed)


def split(
    vertices: NDArray[np.floating], triangles: NDArray[np.int32], height: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.int32], _Flags]:
    """Cut a mesh where a height (m,), linear on each triangle, crosses zero.

    Returns:
        vertices (k, 3) that are used, triangles (t, 3), and which of them (t,) are above.
    """
    above = height > 0
    # each triangle turned so that the corner that is alone comes first; those not cut stay as they are
    count = above[triangles].sum(axis=1)
    alone = np.where(count == 1, above[triangles].argmax(axis=1), (~above[triangles]).argmax(axis=1))
    cut = (count == 1) | (count == 2)
    turned = np.take_along_axis(triangles, (alone[:, None] + np.arange(3)) % 3, axis=1)[cut]
    a, b, c = turned.T.astype(np.int64)
    ends = np.sort(np.concatenate([np.column_stack([a, b]), np.column_stack([a, c])]), axis=1)
    edges, index = np.unique(ends, axis=0, return_inverse=True)
    low, high = height[edges[:, 0]], height[edges[:, 1]]
    at = np.clip(low / np.where(low == high, 1.0, low - high), 0.02, 0.98)[:, None]
    crossings = (1 - at) * vertices[edges[:, 0]] + at * vertices[edges[:, 1]]
    ab, ac = np.split(index.reshape(-1) + len(vertices), 2)
    new = np.concatenate(
        [np.column_stack([a, ab, ac]), np.column_stack([ab, b, c]), np.column_stack([ab, c, ac])]
    )
    first = above[a]
    triangles = np.concatenate([triangles[~cut], new])
    observed = np.concatenate([count[~cut] == 3, first, ~first, ~first])
    used, index = np.unique(triangles, return_inverse=True)
    return np.concatenate([vertices, crossings])[used], index.reshape(-1, 3).astype(np.int32), observed


def open_mesh(mesh: ClosedMesh) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """What was seen of a closed mesh, without specks: indices (k,) of its vertices, and triangles (t, 3)."""
    triangles = mesh.triangles[mesh.observed]
    part = parts(triangles, len(mesh.vertices))
    sizes = np.bincount(part) if len(part) else np.zeros(1)
    used, index = np.unique(triangles[(sizes >= SPECK * sizes.max())[part]], return_inverse=True)
    return used.astype(np.int64), index.reshape(-1, 3).astype(np.int32)


def parts(triangles: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """Number (t,) of the connected part that each triangle belongs to."""
    corners = triangles.astype(np.int64)
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]])
    links = scipy.sparse.coo_matrix((np.ones(len(ends), np.int8), ends.T), shape=(vertices,) * 2)
    part = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    return np.asarray(part[corners[:, 0]], np.int32)


def _bodies(vertices: NDArray[np.floating], triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """The triangles (t, 3) of bodies: neither specks nor hollows inside."""
    if not len(triangles):
        return triangles
    part = parts(triangles, len(vertices))
    corners = vertices[triangles].astype(np.float64)
    volumes = np.bincount(part, np.linalg.det(corners) / 6)
    sizes = np.bincount(part)
    return triangles[((volumes > 0) & (sizes >= SPECK * sizes[volumes.argmax()]))[part]]


def _free(
    volume: Volume, known: _Flags, inside: _Flags, frames: Sequence[tuple[TargetFrame, Array]]
) -> _Flags:
    """Which voxels are free: each one near measured voxels is asked, of others one of each block.

    ``inside`` were measured to be so.
    """
    near = scipy.ndimage.binary_dilation(_in_blocks(known, BLOCK))
    fine = np.flatnonzero(_enlarged(near, BLOCK, known.shape) & ~known)
    coarse = np.flatnonzero(~near)
    unknown = np.concatenate(
        [_indices(fine, known.shape), _indices(coarse, near.shape) * BLOCK + (BLOCK - 1) / 2]
    )
    # pixels drop out: so many frames look past what is measured to be there
    measured = np.flatnonzero(inside)
    measured = _indices(measured[:: max(1, len(measured) // ASKED_INSIDE)], known.shape)
    votes, usual = (np.zeros((len(points), 3), np.uint16) for points in (unknown, measured))
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), VIEWS)).astype(int))
    # from all sides in turn, for most of what is free is found to be so by a few
    for n in chosen[np.argsort(np.arange(len(chosen)) * GOLDEN % 1)].tolist():
        frame, T_target_sensor = frames[n]
        T, c = inverse(T_target_sensor), frame.camera
        R, t = volume.voxel * T[:3, :3], apply(T, volume.origin)
        image = frame.depth_fit, frame.normals, (frame.depth > 0) | (frame.depth_fit > 0)
        pinhole = np.array([c.fx, c.fy, c.cx, c.cy])
        margin = FAR_IN_FRONT * volume.voxel
        _ask(unknown, R, t, pinhole, *image, margin, SURELY_FREE, votes)
        _ask(measured, R, t, pinhole, *image, margin, VIEWS + 1, usual)
    in_front, beside, _ = votes.T
    least = np.quantile(_past(usual), DROPPED) if len(usual) else 0.0
    found = (in_front >= SURELY_FREE) | ((beside >= SURELY_FREE) & (_past(votes) > least))
    free = np.zeros(near.shape, bool)
    free.flat[coarse] = found[len(fine) :]
    free = _enlarged(free, BLOCK, known.shape)
    free.flat[fine] = found[: len(fine)]
    return free


@kernel()
def _in_blocks(flags: _Flags, edge: int) -> _Flags:
    """Whether any voxel is set in each block; the last ones may be cut."""
    a, b, c = flags.shape
    out = np.zeros(((a - 1) // edge + 1, (b - 1) // edge + 1, (c - 1) // edge + 1), np.bool_)
    for i in range(a):
        for j in range(b):
            blocks = out[i // edge, j // edge]
            for k in range(c):
                blocks[k // edge] |= flags[i, j, k]
    return out


def _enlarged(flags: _Flags, edge: int, shape: tuple[int, ...]) -> _Flags:
    """Each block's flag at its voxels, in a volume of this shape."""
    for axis in range(3):
        flags = flags.repeat(edge, axis)
    return np.ascontiguousarray(flags[tuple(slice(n) for n in shape)])


def _past(votes: NDArray[np.uint16]) -> Array:
    """Share (n,) of the frames that look past a point, of those that see it beside the target or behind."""
    _, beside, behind = votes.T.astype(np.int64)
    return np.asarray(beside / np.maximum(beside + behind, 1))


@kernel()
def _indices(places: NDArray[np.intp], shape: tuple[int, int, int]) -> NDArray[np.float32]:
    """Indices (n, 3) of voxels by their flat ones (n,)."""
    _, b, c = shape
    out = np.empty((len(places), 3), np.float32)
    for n in range(len(places)):
        out[n, 0], out[n, 1], out[n, 2] = places[n] // (b * c), places[n] // c % b, places[n] % c
    return out


@kernel()
def _ask(
    points: NDArray[np.float32], R: Array, t: Array, intrinsics: Array, depth_fit: NDArray[np.float32],
    normals: NDArray[np.float32], on_target: _Flags, margin: float, enough: int, votes: NDArray[np.uint16],
) -> None:  # fmt: skip
    """Count for each point the frames that see it in front of a surface, beside the target, or behind.

    Points that enough frames see in front are not asked about any more.
    """
    fx, fy, cx, cy = intrinsics
    height, width = depth_fit.shape
    away = np.empty(depth_fit.shape)  # of each pixel's plane from the sensor
    for v in range(height):
        for u in range(width):
            n0, n1, n2 = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            away[v, u] = (n0 * (u - cx) / fx + n1 * (v - cy) / fy + n2) * depth_fit[v, u] + margin
    for i in range(len(points)):
        if votes[i, 0] >= enough:
            continue
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        z = R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2 + t[2]
        if z <= 0:
            continue
        x = R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2 + t[0]
        y = R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2 + t[1]
        near = 1 / z
        u, v = int(np.floor(x * near * fx + cx + 0.5)), int(np.floor(y * near * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        if depth_fit[v, u] > 0:
            along = normals[v, u, 0] * x + normals[v, u, 1] * y + normals[v, u, 2] * z
            votes[i, 0 if along > away[v, u] else 2] += 1
        elif not on_target[v, u]:
            votes[i, 1] += 1


def _filled(inside: _Flags, fixed: _Flags) -> _Flags:
    """Which voxels are inside: as given where fixed, elsewhere so that the surface is small.

    Threshold dynamics (Merriman, Bence, Osher 1992) from the coarsest resolution to the finest. In the
    beginning all that is not free is inside.
    """
    if min(inside.shape) <= COARSEST:
        guess = np.ones_like(inside)
        rounds = ROUNDS
    else:
        # a block with any matter in it is inside: walls and plates keep together
        guess = _filled(_in_blocks(inside & fixed, 2), _in_blocks(fixed, 2))
        guess = _enlarged(guess, 2, inside.shape)
        rounds = max(ROUNDS * COARSEST // min(inside.shape), FEWEST_ROUNDS)
    found, weights = np.where(fixed, inside, guess), gaussian(BLUR, 2)
    flat, reach = found.reshape(-1), len(weights) // 2
    changed = _interface(found)
    for _ in range(rounds):
        # elsewhere nothing is any other than in the round before
        places = _around(changed, fixed, reach, 3 * reach)
        changed = places[(blurred(found, places, weights) > 0.5) != flat[places]]
        if not len(changed):
            break
        flat[changed] = ~flat[changed]
    return found


@kernel()
def _interface(flags: _Flags) -> NDArray[np.intp]:
    """Voxels, by flat index, beside one that is unlike them."""
    a, b, c = flags.shape
    out = np.zeros(flags.shape, np.bool_)
    for i in range(a):
        for j in range(b):
            for k in range(c):
                here = flags[i, j, k]
                if i + 1 < a and flags[i + 1, j, k] != here:
                    out[i, j, k] = out[i + 1, j, k] = True
                if j + 1 < b and flags[i, j + 1, k] != here:
                    out[i, j, k] = out[i, j + 1, k] = True
                if k + 1 < c and flags[i, j, k + 1] != here:
                    out[i, j, k] = out[i, j, k + 1] = True
    return np.flatnonzero(out)


@kernel()
def _around(places: NDArray[np.intp], held: _Flags, reach: int, steps: int) -> NDArray[np.intp]:
    """Voxels that are not held, by flat index, near some: so far along each axis, in so many steps."""
    a, b, c = held.shape
    out = np.zeros(held.shape, np.bool_)
    for place in places:
        i, j, k = place // (b * c), place // c % b, place % c
        for x in range(max(0, i - reach), min(a, i + reach + 1)):
            for y in range(max(0, j - reach), min(b, j + reach + 1)):
                left = min(reach, steps - abs(x - i) - abs(y - j))
                for z in range(max(0, k - left), min(c, k + left + 1)):
                    out[x, y, z] = not held[x, y, z]
    return np.flatnonzero(out)


@kernel()
def _sweep(field: NDArray[np.float32], places: NDArray[np.intp]) -> None:
    """One sweep of Gauss and Seidel over voxels by flat index, none at the edge."""
    _, b, c = field.shape
    flat, sixth = field.ravel(), np.float32(1 / 6)
    for n in places:
        total = flat[n - b * c] + flat[n + b * c] + flat[n - c] + flat[n + c] + flat[n - 1] + flat[n + 1]
        flat[n] = total * sixth
