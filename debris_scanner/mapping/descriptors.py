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

"""View descriptors (EFPFH), float and binary, and how similar they make two views.

The extended fast point feature histogram describes one view by 180 numbers. Every point is compared with the
cloud's centroid by four pair features, each counted into 45 bins: f1 in bins 0..44, f2 in 45..89, f3 in
90..134, f4 in 135..179, as in the first 180 bins of PCL's viewpoint feature histogram (Trowbridge 2014,
section 2.2.3, eq. 2.9-2.18). Where print and PCL disagree (argument order of atan2, exchange of the two
points) PCL is followed, because its code made the thesis's numbers.

Binary EFPFH keeps one bit a bin, 180 bits in three 64-bit words (section 2.9, eq. 2.68-2.72). The bit says
that the bin exceeds a threshold: the histogram's own median (the thesis), its own mean (the thesis's
counter-example), or, better than either, that bin's median over all frames so far. The difference of two
descriptors is their exclusive or; the printed eq. 2.69 (u and not v) is not symmetric and contradicts its own
text.

Similarity is the Jaccard coefficient of two histograms, 0..1 (sections 2.10.3, 2.10.4 and 5.3). Every
function compares one view with many.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.optional import kernel
from debris_scanner.core.parameters import ParameterError, parameter

BINS = 45  # a feature
SIZE = 4 * BINS
BINNINGS = ('pcl_1_7_1', 'pcl_1_13')
WORDS = 3
Words = NDArray[np.uint64]
_PADDING = WORDS * 64 - SIZE
MIN_SIGMA = 1e-9  # a smaller spread is rounding


@dataclass(frozen=True)
class DescriptorSettings:
    """How pair features become bins; the defaults are the closest to Trowbridge 2014, eq. 2.18."""

    binning: str = parameter('pcl_1_7_1', 'PCL bin layout: pcl_1_7_1 (the thesis) or pcl_1_13')
    size_component: bool = parameter(True, 'fill the distance bins; without them scale is not described')
    normalise_distance: bool = parameter(True, 'scale distances by the largest; else bins of 1 cm')

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
        mean_normal: (3,) arithmetic mean of the normals, not normalised, as in PCL: its length decides which
            of the two points carries the frame.

    A point on the centroid has no frame, nor has one whose direction to it is parallel to the chosen normal.
    Such points are left out, so the result may be shorter than the input.
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


def median_threshold(histograms: NDArray[np.floating]) -> NDArray[np.floating]:
    """Threshold (..., 1) of each histogram (..., 180): its own median, as in the thesis."""
    return np.asarray(np.median(histograms, axis=-1, keepdims=True))


def mean_threshold(histograms: NDArray[np.floating]) -> NDArray[np.floating]:
    """Threshold (..., 1) of each histogram (..., 180): its own mean, Trowbridge 2014, fig. 5.6."""
    return np.asarray(np.mean(histograms, axis=-1, keepdims=True))


def binarise(histograms: NDArray[np.floating], threshold: NDArray[np.floating]) -> Words:
    """Bits of histograms (..., 180), set where a bin exceeds its threshold, packed into (..., 3) words.

    ``threshold`` broadcasts against the histograms. Bin k is bit k % 64 of word k // 64; the twelve
    bits beyond 180 are zero. A bin equal to its threshold gives 0, so an empty bin is always 0.
    """
    bits = histograms > threshold
    padded = np.concatenate([bits, np.zeros((*bits.shape[:-1], _PADDING), dtype=bool)], axis=-1)
    return np.packbits(padded, axis=-1, bitorder='little').view('<u8').astype(np.uint64, copy=False)


def hamming(word: Words, words: Words) -> NDArray[np.int64]:
    """Number of differing bits, 0..180, between one descriptor (3,) and many (n, 3)."""
    return np.asarray(np.bitwise_count(word ^ words).sum(axis=-1, dtype=np.int64))


class PerBinThreshold:
    """Binary descriptors of all frames so far, each bin thresholded at its median over those frames.

    The medians move as frames arrive, which changes the bits of earlier frames. So the float histograms
    are kept (720 bytes a frame), and all bits are recomputed whenever the number of frames has grown by a
    tenth: the work a frame stays constant on average. In between, a new frame is cut at the current medians.
    """

    def __init__(self) -> None:
        self._histograms = np.empty((64, SIZE), dtype=np.float32)
        self._words = np.empty((64, WORDS), dtype=np.uint64)
        self._threshold = np.zeros(SIZE, dtype=np.float32)
        self._count = 0
        self._refresh_at = 1

    def __len__(self) -> int:
        return self._count

    @property
    def threshold(self) -> NDArray[np.float32]:
        """Current medians, (180,)."""
        return self._threshold

    @property
    def histograms(self) -> NDArray[np.float32]:
        """Float histograms of all frames, (n, 180), in order of arrival."""
        return self._histograms[: self._count]

    @property
    def words(self) -> Words:
        """Binary descriptors of all frames, (n, 3), in order of arrival; all cut at ``threshold``."""
        return self._words[: self._count]

    def add(self, histogram: NDArray[np.floating]) -> int:
        """Append the histogram (180,) of a new frame; returns its index."""
        index = self._count
        if index == len(self._words):
            self._histograms = np.concatenate([self._histograms, np.empty_like(self._histograms)])
            self._words = np.concatenate([self._words, np.empty_like(self._words)])
        self._histograms[index] = histogram
        self._count += 1
        if self._count >= self._refresh_at:
            self._refresh_at = self._count + max(1, self._count // 10)
            # A contiguous row a bin: the partial sort behind the median then runs along memory.
            self._threshold = np.median(np.ascontiguousarray(self.histograms.T), axis=1)
            self._words[: self._count] = binarise(self.histograms, self._threshold)
        else:
            self._words[index] = binarise(self._histograms[index], self._threshold)
        return index

    def hamming_to_earlier(self, index: int) -> NDArray[np.int64]:
        """Hamming distances (index,) of one frame to all that arrived before it."""
        return hamming(self._words[index], self._words[:index])


def float_similarity(histogram: NDArray[np.floating], histograms: NDArray[np.floating]) -> Array:
    """P_s,f (n,) of a histogram (180,) against many (n, 180), Trowbridge 2014, eq. 2.86-2.90.

    Histograms are normalised to sum 1 (eq. 2.88). Two empty ones share nothing: 0.
    """
    dtype = np.float32 if histograms.dtype == np.float32 else np.float64
    # the compiled kernel needs this type, contiguous and writeable
    one, many = (np.require(h, dtype, ['C', 'W']) for h in (histogram, histograms))
    return _jaccard(one, many)


def binary_similarity(distance: NDArray[np.integer]) -> Array:
    """P_s,b of Hamming distances 0..180, Trowbridge 2014, eq. 2.94."""
    return (SIZE - distance) / (SIZE + distance)


def normalised_similarity(similarity: Array, mean: float, sigma: float) -> Array:
    """Similarities scaled so that six sigma about the mean span 0..1, Trowbridge 2014, eq. 5.2.

    Values beyond three sigma are clipped to 0 and 1, so that the joint probability stays defined.
    Without spread (sigma near 0) all become 0.5.
    """
    if sigma < MIN_SIGMA:
        return np.full_like(similarity, 0.5, dtype=np.float64)
    return np.clip((similarity - mean) / (6.0 * sigma) + 0.5, 0.0, 1.0)


class SimilarityWindow:
    """Mean and standard deviation of all similarities seen so far, for :func:`normalised_similarity`."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._squares = 0.0  # summed squared deviations from the mean

    @property
    def sigma(self) -> float:
        """Standard deviation of the sample; 0 while it is empty."""
        return float(np.sqrt(self._squares / self.count)) if self.count else 0.0

    def add(self, similarity: Array) -> None:
        """Add a batch (n,) to the sample."""
        n = similarity.size
        if n == 0:
            return
        mean = float(similarity.mean())
        # Merging moments about each batch's own mean keeps the digits that sums of squares lose.
        shift = mean - self.mean
        total = self.count + n
        self._squares += float(((similarity - mean) ** 2).sum()) + shift**2 * self.count * n / total
        self.mean += shift * n / total
        self.count = total

    def normalise(self, similarity: Array) -> Array:
        """Similarities (n,) normalised by the current window."""
        return normalised_similarity(similarity, self.mean, self.sigma)


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


@kernel(fastmath=True)
def _jaccard(histogram: NDArray[np.floating], histograms: NDArray[np.floating]) -> Array:
    """One pass over the histograms: numpy would write a copy of them all first."""
    similarity = np.zeros(len(histograms))
    for k in range(len(histograms)):
        shared = either = 0.0
        for b in range(len(histogram)):
            shared += min(histogram[b], histograms[k, b])
            either += max(histogram[b], histograms[k, b])
        if either > 0:
            similarity[k] = shared / either
    return similarity
