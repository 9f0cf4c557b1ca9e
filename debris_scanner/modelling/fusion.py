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

"""Fusion of posed target frames into a truncated signed distance field, and its surface.

As Curless and Levoy (1996), with the distance to the fitted plane of each pixel rather than along its ray, so
that obliquely seen surfaces neither thicken nor shift. Behind the surface a pixel has little weight: the
field there is left to views of the other side, or thin plates would swell.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import skimage
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import Posed, TargetFrame
from debris_scanner.core.geometry import Array, apply, inverse, parts
from debris_scanner.core.optional import inlined, kernel
from debris_scanner.core.parameters import parameter
from debris_scanner.modelling.frame_store import spread
from debris_scanner.sensing.normals import outline
from debris_scanner.sensing.silhouette import open_sides, unseen

Image = NDArray[np.float32]

MARGIN = 7.0  # px, of the volume around the surface
SPARSE = 36  # of so many pixels one is asked how large the target is
STRAY = 0.2  # per cent of the points, at each end
ON_A_VOXEL = 1e-4  # share of the truncation; a single-precision coordinate resolves a tenth of it
ASKED = 100  # frames that are asked whether what is too thin for a plane is there
MIN_INCIDENCE_COS = 0.2  # surfaces seen more obliquely carry more noise than shape


@dataclass(frozen=True)
class FusionSettings:
    """Resolution of the model."""

    voxel: float = parameter(1.0, 'edge of a voxel', 'px', 0.1, 100.0)
    max_voxels: int = parameter(
        280, 'most voxels along an edge of the volume; voxels grow beyond', '', 32, 1024
    )
    min_weight: float = parameter(0.2, 'observations a voxel needs to carry surface', '', 0.1, 1000.0)
    inside: float = parameter(2.0, 'depth behind the surface that a pixel speaks for', 'px', 0.1, 100.0)
    smoothing: float = parameter(0.5, 'Gaussian smoothing of the field', 'voxel', 0.0, 5.0)
    max_frames: int = parameter(400, 'frames fused, drawn evenly from all', '', 10, 100000)


@dataclass(frozen=True)
class FusedSurface:
    """Triangle mesh in the target frame: vertices (m, 3) and normals (m, 3), triangles (t, 3)."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    voxel: float  # m, edge of the field's voxels


