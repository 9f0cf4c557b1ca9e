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

"""Images of a lens that distorts, resampled into those of a pinhole camera: depth with its colour.

All stages reckon with a pinhole camera. A calibrated lens tells where each ray of the pinhole camera falls in
its image, so every pixel of the new image is read there. Depth is along the optical axis, so it stays the
same. Between pixels, inverse depth is interpolated, which is linear along a plane, but never across the end
of a surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel

PLUMB_BOB, RATIONAL, EQUIDISTANT = 'plumb_bob', 'rational_polynomial', 'equidistant'
# Model: the numbers of coefficients that it may have.
_COUNTS = {PLUMB_BOB: (4, 5), RATIONAL: (8, 12, 14), EQUIDISTANT: (4,)}
_ALIASES = {
    'brown_conrady': PLUMB_BOB,
    'radtan': PLUMB_BOB,
    'fisheye': EQUIDISTANT,
    'kannala_brandt4': EQUIDISTANT,
}
_TILTS = slice(12, 14)  # of a rational model's coefficients: a sensor that is not square to the lens
_WIDEST_RAD = np.radians(85.0)  # from the axis, of a ray that a pinhole camera sees
_GROWN = 0.5  # of the image's size, on each side, that the resampled image may be larger
STEEPEST = 5.7  # a surface's depth changes by at most this many footprints from pixel to pixel: 80 deg


@dataclass(frozen=True)
class Distortion:
    """A lens: ``model`` and coefficients of a camera_info, in its order.

    Raises:
        ValueError: the model is unknown, or the coefficients are not its.
    """

    model: str
    coefficients: tuple[float, ...]

    @staticmethod
    def of(model: str, coefficients: Sequence[float]) -> 'Distortion | None':
        """The lens of a camera_info; None if it does not distort.

        Raises:
            ValueError: see the class.
        """
        d = tuple(float(c) for c in coefficients)
        if not any(d):
            return None
        name = model.strip().lower().replace(' ', '_').replace('-', '_')
        name = _ALIASES.get(name, name) or (PLUMB_BOB if len(d) <= max(_COUNTS[PLUMB_BOB]) else RATIONAL)
        return Distortion(name, d)

    def __post_init__(self) -> None:
        counts = _COUNTS.get(self.model)
        if counts is None:
            raise ValueError(f'distortion model {self.model!r} is none of {", ".join(_COUNTS)}')
        if len(self.coefficients) not in counts or not np.isfinite(self.coefficients).all():
            raise ValueError(
                f'distortion model {self.model} has {" or ".join(map(str, counts))} finite coefficients, '
                f'got {[round(c, 6) for c in self.coefficients]}'
            )
        if any(self.coefficients[_TILTS]):
            raise ValueError('distortion by a tilted sensor is not read')

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where the rays (x, y, 1) fall in the image plane of a focal length of 1."""
        d = self.coefficients
        r2 = x * x + y * y
        if self.model == EQUIDISTANT:
            r = np.sqrt(r2)
            angle = np.arctan(r)
            a2 = angle * angle
            bent = angle * (1 + a2 * (d[0] + a2 * (d[1] + a2 * (d[2] + a2 * d[3]))))
            scale = np.where(r > 0, bent / np.maximum(r, 1e-12), 1.0)
            return x * scale, y * scale
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = (d[:12] + (0.0,) * 12)[:12]
        scale = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * scale + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
            y * scale + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
        )

    @property
    def reach(self) -> float:
        """Largest distance from the axis, at focal length 1, up to which no two rays fall on one place."""
        r = np.tan(np.linspace(0, _WIDEST_RAD, 1000))
        with np.errstate(all='ignore'):
            grows = np.diff(np.hypot(*self.distorted(r, np.zeros_like(r)))) > 0
        return float(r[-1] if grows.all() else r[np.argmin(grows)])


class Rectifier:
    """Resamples the images of a camera whose lens distorts.

    Args:
        camera: K, in pixels of the image.
        lens: its distortion.

    Attributes:
        camera: pinhole camera of the resampled images, of the same focal lengths. It holds what the image
            shows, but no more than twice the image's width and height.
    """

    def __init__(self, camera: Camera, lens: Distortion) -> None:
        beside, above = round(_GROWN * camera.width), round(_GROWN * camera.height)
        u = np.arange(-beside, camera.width + beside)
        v = np.arange(-above, camera.height + above)
        x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
        with np.errstate(all='ignore'):  # far outside, a polynomial may be as large as it likes
            bent_x, bent_y = lens.distorted(x, y)
            column, row = camera.fx * bent_x + camera.cx, camera.fy * bent_y + camera.cy
            seen = (x * x + y * y <= lens.reach**2) & (
                np.abs(column - (camera.width - 1) / 2) <= (camera.width - 1) / 2
            )
            seen &= np.abs(row - (camera.height - 1) / 2) <= (camera.height - 1) / 2
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if not len(rows):
            raise ValueError(f'distortion {lens.model} {lens.coefficients} leaves nothing of the image')
        window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        places = np.where(seen[..., None], np.stack([row, column], axis=-1), np.nan)[window]
        self._source = camera
        self._places = places.astype(np.float32)  # of the resampled pixels in the image; NaN: none
        nearest = np.rint(np.nan_to_num(places)) @ (camera.width, 1)
        self._nearest = np.clip(nearest, 0, camera.width * camera.height - 1).astype(np.intp)
        self._unseen = ~seen[window]
        height, width = self._unseen.shape
        self.camera = camera.crop(int(u[columns[0]]), int(v[rows[0]]), width, height)

    def depth(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """A depth image (h, w), metres, 0 where there is none, as the pinhole camera sees it."""
        focal = np.float32(STEEPEST / self._source.focal)
        out = np.zeros(self._places.shape[:2], np.float32)
        _resample(np.ascontiguousarray(depth, np.float32), self._places, focal, out)
        return out

    def colour(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Colours (h, w, 3) of the same image, resampled likewise; black where there are none."""
        out: NDArray[np.uint8] = rgb.reshape(-1, 3)[self._nearest]
        out[self._unseen] = 0
        return out


@kernel()
def _resample(
    depth: NDArray[np.float32], places: NDArray[np.float32], steepest: np.float32, out: NDArray[np.float32]
) -> None:
    """Depth at places (h', w', 2) of an image; the nearest pixel decides whether there is a depth.

    Of its neighbours those count that may be of the same surface: their depth differs by at most ``steepest``
    times the depth.
    """
    height, width = depth.shape
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            row, column = places[i, j, 0], places[i, j, 1]
            if np.isnan(row):
                continue
            v, u = min(max(int(row + 0.5), 0), height - 1), min(max(int(column + 0.5), 0), width - 1)
            near = depth[v, u]
            if not near > 0:
                continue
            v0, u0 = min(max(int(row), 0), height - 2), min(max(int(column), 0), width - 2)
            down, right = row - v0, column - u0
            weights = inverse = np.float32(0)
            for a in range(2):
                for b in range(2):
                    z = depth[v0 + a, u0 + b]
                    if z > 0 and abs(z - near) <= steepest * near:
                        w = (down if a else 1 - down) * (right if b else 1 - right)
                        w = max(w, np.float32(0))
                        weights += w
                        inverse += w / z
            out[i, j] = weights / inverse if weights > 0 else near
