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

"""Rays of a sensor and where they meet a surface: a pinhole camera's, or a grid regular in angles."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.sim.surface import Surface

Window = tuple[int, int, int, int]  # u0, v0, u1, v1: columns and rows of an image part, ends excluded

_NEAREST_M = 0.05  # a surface that reaches nearer has no bounded projection
_MARGIN_PX = 4  # of a window, around the projection


class Rays(Protocol):
    """One ray a pixel of an image (height, width), all from the sensor's origin, optical frame."""

    @property
    def height(self) -> int:
        """Rows of the image."""

    @property
    def width(self) -> int:
        """Columns of the image."""

    @property
    def focal_px(self) -> float:
        """Pixels a radian in the middle of the image."""

    def directions(self, u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        """Directions (..., 3) of columns u and rows v (...); the depth counts in their lengths."""

    def window(self, vertices: NDArray[np.float32], T: Array) -> Window | None:
        """Part of the image that vertices (n, 3) posed at T (4, 4) may cover; None outside the image."""


@dataclass(frozen=True)
class PinholeRays:
    """Rays of a pinhole camera. Their z is 1, so a depth is measured along the optical axis."""

    camera: Camera

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self.camera.height

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self.camera.width

    @property
    def focal_px(self) -> float:
        """Pixels a radian in the middle of the image."""
        return self.camera.fx

    def directions(self, u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        """Directions (..., 3) of z = 1."""
        camera = self.camera
        return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)

    def window(self, vertices: NDArray[np.float32], T: Array) -> Window | None:
        """Part of the image that vertices (n, 3) posed at T (4, 4) cover."""
        p = vertices @ T[:3, :3].T + T[:3, 3]
        camera = self.camera
        if p[:, 2].min() < _NEAREST_M:  # reaches behind the lens: its projection is no bound
            return (0, 0, camera.width, camera.height) if p[:, 2].max() > _NEAREST_M else None
        u = p[:, 0] / p[:, 2] * camera.fx + camera.cx
        v = p[:, 1] / p[:, 2] * camera.fy + camera.cy
        return _bounds(u, v, camera.width, camera.height, 0.0)


@dataclass(frozen=True)
class AngularRays:
    """Unit rays at equal steps of azimuth and elevation about the z axis: a depth is a range."""

    step_rad: float
    width: int
    height: int

    @property
    def focal_px(self) -> float:
        """Pixels a radian."""
        return 1 / self.step_rad

    def directions(self, u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        """Unit directions (..., 3)."""
        step = np.float32(self.step_rad)
        azimuth = (u - np.float32((self.width - 1) / 2)) * step
        elevation = (v - np.float32((self.height - 1) / 2)) * step  # positive downwards, as y
        across = np.cos(elevation)
        return np.stack([np.sin(azimuth) * across, np.sin(elevation), np.cos(azimuth) * across], axis=-1)

    def window(self, vertices: NDArray[np.float32], T: Array) -> Window | None:
        """Part of the image that vertices (n, 3) posed at T (4, 4) cover, and a margin."""
        p = vertices @ T[:3, :3].T + T[:3, 3]
        if p[:, 2].min() < _NEAREST_M:
            return (0, 0, self.width, self.height) if p[:, 2].max() > _NEAREST_M else None
        u = np.arctan2(p[:, 0], p[:, 2]) / self.step_rad + (self.width - 1) / 2
        v = np.arctan2(p[:, 1], np.hypot(p[:, 0], p[:, 2])) / self.step_rad + (self.height - 1) / 2
        # straight edges bulge beyond their ends on a grid of angles
        return _bounds(u, v, self.width, self.height, 0.15)


def _bounds(u: Array, v: Array, width: int, height: int, bulge: float) -> Window | None:
    """Window around pixels u, v (n,), wider by a share of their extent."""
    wide_u, wide_v = (_MARGIN_PX + int(bulge * np.ptp(x)) for x in (u, v))
    u0, v0 = max(0, int(u.min()) - wide_u), max(0, int(v.min()) - wide_v)
    u1, v1 = min(width, int(u.max()) + wide_u + 1), min(height, int(v.max()) + wide_v + 1)
    return (u0, v0, u1, v1) if u1 > u0 and v1 > v0 else None


@dataclass(frozen=True)
class Hits:
    """Where the rays of a window hit a surface: image arrays (h, w), depth inf for a miss."""

    u0: int
    v0: int
    depth: NDArray[np.float32]  # metres, in lengths of the pixel's direction
    cosine: NDArray[np.float32]  # of the angle of incidence
    points: NDArray[np.float32]  # (h, w, 3) target frame
    normals: NDArray[np.float32]  # (h, w, 3) target frame, unit, towards the sensor
    to_sensor: NDArray[np.float32]  # (h, w, 3) target frame, unit


def pixels(window: Window) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows (h, w) of a window's pixels."""
    u0, v0, u1, v1 = window
    shape = (v1 - v0, u1 - u0)
    u = np.broadcast_to(np.arange(u0, u1, dtype=np.float32), shape)
    v = np.broadcast_to(np.arange(v0, v1, dtype=np.float32)[:, None], shape)
    return u, v


def cast(
    surface: Surface,
    rays: Rays,
    T: Array,
    window: Window,
    scatter: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None,
    edges_only: bool = False,
) -> Hits:
    """Cast the window's rays at a surface posed at T (4, 4) in the sensor frame.

    Args:
        surface: in its own frame.
        rays: of the sensor.
        T: pose of the surface.
        window: of the image.
        scatter: shift of each ray (h, w) along u and v, pixels.
        edges_only: the depth is where the pixel's own ray meets the plane that the shifted ray hit, so
            scatter moves edges but adds no noise to slopes.
    """
    u, v = pixels(window)
    ray = rays.directions(u, v) if scatter is None else rays.directions(u + scatter[0], v + scatter[1])
    T_target_sensor = inverse(T)
    rotation = T_target_sensor[:3, :3].T.astype(np.float32)
    # a direction keeps its length, so the distance along it is the depth itself
    direction = (ray @ rotation).astype(np.float32)
    origin = T_target_sensor[:3, 3].astype(np.float32)
    depth, normals = surface.cast(origin, direction)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    cosine = -np.einsum('ijk,ijk->ij', normals, unit)
    normals = normals * np.sign(cosine)[..., None]
    points = origin + direction * np.where(np.isfinite(depth), depth, 0)[..., None]
    if edges_only and scatter is not None:
        own = rays.directions(u, v) @ rotation
        along, along_own = (np.einsum('ijk,ijk->ij', normals, d) for d in (direction, own))
        # nearly edge-on the plane is no guide any more
        steep = np.abs(along_own) < np.float32(0.02)
        depth = depth * np.clip(np.where(steep, 1, along / np.where(steep, 1, along_own)), 0.95, 1.05)
    return Hits(window[0], window[1], depth, np.abs(cosine), points, normals, -unit)
