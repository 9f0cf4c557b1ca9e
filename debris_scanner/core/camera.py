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

"""Pinhole camera: back-projection, projection, and fitting a camera to an organised cloud."""

import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np
import scipy
from numpy.typing import NDArray

# Of the virtual camera of unordered clouds.
COARSEST, FINEST = -6, 2  # half octaves of the virtual camera's resolution
SPACING_SAMPLE = 300
POINTS_PER_PIXEL = 1.1  # in each direction; with fewer, rounding leaves holes


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole intrinsics in pixels; pixel (row v, column u) looks along ((u-cx)/fx, (v-cy)/fy, 1).

    Raises:
        ValueError: a focal length that is not positive and finite, a principal point that is not finite, or a
            size that is no positive whole number.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        if not (0 < self.fx < math.inf and 0 < self.fy < math.inf):
            raise ValueError(f'focal lengths must be positive and finite: fx {self.fx:g}, fy {self.fy:g} px')
        if not (math.isfinite(self.cx) and math.isfinite(self.cy)):
            raise ValueError(f'the principal point must be finite: cx {self.cx:g}, cy {self.cy:g} px')
        for name, size in (('width', self.width), ('height', self.height)):
            if not isinstance(size, Integral) or size < 1:
                raise ValueError(f'{name} must be a positive whole number of pixels, not {size!r}')

    @property
    def focal(self) -> float:
        """Focal length, pixels: the geometric mean of both."""
        return float(np.sqrt(self.fx * self.fy))

    def crop(self, u0: int, v0: int, width: int, height: int) -> 'Camera':
        """Camera of the image window whose first pixel is (v0, u0); may reach past the image."""
        return Camera(self.fx, self.fy, self.cx - u0, self.cy - v0, width, height)

    def resembles(self, other: 'Camera') -> bool:
        """Whether both agree within the scatter of cameras fitted to clouds of one sensor."""
        return (
            (self.width, self.height) == (other.width, other.height)
            and max(abs(self.fx / other.fx - 1), abs(self.fy / other.fy - 1)) < 0.01
            and max(abs(self.cx - other.cx), abs(self.cy - other.cy)) < 0.5
        )

    def back_project(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Organised cloud (h, w, 3), metres, of a depth image (h, w); pixels without depth are NaN."""
        z = np.where(depth > 0, depth, np.float32(np.nan)).astype(np.float32)
        x = (np.arange(depth.shape[1], dtype=np.float32) - np.float32(self.cx)) / np.float32(self.fx)
        y = (np.arange(depth.shape[0], dtype=np.float32) - np.float32(self.cy)) / np.float32(self.fy)
        return np.stack([x[None, :] * z, y[:, None] * z, z], axis=-1)


def finite(points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which points (..., 3) have three finite coordinates; fifty times faster than ``all(axis=-1)``."""
    return np.isfinite(points[..., 0]) & np.isfinite(points[..., 1]) & np.isfinite(points[..., 2])


def fit_pinhole(points: NDArray[np.float32], tolerance_px: float = 0.25) -> Camera | None:
    """Pinhole camera of an organised cloud (h, w, 3), or None if none fits.

    A depth camera puts the point of pixel (v, u) at x/z = (u - cx)/fx, so the intrinsics follow from
    the cloud by two straight-line fits. Spinning lidars and unordered clouds fail the fit.

    Args:
        points: metres, optical frame; invalid points NaN.
        tolerance_px: largest RMS of the fit, pixels.
    """
    if points.ndim != 3 or points.shape[0] < 2 or points.shape[1] < 2:
        return None
    z = points[..., 2]
    v, u = np.nonzero(finite(points) & (z > 0))
    if len(v) < 50 or np.ptp(u) < 5 or np.ptp(v) < 5:
        return None
    step = max(1, len(v) // 4000)
    v, u = v[::step], u[::step]
    ray = points[v, u].astype(np.float64)
    focal_x, centre_x, rms_x = _line(ray[:, 0] / ray[:, 2], u)
    focal_y, centre_y, rms_y = _line(ray[:, 1] / ray[:, 2], v)
    if not (0 < focal_x < np.inf and 0 < focal_y < np.inf and max(rms_x, rms_y) <= tolerance_px):
        return None
    return Camera(focal_x, focal_y, centre_x, centre_y, points.shape[1], points.shape[0])


VIRTUAL_CAMERA = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)  # a Kinect's


def virtual_camera(points: NDArray[np.float32]) -> Camera:
    """Camera with a Kinect's field of view and about a point a pixel of an unordered cloud (..., 3).

    Its resolution comes in half octaves, so that it is the same in all frames of a sensor.
    """
    p = points.reshape(-1, 3)
    p = p[finite(p) & (p[:, 2] > 0)]
    reach = np.array([VIRTUAL_CAMERA.width, VIRTUAL_CAMERA.height]) / (2 * VIRTUAL_CAMERA.focal)
    ray = p[:, :2] / p[:, 2:]
    ray = ray[(np.abs(ray) < reach).all(axis=1)]
    if len(ray) < SPACING_SAMPLE:
        return VIRTUAL_CAMERA
    apart = scipy.spatial.cKDTree(ray).query(ray[:: len(ray) // SPACING_SAMPLE], k=2)[0][:, 1]
    spacing = float(np.median(apart[apart > 0])) if (apart > 0).any() else 0.0
    if spacing <= 0:
        return VIRTUAL_CAMERA
    octaves = np.log2(1 / (POINTS_PER_PIXEL * spacing * VIRTUAL_CAMERA.focal))
    scale = 2.0 ** (np.clip(np.rint(2 * octaves), COARSEST, FINEST) / 2)
    width, height = round(VIRTUAL_CAMERA.width * scale), round(VIRTUAL_CAMERA.height * scale)
    focal = VIRTUAL_CAMERA.focal * scale
    return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)


def rasterise(points: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Depth image (h, w) of an unordered cloud (n, 3) seen by a virtual camera; the nearest point wins."""
    depths = np.append(points.reshape(-1, 3)[:, 2], np.float32(0)).astype(np.float32)
    return depths[rasterised(points, camera)]  # the last where there is none


def rasterised(points: NDArray[np.float32], camera: Camera) -> NDArray[np.intp]:
    """Index (h, w) of the point of a cloud (..., 3) that each pixel of a camera sees; -1 where none is."""
    index = np.full((camera.height, camera.width), -1, np.intp)
    p = points.reshape(-1, 3)
    kept = np.flatnonzero(finite(p) & (p[:, 2] > 0))
    p = p[kept]
    u = np.rint(p[:, 0] / p[:, 2] * camera.fx + camera.cx).astype(np.int64)
    v = np.rint(p[:, 1] / p[:, 2] * camera.fy + camera.cy).astype(np.int64)
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    u, v, z, kept = u[inside], v[inside], p[inside, 2], kept[inside]
    far_first = np.argsort(-z, kind='stable')
    index[v[far_first], u[far_first]] = kept[far_first]
    return index


def _line(slope: NDArray[np.float64], pixel: NDArray[np.intp]) -> tuple[float, float, float]:
    """Least-squares focal length and principal point of pixel = f slope + c, and the RMS in pixels."""
    if np.ptp(slope) <= 0 or not np.all(np.isfinite(slope)):
        return 0.0, 0.0, np.inf
    centred = slope - slope.mean()
    focal = float(centred @ (pixel - pixel.mean()) / (centred @ centred))
    centre = float(pixel.mean() - focal * slope.mean())
    return focal, centre, float(np.sqrt(np.mean((focal * slope + centre - pixel) ** 2)))
