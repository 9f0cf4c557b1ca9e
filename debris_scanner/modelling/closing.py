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
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.core.optional import kernel
from debris_scanner.modelling.fusion import Volume, zero_level

VIEWS = 100  # frames that are asked what is free
SURELY_FREE = 2  # frames that look through a voxel at a surface behind it, or past the target
DROPPED = 0.95  # of the voxels measured to be inside: past a free one more frames look than past these
ASKED_INSIDE = 20_000  # voxels that were measured
BLOCK = 4  # voxels, of which far from the surface one is asked
FAR_IN_FRONT = 2.0  # voxels from a surface, which are free
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
    edge = np.pad(np.zeros([n - 2 for n in known.shape], bool), 1, constant_values=True)
    # at its rim a field says what a plane would, not what is there
    known = scipy.ndimage.binary_erosion(known)
    free = (_free(volume, known, known & (field < 0), frames) | edge) & ~known
    inside = _filled(known & (field < 0), known | free)
    field = np.where(known, field, np.where(inside, -1, 1) * np.float32(volume.truncation))
    # harmonic near the surface that fills the gaps
    near = scipy.ndimage.binary_dilation(inside, iterations=SMOOTHED)
    near &= ~scipy.ndimage.binary_erosion(inside, iterations=SMOOTHED)
    for _ in range(SWEEPS):
        _sweep(field, known | edge | ~near)
    vertices, triangles, _ = zero_level(field)
    kept = _bodies(vertices, triangles)
    if not len(kept):
        return None
    seen = scipy.ndimage.gaussian_filter(known.astype(np.float32), SEEN_SCALE, truncate=2)
    share = scipy.ndimage.map_coordinates(seen, vertices.T, order=1)
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
    shape = np.array(known.shape)
    blocks = -(-shape // BLOCK)
    padded = np.zeros(blocks * BLOCK, bool)
    padded[tuple(slice(n) for n in shape)] = known
    in_blocks = padded.reshape(blocks[0], BLOCK, blocks[1], BLOCK, blocks[2], BLOCK)
    near = scipy.ndimage.binary_dilation(in_blocks.any(axis=(1, 3, 5)))

    def enlarged(flags: _Flags) -> _Flags:
        for axis in range(3):
            flags = flags.repeat(BLOCK, axis)
        return flags[tuple(slice(n) for n in shape)]

    fine = np.flatnonzero(enlarged(near) & ~known)
    coarse = np.flatnonzero(~near)
    points = np.concatenate(
        [
            np.column_stack(np.unravel_index(fine, known.shape)),
            np.column_stack(np.unravel_index(coarse, near.shape)) * BLOCK + 0.5 * (BLOCK - 1),
        ]
    )
    # pixels drop out: so many frames look past what is measured to be there
    measured = np.argwhere(inside)
    measured = measured[:: max(1, len(measured) // ASKED_INSIDE)]
    points = np.concatenate([points, measured]) * volume.voxel + volume.origin
    votes = np.zeros((len(points), 3), np.uint16)
    for n in np.unique(np.linspace(0, len(frames) - 1, min(len(frames), VIEWS)).astype(int)).tolist():
        frame, T_target_sensor = frames[n]
        T, c = inverse(T_target_sensor), frame.camera
        on_target = (frame.depth > 0) | (frame.depth_fit > 0)
        _ask(
            points, np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]),
            np.array([c.fx, c.fy, c.cx, c.cy]), frame.depth_fit, frame.normals,
            ~on_target, FAR_IN_FRONT * volume.voxel, votes,
        )  # fmt: skip
    in_front, beside, behind = votes.T.astype(np.int64)
    past = beside / np.maximum(beside + behind, 1)
    usual = np.quantile(past[-len(measured) :], DROPPED) if len(measured) else 0.0
    found = (in_front >= SURELY_FREE) | ((beside >= SURELY_FREE) & (past > usual))
    free = np.zeros(near.shape, bool)
    free.flat[coarse] = found[len(fine) : len(fine) + len(coarse)]
    free = np.ascontiguousarray(enlarged(free))
    free.flat[fine] = found[: len(fine)]
    return free


@kernel()
def _ask(
    points: Array, R: Array, t: Array, intrinsics: Array, depth_fit: NDArray[np.float32],
    normals: NDArray[np.float32], beside: _Flags, margin: float, votes: NDArray[np.uint16],
) -> None:  # fmt: skip
    """Count for each point the frames that see it in front of a surface, beside the target, or behind."""
    fx, fy, cx, cy = intrinsics
    height, width = depth_fit.shape
    for i in range(len(points)):
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        x = R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2 + t[0]
        y = R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2 + t[1]
        z = R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2 + t[2]
        if z <= 0:
            continue
        u, v = int(np.floor(x / z * fx + cx + 0.5)), int(np.floor(y / z * fy + cy + 0.5))
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        d = depth_fit[v, u]
        if d > 0:
            n0, n1, n2 = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            from_plane = n0 * (x - (u - cx) / fx * d) + n1 * (y - (v - cy) / fy * d) + n2 * (z - d)
            votes[i, 0 if from_plane > margin else 2] += 1
        elif beside[v, u]:
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
        padding = [(0, n % 2) for n in inside.shape]
        half = [-(-n // 2) for n in inside.shape]
        split_up = (half[0], 2, half[1], 2, half[2], 2)

        def any_of(flags: _Flags) -> _Flags:
            return np.asarray(np.pad(flags, padding).reshape(split_up).any(axis=(1, 3, 5)))

        # a block with any matter in it is inside: walls and plates keep together
        guess = _filled(any_of(inside & fixed), any_of(fixed))
        for axis in range(3):
            guess = guess.repeat(2, axis)
        guess = guess[tuple(slice(n) for n in inside.shape)]
        rounds = max(ROUNDS * COARSEST // min(inside.shape), FEWEST_ROUNDS)
    found = np.where(fixed, inside, guess)
    for _ in range(rounds):
        blurred = scipy.ndimage.gaussian_filter(found.astype(np.float32), BLUR, truncate=2)
        following = np.where(fixed, inside, blurred > 0.5)
        if np.array_equal(following, found):
            break
        found = following
    return found


@kernel(fastmath=True)
def _sweep(field: NDArray[np.float32], fixed: _Flags) -> None:
    """One sweep of Gauss and Seidel."""
    a, b, c = field.shape
    sixth = np.float32(1 / 6)
    for i in range(a):
        for j in range(b):
            for k in range(c):
                if fixed[i, j, k]:
                    continue
                total = field[max(i - 1, 0), j, k] + field[min(i + 1, a - 1), j, k]
                total += field[i, max(j - 1, 0), k] + field[i, min(j + 1, b - 1), k]
                total += field[i, j, max(k - 1, 0)] + field[i, j, min(k + 1, c - 1)]
                field[i, j, k] = total * sixth
