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

"""The colours of the closed surface as an image laid around it, from the key frames that saw it best.

For each texel the few views are kept that spend most pixels on its place: facing, near, not hidden by the
mesh's own depth nor by anything that the frame's depth shows. Where views see the same texels, their colours
tell how they were exposed: one gain for each view and channel. The texel is the mean of its evened views.
What nobody saw is filled as smoothly as the colours around it allow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.atlas import Atlas, make_atlas, rasterise
from debris_scanner.core.frames import ClosedMesh, TargetFrame, Texture
from debris_scanner.core.geometry import Array, apply, inverse, parts
from debris_scanner.core.optional import kernel
from debris_scanner.modelling.fusion import MIN_INCIDENCE_COS
from debris_scanner.modelling.refinement import SEEN_WITHIN

TEXELS_PER_PIXEL = 2.0  # along an edge: each view sees the surface at other fractions of a pixel
MOST_TEXELS = 2**21  # on the surface; texels grow beyond
VIEWS = 100  # key frames, drawn evenly from all
BEST = 8  # views kept for a texel: fewer leave the noise, more smear
MOST_HIDDEN = 0.5  # share of the pixels around a place that may show something else
COMPARED = 10_000  # texels that tell the exposure
DARK, BRIGHT = 8, 247  # beyond them a camera clips
ROUNDS = 8  # of reweighting
OUTLIER = 2.0  # standard deviations; pairs of views that differ by more weigh less

_Floats = NDArray[np.float32]


@dataclass(frozen=True)
class _Texels:
    """Places on the surface, one for each texel whose centre a triangle covers."""

    rows: NDArray[np.int64]  # (n,)
    columns: NDArray[np.int64]
    faces: NDArray[np.int32]  # (n,) triangle
    shares: _Floats  # (n, 3) of its corners
    points: _Floats  # (n, 3) m
    normals: _Floats  # (n, 3)


@dataclass(frozen=True)
class _Samples:
    """The best views of each texel; a weight of 0 is none."""

    weights: _Floats  # (n, BEST), pixels for an area
    colours: NDArray[np.uint8]  # (n, BEST, 3)
    views: NDArray[np.int16]  # (n, BEST)


def textured(mesh: ClosedMesh, frames: Sequence[tuple[TargetFrame, Array]]) -> ClosedMesh:
    """The mesh with a texture; as it is if no frame has colour.

    Args:
        mesh: in the target frame.
        frames: with their poses T_target_sensor (4, 4); one at a time is asked for.
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), VIEWS)).astype(int)).tolist()
    footprints = [frames[n][0].footprint for n in chosen[:: max(1, len(chosen) // 10)]]
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * float(np.linalg.norm(crossed, axis=1).sum())
    texel = max(float(np.median(footprints)) / TEXELS_PER_PIXEL, float(np.sqrt(area / MOST_TEXELS)))
    atlas = make_atlas(mesh.vertices, mesh.triangles, texel)
    texels = _texels(mesh, atlas)
    samples = _Samples(
        np.zeros((len(texels.faces), BEST), np.float32),
        np.zeros((len(texels.faces), BEST, 3), np.uint8),
        np.zeros((len(texels.faces), BEST), np.int16),
    )
    coloured = False
    for n, (frame, T_target_sensor) in enumerate(frames[k] for k in chosen):
        if frame.rgb is not None:
            coloured = True
            _look(mesh, texels, frame, inverse(T_target_sensor), n, samples)
    if not coloured:
        return mesh
    colours, seen = _blended(samples, _exposures(samples, len(chosen)))
    colours[~seen] = _filled(mesh, texels, colours, seen)[~seen]
    image = np.zeros((atlas.height, atlas.width, 3), np.uint8)
    image[texels.rows, texels.columns] = np.clip(np.rint(colours), 0, 255)
    observed = np.ones((atlas.height, atlas.width), bool)
    observed[texels.rows, texels.columns] = mesh.observed[texels.faces]
    # between the charts the nearest texel, for programs that look half a texel beyond an edge
    empty = np.ones((atlas.height, atlas.width), bool)
    empty[texels.rows, texels.columns] = False
    rows, columns = scipy.ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    uv = (atlas.xy + 0.5) / np.array([atlas.width, atlas.height])
    texture = Texture(
        image[rows, columns], observed[rows, columns], atlas.vertices, atlas.triangles, uv.astype(np.float32)
    )
    return replace(mesh, texture=texture)


def _texels(mesh: ClosedMesh, atlas: Atlas) -> _Texels:
    """The texels on the surface, row by row."""
    covered = atlas.faces()
    rows, columns = np.nonzero(covered >= 0)
    faces = covered[rows, columns]
    a, b, c = (atlas.xy[atlas.triangles[faces, k]].astype(np.float64) for k in range(3))
    u, v, p = b - a, c - a, np.column_stack([columns, rows]) - a
    doubled = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    of_b = (p[:, 0] * v[:, 1] - p[:, 1] * v[:, 0]) / doubled
    of_c = (u[:, 0] * p[:, 1] - u[:, 1] * p[:, 0]) / doubled
    shares = np.column_stack([1 - of_b - of_c, of_b, of_c]).astype(np.float32)
    corners, vertex_normals = mesh.triangles[faces], mesh.normals.astype(np.float32)
    points = sum(shares[:, k, None] * mesh.vertices[corners[:, k]] for k in range(3))
    normals = sum(shares[:, k, None] * vertex_normals[corners[:, k]] for k in range(3))
    return _Texels(
        rows, columns, faces, shares, np.asarray(points, np.float32), np.asarray(normals, np.float32)
    )


def _look(
    mesh: ClosedMesh, texels: _Texels, frame: TargetFrame, T_sensor_target: Array, view: int,
    samples: _Samples,
) -> None:  # fmt: skip
    """Take a frame's colours for the texels that it sees better than others."""
    c = frame.camera
    seen = apply(T_sensor_target, mesh.vertices.astype(np.float64))
    z = np.maximum(seen[:, 2], 1e-6)
    nearness = np.where(seen[:, 2] > 0, 1 / z, 0.0)  # linear on the image of a triangle, as depth is not
    flat = np.column_stack([seen[:, 0] / z * c.fx + c.cx, seen[:, 1] / z * c.fy + c.cy, nearness])
    top = rasterise(flat.astype(np.float32), mesh.triangles, *frame.depth.shape)[1]
    assert frame.rgb is not None
    _sample(
        texels.points, texels.normals,
        *parts(T_sensor_target),
        np.array([c.fx, c.fy, c.cx, c.cy]), frame.depth, frame.rgb, top, view,
        samples.weights, samples.colours, samples.views,
    )  # fmt: skip


@kernel()
def _sample(
    points: _Floats, normals: _Floats, R: Array, t: Array, intrinsics: Array, depth: _Floats,
    rgb: NDArray[np.uint8], nearness: _Floats, view: int,
    weights: _Floats, colours: NDArray[np.uint8], views: NDArray[np.int16],
) -> None:  # fmt: skip
    """Put a view among the best of each point that it shows; the worst of them leaves."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    best = weights.shape[1]
    mean = np.zeros(3)
    for i in range(len(points)):
        p0, p1, p2 = points[i, 0], points[i, 1], points[i, 2]
        x = R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2 + t[0]
        y = R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2 + t[1]
        z = R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2 + t[2]
        if z <= 0:
            continue
        u, v = x / z * fx + cx, y / z * fy + cy
        if not (u >= 0 and v >= 0 and u < width - 1 and v < height - 1):
            continue
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        r0 = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
        r1 = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
        r2 = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
        length = ((x * x + y * y + z * z) * (n0 * n0 + n1 * n1 + n2 * n2)) ** 0.5
        cosine = -(n0 * r0 + n1 * r1 + n2 * r2) / max(length, 1e-12)
        if cosine < MIN_INCIDENCE_COS:
            continue
        pixel = z / (fx * fy) ** 0.5
        weight = cosine / (pixel * pixel)
        # as far as the surface falls from pixel to pixel, along the diagonal
        falls = pixel * (1 + 1.5 * (1 - cosine * cosine) ** 0.5 / cosine)
        u0, v0 = int(u), int(v)
        shown = 0.0
        mean[:] = 0.0
        for dv in range(2):
            for du in range(2):
                share = (1 - abs(u - u0 - du)) * (1 - abs(v - v0 - dv))
                near, measured = nearness[v0 + dv, u0 + du], depth[v0 + dv, u0 + du]
                if near <= 0 or measured <= 0:
                    continue
                if abs(1 / near - z) > falls or abs(measured - 1 / near) > SEEN_WITHIN * pixel:
                    continue
                shown += share
                for k in range(3):
                    mean[k] += share * rgb[v0 + dv, u0 + du, k]
        if shown < 1 - MOST_HIDDEN:
            continue
        weight *= shown
        worst = 0
        for k in range(1, best):
            if weights[i, k] < weights[i, worst]:
                worst = k
        if weight > weights[i, worst]:
            weights[i, worst], views[i, worst] = weight, view
            for k in range(3):
                colours[i, worst, k] = np.uint8(mean[k] / shown + 0.5)


def _exposures(samples: _Samples, count: int) -> Array:
    """Logarithm (count, 3) of how much brighter than the others each view shows each channel.

    Robust least squares on pairs of views of the same texels (iteratively reweighted, Huber). That no view
    is brighter counts as one more pair for each, so it holds where views share nothing.
    """
    several = np.flatnonzero((samples.weights > 0).sum(axis=1) >= 2)
    several = several[:: max(1, len(several) // COMPARED)]
    weights, colours, views = (x[several] for x in (samples.weights, samples.colours, samples.views))
    found = np.zeros((count, 3))
    for channel in range(3):
        values = colours[..., channel].astype(np.float64)
        usable = (weights > 0) & (values >= DARK) & (values <= BRIGHT)
        brightness = np.log(np.maximum(values, 1))
        pairs = [(a, b, usable[:, a] & usable[:, b]) for a in range(BEST) for b in range(a)]
        i = np.concatenate([views[both, a] for a, _, both in pairs]).astype(np.int64)
        j = np.concatenate([views[both, b] for _, b, both in pairs]).astype(np.int64)
        apart = np.concatenate([brightness[both, a] - brightness[both, b] for a, b, both in pairs])
        for _ in range(ROUNDS if len(apart) else 0):
            error = apart - (found[i, channel] - found[j, channel])
            sigma = max(1.4826 * float(np.median(np.abs(error))), 1 / BRIGHT)
            w = np.minimum(1, OUTLIER * sigma / np.maximum(np.abs(error), 1e-12))
            cross = np.bincount(i * count + j, w, count**2).reshape(count, count)
            cross = cross + cross.T
            H = np.diag(cross.sum(axis=1) + 1) - cross
            g = np.bincount(i, w * apart, count) - np.bincount(j, w * apart, count)
            found[:, channel] = np.linalg.solve(H, g)
    return found


def _blended(samples: _Samples, brightness: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Mean colour (n, 3) of each texel's views, evened, and whether any saw it (n,)."""
    gains = np.exp(-brightness)
    total, weight = np.zeros((len(samples.weights), 3)), samples.weights.sum(axis=1, dtype=np.float64)
    for k in range(BEST):
        total += samples.weights[:, k, None] * samples.colours[:, k] * gains[samples.views[:, k]]
    seen = weight > 0
    return total / np.where(seen, weight, 1)[:, None], seen


def _filled(mesh: ClosedMesh, texels: _Texels, colours: Array, seen: NDArray[np.bool_]) -> Array:
    """Colours (n, 3) of all texels by those of their corners, which are harmonic where nobody saw any."""
    count = len(mesh.vertices)
    corners = mesh.triangles[texels.faces]
    total, weight = np.zeros((count, 3)), np.zeros(count)
    for k in range(3):
        share = texels.shares[seen, k].astype(np.float64)
        weight += np.bincount(corners[seen, k], share, count)
        for channel in range(3):
            total[:, channel] += np.bincount(corners[seen, k], share * colours[seen, channel], count)
    known = weight > 0
    of_vertices = total / np.where(known, weight, 1)[:, None]
    unknown = np.flatnonzero(~known)
    if len(unknown):
        ends = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T.astype(np.int64)
        links = scipy.sparse.coo_matrix((np.ones(ends.shape[1]), ends), shape=(count, count)).tocsr()[unknown]
        mean = of_vertices[known].mean(axis=0) if known.any() else np.zeros(3)
        # a body that nobody saw at all gets the mean
        held = 1e-6
        system = scipy.sparse.diags(np.asarray(links.sum(axis=1)).ravel() + held) - links[:, unknown]
        factors = scipy.sparse.linalg.splu(system.tocsc())
        of_vertices[unknown] = factors.solve(links @ of_vertices + held * mean)
    return np.asarray(sum(texels.shares[:, k, None] * of_vertices[corners[:, k]] for k in range(3)))
