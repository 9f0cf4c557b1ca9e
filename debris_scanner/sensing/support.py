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

"""Planes that stand still and reach out of sight: a table that the target stands on, a wall behind it.

What touches such a plane would be one cluster with it. So planes are found among the points that stand still
(RANSAC, Fischler and Bolles 1981), and their points belong to no cluster.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array

MOST_PLANES = 3
UNEVEN = 3.0  # times its noise: what lies so near a plane is its unevenness, or the sensor's
STAND_OUT = 0.01  # of the points so near, from which the spread of all is told
SAMPLE = 500
TRIALS = 80
ROUNDS = 3  # of least squares


class SupportPlanes:
    """Planes (m, 4): unit normal and offset, so that n x + d is a point's height, metres."""

    def __init__(self) -> None:
        self.planes = np.zeros((0, 4))
        self._uneven: list[float] = []  # of each plane, in multiples of the noise

    def learn(
        self,
        points: Array,
        seen: Array,
        tolerance: Array,
        out: NDArray[np.bool_],
        least: float,
        speck: float,
    ) -> None:
        """Find the planes of points that stand still, those with most points first.

        Args:
            points: (n, 3), where they have stood.
            seen: (n, 3), the same pixels in one image: what passes in front of them, too.
            tolerance: (n,), the height that is a point's noise.
            out: (n,), the point lies where the view ends.
            least: so many points of a plane do.
            speck: fewer points than this are no target.
        """
        rng = np.random.default_rng(0)
        planes: list[Array] = []
        rest = np.ones(len(points), np.bool_)
        while len(planes) < MOST_PLANES:
            index = np.flatnonzero(rest)
            if np.count_nonzero(out[index]) <= least:
                break
            chosen = rng.choice(index, min(SAMPLE, len(index)), replace=False)
            plane = _ransac(points[chosen], tolerance[chosen], rng)
            for _ in range(ROUNDS if plane is not None else 0):
                near = index[np.abs(heights(points[index], plane)) < tolerance[index]]
                if len(near) < 3:
                    plane = None
                    break
                plane = _fit(points[near])
            if plane is None:
                break
            height = np.abs(heights(points[index], plane)) / tolerance[index]
            if np.count_nonzero(out[index[height < 1]]) <= least:
                break
            near = index[height < UNEVEN]
            stand_out = np.abs(heights(seen[near], plane)) / tolerance[near]
            planes.append(plane)
            self._uneven.append(_unevenness(stand_out[stand_out < UNEVEN], speck))
            rest[index[height < self._uneven[-1]]] = False
        self.planes = np.array(planes).reshape(-1, 4)

    @property
    def uneven_planes(self) -> Array:
        """Planes (m, 5), each with the height below which a point is its own, in multiples of the noise."""
        return np.column_stack([self.planes, self._uneven])


def heights(points: Array, plane: Array | None) -> Array:
    """Signed distances (n,) of points (n, 3) from a plane (4,)."""
    assert plane is not None
    return np.asarray(points @ plane[:3] + plane[3])


def _unevenness(height: Array, speck: float) -> float:
    """How far a plane's points (n,) stand out of it, in multiples of the noise, all but a speck of them.

    A thing that stands still on the plane stands out, too: no further than a normal distribution goes.
    """
    if not len(height):  # something hides all of it
        return 1.0
    beyond = min(STAND_OUT, speck / len(height))
    usual, far = np.quantile(height, [1 - STAND_OUT, 1 - beyond])
    normal = float(scipy.special.ndtri(1 - beyond / 2) / scipy.special.ndtri(1 - STAND_OUT / 2))
    return max(1.0, min(float(far), float(usual) * normal))


def _ransac(points: Array, tolerance: Array, rng: np.random.Generator) -> Array | None:
    """The plane through three of the points that most of them lie in."""
    best, most = None, 0
    for _ in range(TRIALS):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length == 0:
            continue
        plane = np.append(normal / length, -normal @ a / length)
        inside = int(np.count_nonzero(np.abs(heights(points, plane)) < tolerance))
        if inside > most:
            best, most = plane, inside
    return best


def _fit(points: Array) -> Array:
    """The plane of least squares through points (n, 3)."""
    middle = points.mean(axis=0)
    normal = np.linalg.svd((points - middle)[:: max(1, len(points) // 5000)], full_matrices=False)[2][2]
    return np.append(normal, -normal @ middle)
