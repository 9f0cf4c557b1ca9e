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

"""A smooth error of the depth that stays in the image, and the images freed from it.

Lens and electronics of a time-of-flight camera, or the correlation of a stereo camera, make a depth wrong by
the same share at the same pixel of every frame. It is some tenths of a per cent, but the next pixels are
wrong alike, so that no average over a face removes it: it bends every face, and differently as the target
turns.

The share is a cubic B-spline over the tangents x / z and y / z of a pixel's ray, on a lattice of equal steps
in both. Beyond the lattice it stays as it is at the border. It is measured on the scan itself
(:mod:`debris_scanner.mapping.self_calibration`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.sensing.normals import NormalSettings, fit_normals

SUPPORT = 4  # coefficients, in each direction, that a cubic spline's value is made of
LARGEST_SHARE = 0.1  # of the depth: no sensor is so wrong


@dataclass(frozen=True)
class DepthOffset:
    """Share of the depth that is measured too much, by the tangents of the ray."""

    step: float  # tangent between neighbours of the lattice
    first: tuple[int, int]  # steps from the optical axis to where its first cell begins
    coefficients: Array  # (columns, rows)
    seen: Array | None = None  # share (columns, rows) that each had in what it was found by

    @staticmethod
    def none_over(low: Array, high: Array, step: float) -> 'DepthOffset':
        """No offset, on a lattice that covers all tangents (2,) from ``low`` to ``high``."""
        first, last = np.floor(low / step).astype(int), np.floor(high / step).astype(int)
        return DepthOffset(step, (int(first[0]), int(first[1])), np.zeros(last - first + SUPPORT))

    def covering(self, low: Array, high: Array) -> 'DepthOffset':
        """The same on a lattice that covers tangents (2,) from ``low`` to ``high`` as well."""
        first = np.minimum(np.floor(low / self.step).astype(int), self.first)
        own_last = np.array(self.first) + self.coefficients.shape - SUPPORT
        last = np.maximum(np.floor(high / self.step).astype(int), own_last)
        before, after = np.array(self.first) - first, last - own_last
        values = np.pad(self.coefficients, list(zip(before, after, strict=True)), mode='edge')
        return DepthOffset(self.step, (int(first[0]), int(first[1])), values)

    def resampled(self, lattice: 'DepthOffset') -> 'DepthOffset':
        """The same on the lattice of another, as nearly as that allows."""
        if self.is_none:
            return lattice
        axes = []
        for axis, count in enumerate(lattice.coefficients.shape):
            nodes = lattice.step * (lattice.first[axis] + np.linspace(0, count - SUPPORT + 1, 2 * count))
            axes.append(np.linalg.pinv(lattice._weights(nodes, axis).toarray()) @ self._weights(nodes, axis))
        across, down = axes
        return DepthOffset(lattice.step, lattice.first, np.asarray(across @ self.coefficients @ down.T))

    def share(self, camera: Camera) -> Array:
        """The share (h, w) of each pixel of a camera."""
        columns, rows = np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float)
        across = self._weights((columns - camera.cx) / camera.fx, 0)
        down = self._weights((rows - camera.cy) / camera.fy, 1)
        return np.asarray(down @ (across @ self.coefficients).T)

    def freed(self, frame: TargetFrame, normals: NormalSettings) -> TargetFrame:
        """A frame as it would be without the offset, its planes fitted again; itself if there is none."""
        if self.is_none and frame.raw is None:
            return frame
        return self.target_frame(frame.stamp_ns, frame.camera, frame.measured, normals, frame.rgb)

    def target_frame(
        self,
        stamp_ns: int,
        camera: Camera,
        measured: NDArray[np.float32],
        normals: NormalSettings,
        rgb: NDArray[np.uint8] | None = None,
    ) -> TargetFrame:
        """A frame of what the sensor measured: depth (h, w), metres, and colours (h, w, 3) of a window."""
        depth, raw = measured, None
        if not self.is_none:
            depth, raw = np.asarray(measured * (1 - self.share(camera)), np.float32), measured
        fitted, directions = fit_normals(depth, camera, normals)
        return TargetFrame(stamp_ns, camera, depth, fitted, directions, rgb, raw)

    @property
    def is_none(self) -> bool:
        """Whether there is no offset anywhere."""
        return not self.coefficients.any()

    @property
    def rms(self) -> float:
        """Root mean square of the share, where it was seen."""
        return float(np.sqrt(np.average(self.coefficients**2, weights=self.seen)))

    @property
    def length(self) -> float:
        """Tangent at which the correlation has fallen to 1/e, were it Gaussian; 0 without an offset."""
        if self.is_none:
            return 0.0
        c, seen = self.coefficients, self.seen if self.seen is not None else np.ones_like(self.coefficients)
        across = np.average(np.diff(c, axis=0) ** 2, weights=np.sqrt(seen[1:] * seen[:-1]))
        down = np.average(np.diff(c, axis=1) ** 2, weights=np.sqrt(seen[:, 1:] * seen[:, :-1]))
        # a field with the correlation exp(-d² / l²) has slopes of the mean square 2 rms² / l² each
        return 2 * self.rms * self.step / float(np.sqrt(across + down))

    def _weights(self, tangents: Array, axis: int) -> Any:
        """Sparse weights (n, coefficients along the axis) of the coefficients at tangents (n,)."""
        count = self.coefficients.shape[axis]
        place = np.clip(tangents / self.step - self.first[axis], 0, count - SUPPORT + 1 - 1e-9)
        knots = np.arange(count + SUPPORT) - SUPPORT + 1.0
        return scipy.interpolate.BSpline.design_matrix(place, knots, SUPPORT - 1)


def spline_weights(t: Any) -> tuple[Any, Any, Any, Any]:
    """Weights of the four coefficients at a place in a cell, 0 to 1; plain, for it is compiled, too."""
    return (1 - t) ** 3 / 6, (3 * t**3 - 6 * t**2 + 4) / 6, (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6, t**3 / 6


NO_OFFSET = DepthOffset(1.0, (0, 0), np.zeros((SUPPORT, SUPPORT)))