class Volume:
    """A signed distance field over a box of the target frame."""

    def __init__(self, low: Array, high: Array, settings: FusionSettings, footprint: float) -> None:
        """Box corners (3,) in metres, widened by the truncation distance; the footprint of a pixel, m."""
        self.settings = settings
        self.voxel = max(settings.voxel * footprint, float((high - low).max()) / (settings.max_voxels - 12))
        self.truncation = 4 * self.voxel
        self.inside = max(settings.inside * footprint, 2 * self.voxel)
        self.origin = low - self.truncation - self.voxel
        shape = np.ceil((high - low + 2 * self.truncation) / self.voxel).astype(int) + 2
        self.distance = np.zeros(shape, np.float32)  # weighted sum, metres
        self.weight = np.zeros(shape, np.float32)
        self._thin: list[tuple[Camera, Array, Array]] = []  # T_target_sensor; row, column, depth (n, 3)
        self._field: tuple[NDArray[np.float32], NDArray[np.bool_]] | None = None  # of all frames so far

    def integrate(self, frame: TargetFrame, T_target_sensor: Array) -> None:
        """Add one frame at its pose (4, 4)."""
        self._add(frame.camera, frame.depth, frame.depth_fit, frame.normals, T_target_sensor)
        v, u = np.nonzero((frame.depth > 0) & (frame.depth_fit <= 0))
        if len(v):
            self._thin.append((frame.camera, T_target_sensor, np.column_stack([v, u, frame.depth[v, u]])))

    def integrate_thin(self, frames: Sequence[Posed]) -> None:
        """Add what was too thin for a plane in the frames so far, where most of some posed frames show it.

        A boom two pixels wide has no plane, and neither have pixels between an edge and what is behind it.
        But the boom is there for all who look, and past those pixels other views look at something else.
        """
        thin, self._thin = self._thin, []
        if not thin:
            return
        points = [apply(T, _sights(c, pixels) * pixels[:, 2:]) for c, T, pixels in thin]
        cells = np.floor((np.concatenate(points) - self.origin) / self.voxel + 0.5).astype(np.int64)
        cells, index = np.unique(cells, axis=0, return_inverse=True)
        shown = _shown(cells * self.voxel + self.origin, frames, self.truncation)[index.reshape(-1)]
        # a depth that is a pixel's own, not the mean of many as a plane's: none alone makes a surface
        trust = min(self.settings.min_weight, 1.0)
        ends = np.cumsum([len(pixels) for *_, pixels in thin])[:-1]
        for (camera, T, pixels), there in zip(thin, np.split(shown, ends), strict=True):
            v, u = pixels[there, :2].astype(int).T
            depth = np.zeros((camera.height, camera.width), np.float32)
            normals = np.zeros((*depth.shape, 3), np.float32)
            depth[v, u] = pixels[there, 2]
            towards = -_sights(camera, pixels[there])
            normals[v, u] = towards / np.linalg.norm(towards, axis=1, keepdims=True)
            self._add(camera, depth, depth, normals, T, trust)

    def _add(
        self,
        c: Camera,
        depth: NDArray[np.float32],
        depth_fit: NDArray[np.float32],
        normals: NDArray[np.float32],
        T_target_sensor: Array,
        trust: float = 1.0,
    ) -> None:
        self._field = None
        _integrate(
            depth, depth_fit, normals, np.array([c.fx, c.fy, c.cx, c.cy]),
            *parts(T_target_sensor),
            self.origin, self.voxel, self.truncation, self.inside, trust, self.distance, self.weight,
        )  # fmt: skip

    def field(self) -> tuple[NDArray[np.float32], NDArray[np.bool_]] | None:
        """Signed distance, m, and where it was measured; None if no surface was."""
        if self._field is None:
            known = self.weight > self.settings.min_weight
            places, weights = np.flatnonzero(known), gaussian(self.settings.smoothing, 3)
            distance = blurred(np.where(known, self.distance, 0), places, weights)
            weight = blurred(np.where(known, self.weight, 0), places, weights)
            field = np.full(known.shape, self.truncation, np.float32)
            field.flat[places] = distance / np.maximum(weight, 1e-6)
            self._field = field, known
        field, known = self._field
        return self._field if known.any() and field.min() < 0 < field[known].max() else None

    def surface(self) -> FusedSurface | None:
        """Zero level of the field where it was observed, or None if nothing was."""
        measured = self.field()
        if measured is None:
            return None
        field, known = measured
        vertices, triangles, normals = zero_level(field, known)
        # triangles that touch unobserved voxels are a boundary to "unknown", not surface
        inner = eroded(known)
        cell = np.round(vertices).astype(int)
        triangles = triangles[inner[cell[:, 0], cell[:, 1], cell[:, 2]][triangles].all(axis=1)]
        if len(triangles) == 0:
            return None
        used, index = np.unique(triangles, return_inverse=True)
        points = (vertices[used] * self.voxel + self.origin).astype(np.float32)
        triangles = index.reshape(-1, 3).astype(np.int32)
        corners = points[triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if np.einsum('ij,ij->', face, normals[used][triangles[:, 0]]) < 0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        return FusedSurface(points, normals[used].astype(np.float32), triangles, self.voxel)


def zero_level(
    field: NDArray[np.float32], known: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.float32]]:
    """The surface of a field that is positive outside; empty where the field has no inside, or no outside.

    Args:
        field: (a, b, c).
        known: (a, b, c), where there may be surface; None: everywhere.

    Returns:
        Vertices (m, 3) in voxels, triangles (t, 3), outward, and unit normals (m, 3), outward.
    """
    try:
        vertices, triangles, inward, _ = skimage.measure.marching_cubes(_off_voxels(field), 0.0, mask=known)
    except (ValueError, RuntimeError):  # scikit-image's ways to say that there is no surface
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32)
    return vertices.astype(np.float32), triangles.astype(np.int32), -inward


def gaussian(sigma: float, truncate: float) -> NDArray[np.float32]:
    """Weights (2 r + 1,) of a Gaussian of so many voxels, cut off at so many sigmas."""
    reach = int(truncate * sigma + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-6)) ** 2)
    return np.asarray(weights / weights.sum(), np.float32)


