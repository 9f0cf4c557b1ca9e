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

"""Extended fast point feature histogram: the 180 numbers that describe one view of the target.

Every point is compared with the cloud's centroid by four pair features, each counted into 45 bins:
f1 in bins 0..44, f2 in 45..89, f3 in 90..134, f4 in 135..179, as in the first 180 bins of PCL's
viewpoint feature histogram. Trowbridge 2014, section 2.2.3, eq. 2.9-2.18; where the print and PCL
disagree (the argument order of atan2, the exchange of the two points), PCL is followed, because its
code made the thesis's numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.geometry import Array
from debris_scanner.parameters import ParameterError, parameter

BINS = 45  # a feature
SIZE = 4 * BINS
BINNINGS = ('pcl_1_7_1', 'pcl_1_13')


@dataclass(frozen=True)
class DescriptorSettings:
    """How pair features become bins; the defaults are the closest to Trowbridge 2014, eq. 2.18."""

    binning: str = parameter(
        'pcl_1_7_1', 'PCL release whose bin layout is used: pcl_1_7_1 (the thesis) or pcl_1_13'
    )
    size_component: bool = parameter(True, 'fill the distance bins; without them scale is not described')
    normalise_distance: bool = parameter(
        True, 'scale distances by the largest one; otherwise bins of 1 cm are used'
    )

    def __post_init__(self) -> None:
        if self.binning not in BINNINGS:
            raise ParameterError(f'binning {self.binning!r} is none of {", ".join(BINNINGS)}')


@dataclass(frozen=True)
class PairFeatures:
    """Pair features of the points that have them, each (n,): f1 in radians, f2, f3, f4 in metres."""

    f1: Array
    f2: Array
    f3: Array
    f4: Array


def pair_features(
    points: NDArray[np.floating], normals: NDArray[np.floating], centroid: Array, mean_normal: Array
) -> PairFeatures:
    """Darboux-frame features of every point relative to the centroid, Trowbridge 2014, eq. 2.9-2.14.

    Args:
        points: (n, 3) metres, finite.
        normals: (n, 3) unit.
        centroid: (3,) metres.
        mean_normal: (3,) arithmetic mean of the normals; PCL leaves it shorter than 1, and so must the
            caller, since its length decides which of the two points carries the frame.

    Points on the centroid, or whose direction to it is parallel to the chosen normal, have no frame
    and are left out, so the result may be shorter than the input.
    """
    # One contiguous array a coordinate: twice as fast as (n, 3) arithmetic, and it reads as the formulas.
    x, y, z = np.ascontiguousarray(points.T, dtype=np.float64) - centroid[:, None]
    nx, ny, nz = np.ascontiguousarray(normals.T, dtype=np.float64)
    cx, cy, cz = (float(c) for c in mean_normal)

    f4 = np.sqrt(x * x + y * y + z * z)
    with np.errstate(divide='ignore', invalid='ignore'):
        a1 = (cx * x + cy * y + cz * z) / f4
        a2 = (nx * x + ny * y + nz * z) / f4
        # acos|a1| > acos|a2|: the point's own normal lies closer to the line and carries the frame.
        swap = np.abs(a1) < np.abs(a2)
        f3 = np.where(swap, -a2, a1)
        sign = np.where(swap, -1.0, 1.0)
        ux, uy, uz = np.where(swap, nx, cx), np.where(swap, ny, cy), np.where(swap, nz, cz)
        mx, my, mz = np.where(swap, cx, nx), np.where(swap, cy, ny), np.where(swap, cz, nz)

        vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
        length = np.sqrt(vx * vx + vy * vy + vz * vz)
        scale = sign / length
        vx, vy, vz = vx * scale, vy * scale, vz * scale
        f2 = vx * mx + vy * my + vz * mz
        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        f1 = np.arctan2(wx * mx + wy * my + wz * mz, ux * mx + uy * my + uz * mz)

    keep = (f4 > 0) & (length > 0)
    if keep.all():
        return PairFeatures(f1, f2, f3, f4)
    return PairFeatures(f1[keep], f2[keep], f3[keep], f4[keep])


def counts(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    settings: DescriptorSettings | None = None,
) -> Array:
    """Number of points in each of the 180 bins (PCL's histogram with bin normalisation off).

    Args:
        points: (n, 3) metres, any frame.
        normals: (n, 3) unit, consistently towards the sensor.
        settings: the binning; default as :class:`DescriptorSettings`.

    Rows that are not finite, and rows whose normal is zero (no plane fitted), are ignored.

    Raises:
        ValueError: for shapes that do not match.
    """
    settings = settings or DescriptorSettings()
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != normals.shape:
        raise ValueError(f'points {points.shape} and normals {normals.shape} must both be (n, 3)')
    usable = np.isfinite(points).all(axis=1) & np.isfinite(normals).all(axis=1) & normals.any(axis=1)
    if not usable.all():
        points, normals = points[usable], normals[usable]
    if not len(points):
        return np.zeros(SIZE)

    centroid = points.mean(axis=0, dtype=np.float64)
    features = pair_features(points, normals, centroid, normals.mean(axis=0, dtype=np.float64))
    parts = [_angle(features.f1)]
    if settings.binning == 'pcl_1_13':
        # Since 1.10 PCL bins the two cosines as if they were angles: only bins 15..29 are reached.
        parts += [_angle(features.f2), _angle(features.f3)]
    else:
        parts += [_cosine(features.f2), _cosine(features.f3)]
    if settings.size_component:
        parts.append(_distance(features.f4, settings))
    histogram = np.zeros(SIZE)
    for k, part in enumerate(parts):
        bins = np.clip(part, 0, BINS - 1).astype(np.int64)
        histogram[k * BINS : (k + 1) * BINS] = np.bincount(bins, minlength=BINS)
    return histogram


def efpfh(
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    settings: DescriptorSettings | None = None,
) -> Array:
    """Histogram (180,) that sums to 1, Trowbridge 2014, eq. 2.18 and 2.88; arguments as :func:`counts`.

    All zero when no point is usable.
    """
    histogram = counts(points, normals, settings)
    total = histogram.sum()
    return histogram / total if total > 0 else histogram


def _angle(f: Array) -> Array:
    return np.floor(BINS * (f + np.pi) / (2.0 * np.pi))


def _cosine(f: Array) -> Array:
    return np.floor(BINS * (f + 1.0) / 2.0)


def _distance(f4: Array, settings: DescriptorSettings) -> Array:
    if not settings.normalise_distance:
        return np.floor(100.0 * f4 + 0.5)  # C's round; numpy's rounds halves to even
    furthest = f4.max(initial=0.0)
    if settings.binning == 'pcl_1_13':
        # Since 1.7.2 the homogeneous 1 of PCL's centroid leaks into the largest distance.
        furthest = np.sqrt(furthest**2 + 1.0)
    return np.floor(BINS * f4 / furthest) if furthest > 0 else np.zeros_like(f4)