def eroded(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Voxels that are set, with all six neighbours; none at the edge of the volume."""
    inner = np.zeros_like(flags)
    middle = inner[1:-1, 1:-1, 1:-1]
    middle[:] = flags[1:-1, 1:-1, 1:-1]
    for axis in range(3):
        for end in (slice(2, None), slice(-2)):
            middle &= flags[tuple(end if k == axis else slice(1, -1) for k in range(3))]
    return inner


@kernel(fastmath=True)
def blurred(values: NDArray[Any], places: NDArray[np.intp], weights: NDArray[np.float32]) -> Image:
    """A volume's values or flags blurred by weights along each axis, at some flat indices (n,) alone.

    Beyond its edges it is mirrored.
    """
    a, b, c = values.shape
    reach, out = len(weights) // 2, np.empty(len(places), np.float32)
    line = np.empty(c + 2 * reach, np.float32)
    first = 0
    while first < len(places):
        # a run of neighbours along the last axis shares what is summed up along the others
        i, j, start = places[first] // (b * c), places[first] // c % b, places[first] % c
        run = 1
        while first + run < len(places) and start + run < c and places[first + run] == places[first] + run:
            run += 1
        line[: run + 2 * reach] = 0
        for p in range(len(weights)):
            x = _mirrored(i + p - reach, a)
            for q in range(len(weights)):
                row, weight = values[x, _mirrored(j + q - reach, b)], weights[p] * weights[q]
                for k in range(max(0, reach - start), min(run + 2 * reach, c + reach - start)):
                    line[k] += weight * row[start + k - reach]
        for k in range(start - reach, 0):
            line[k + reach - start] = line[-1 - k + reach - start]
        for k in range(c, start + run + reach):
            line[k + reach - start] = line[2 * c - 1 - k + reach - start]
        for k in range(run):
            total = np.float32(0)
            for r in range(len(weights)):
                total += weights[r] * line[k + r]
            out[first + k] = total
        first += run
    return out


@inlined
def _mirrored(k: int, n: int) -> int:
    return -1 - k if k < 0 else 2 * n - 1 - k if k >= n else k


@kernel()
def _off_voxels(field: Image) -> Image:
    """A field with no value so near zero that vertices would meet on a voxel, and triangles be empty."""
    least = np.float32(ON_A_VOXEL) * max(-field.min(), field.max())
    out = field.copy()
    flat = out.ravel()
    for n in range(len(flat)):
        if abs(flat[n]) < least:
            flat[n] = -least if flat[n] < 0 else least
    return out


def bounds(frames: Sequence[Posed]) -> tuple[Array, Array]:
    """Corners (3,), metres, of the box that holds the surfaces of posed frames (T_target_sensor).

    All but the outermost points, which may be stray; of those, what most frames show: the tip of a boom.
    """
    clouds, footprint = [], 0.0
    for frame, T in frames:
        footprint = max(footprint, frame.footprint)
        points = frame.camera.back_project(frame.depth).reshape(-1, 3)
        # of what was measured: a boom falls through a grid of pixels
        points = points[np.isfinite(points[:, 2])][::SPARSE]
        clouds.append(points @ T[:3, :3].T + T[:3, 3])
    cloud = np.concatenate(clouds)
    low, high = np.percentile(cloud, STRAY, axis=0), np.percentile(cloud, 100 - STRAY, axis=0)
    outermost = cloud[((cloud < low) | (cloud > high)).any(axis=1)]
    reached = np.vstack([low, high, outermost[_shown(outermost, frames, MARGIN * footprint)]])
    margin = MARGIN * footprint
    return reached.min(axis=0) - margin, reached.max(axis=0) + margin


def _sights(c: Camera, pixels: Array) -> Array:
    """Rays (n, 3) through pixels (n, 2 or more: row, column), at a depth of one."""
    return np.column_stack([(pixels[:, 1] - c.cx) / c.fx, (pixels[:, 0] - c.cy) / c.fy, np.ones(len(pixels))])


def _shown(points: Array, frames: Sequence[Posed], tolerance: float) -> NDArray[np.bool_]:
    """Which points (n, 3) most of the frames show that look there, to a tolerance in depth, metres."""
    votes = np.zeros((len(points), 2), np.int32)
    for n in spread(len(frames), ASKED):
        frame, T_target_sensor = frames[n]
        c = frame.camera
        _vote(
            apply(inverse(T_target_sensor), points), np.array([c.fx, c.fy, c.cx, c.cy]), frame.depth,
            outline(frame.depth), open_sides(frame.depth > 0), tolerance, votes,
        )  # fmt: skip
    return np.asarray(votes[:, 0] > votes[:, 1])


@kernel(fastmath=True)
def _integrate(
    depth: NDArray[np.float32], depth_fit: NDArray[np.float32], normals: NDArray[np.float32],
    intrinsics: Array, R: Array, t: Array, origin: Array, voxel: float, truncation: float, inside: float,
    trust: float, distance: NDArray[np.float32], weight: NDArray[np.float32],
) -> None:  # fmt: skip
    """Add the pixels that have a plane, each with a weight of at most ``trust``."""
    fx, fy, cx, cy = intrinsics
    size_x, size_y, size_z = distance.shape
    stride = 0.7  # voxels
    reach = int(np.ceil(truncation / (stride * voxel)))
    s0, s1, s2 = t[0] - origin[0], t[1] - origin[1], t[2] - origin[2]
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z, z_fit = depth[v, u], depth_fit[v, u]
            if z <= 0 or z_fit <= 0:
                continue
            x, y = (u - cx) / fx, (v - cy) / fy
            n0, n1, n2 = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            slope = n0 * x + n1 * y + n2
            cosine = -slope / (x * x + y * y + 1) ** 0.5
            if cosine < MIN_INCIDENCE_COS:
                continue
            # ray and normal in the target frame, where the ray goes through (s + z r) / voxel
            r0 = R[0, 0] * x + R[0, 1] * y + R[0, 2]
            r1 = R[1, 0] * x + R[1, 1] * y + R[1, 2]
            r2 = R[2, 0] * x + R[2, 1] * y + R[2, 2]
            m0 = R[0, 0] * n0 + R[0, 1] * n1 + R[0, 2] * n2
            m1 = R[1, 0] * n0 + R[1, 1] * n1 + R[1, 2] * n2
            m2 = R[2, 0] * n0 + R[2, 1] * n1 + R[2, 2] * n2
            level = m0 * s0 + m1 * s1 + m2 * s2 + slope * z  # of the pixel's plane
            # by the fitted depth: truncated by its own noise, the mean would shift
            rounded = (z_fit - z) * slope
            a0, a1, a2 = (s0 + z * r0) / voxel + 0.5, (s1 + z * r1) / voxel + 0.5, (s2 + z * r2) / voxel + 0.5
            last = -1
            for k in range(-reach, reach + 1):
                d = k * stride
                a, b, c = int(np.floor(a0 + d * r0)), int(np.floor(a1 + d * r1)), int(np.floor(a2 + d * r2))
                if a < 0 or b < 0 or c < 0 or a >= size_x or b >= size_y or c >= size_z:
                    continue
                flat = (a * size_y + b) * size_z + c
                if flat == last:
                    continue
                last = flat
                signed = voxel * (a * m0 + b * m1 + c * m2) - level  # of the voxel's centre
                behind = rounded - signed
                if behind > inside:
                    continue
                w = trust * (cosine * cosine * min(1.0, 2 * (1 - behind / inside)))
                distance[a, b, c] += w * min(signed, truncation)
                weight[a, b, c] += w


@kernel()
def _vote(
    points: Array, intrinsics: Array, depth: NDArray[np.float32], silhouette: NDArray[np.bool_],
    sides: NDArray[np.bool_], tolerance: float, votes: NDArray[np.int32],
) -> None:  # fmt: skip
    """Count for each point, sensor frame, whether the frame shows something there, or looks past it."""
    fx, fy, cx, cy = intrinsics
    h, w = depth.shape
    for i in range(len(points)):
        x, y, z = points[i]
        if z <= 0:
            continue
        u, v = int(np.floor(x / z * fx + cx + 0.5)), int(np.floor(y / z * fy + cy + 0.5))
        if unseen(sides, u, v, w, h):
            continue
        shown, hidden = False, False
        for b in range(max(0, v - 1), min(h, v + 2)):
            for a in range(max(0, u - 1), min(w, u + 2)):
                shown = shown or abs(depth[b, a] - z) < tolerance
                hidden = hidden or 0 < depth[b, a] <= z - tolerance
        if shown:
            votes[i, 0] += 1
        elif not hidden:
            unknown = 0 <= v < h and 0 <= u < w and depth[v, u] <= 0 and silhouette[v, u]
            votes[i, 1] += not unknown
