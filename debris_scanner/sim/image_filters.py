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

"""What a stereo camera's driver makes of its images: filters over space and time, and junk far away.

The filters are those of a RealSense by their defaults (Grunnet-Jepsen and Tong 2018, Depth post-processing
for Intel RealSense D400 depth cameras): both work in disparity, and leave alone what differs by more than a
step. The spatial one is a domain transform (Gastal and Oliveira 2011), which runs along rows and columns.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.optional import kernel

STEP = 0.0186  # 1/m: 20 of a disparity's steps of 1/32 pixel, of a D415's 612 px and 55 mm
SPATIAL_SHARE, PASSES = 0.5, 2  # of the pixel itself, at each step along a line; of all four directions
TEMPORAL_SHARE = 0.4  # of the new image
REMEMBERED, ENOUGH = 4, 2  # images; a pixel that was seen in so many of them keeps its depth when it vanishes
JUNK_M, JUNK_PX = (10.0, 12.0), 7  # distance of junk, and side of its patches

Depth = NDArray[np.float32]


def spatially_filtered(depth: Depth) -> Depth:
    """A depth image (h, w), metres, 0 invalid, smoothed up to its edges."""
    inverse = _inverse(depth)
    for _ in range(PASSES):
        _smooth(inverse)
        _smooth(inverse.T)
    return _inverse(inverse)


@dataclass(frozen=True)
class TemporalFilter:
    """State after an image: what was sent, and in which of the latest images each pixel was seen."""

    inverse: Depth  # (h, w), 1/m, 0 invalid
    seen: NDArray[np.uint8]  # (h, w), one bit an image, the latest is the lowest

    @staticmethod
    def begin(shape: tuple[int, ...]) -> 'TemporalFilter':
        """Before the first image."""
        return TemporalFilter(np.zeros(shape, np.float32), np.zeros(shape, np.uint8))

    def after(self, depth: Depth) -> 'TemporalFilter':
        """The state after one more image (h, w), metres, 0 invalid."""
        new, old = _inverse(depth), self.inverse
        same = (new > 0) & (old > 0) & (np.abs(new - old) < STEP)
        sent = np.where(same, old + np.float32(TEMPORAL_SHARE) * (new - old), new)
        often = np.bitwise_count(self.seen) >= ENOUGH
        sent = np.where((new == 0) & often, old, sent)
        seen = (self.seen << 1 | (new > 0)) & (2**REMEMBERED - 1)
        return TemporalFilter(sent, seen.astype(np.uint8))

    @property
    def depth(self) -> Depth:
        """The image that is sent."""
        return _inverse(self.inverse)


def with_junk(depth: Depth, share: float, rng: np.random.Generator) -> Depth:
    """A depth image (h, w) of which a share, in small patches, is said to be far away."""
    depth = depth.copy()
    for _ in range(rng.poisson(share * depth.size / JUNK_PX**2)):
        v, u = (int(rng.integers(0, n - JUNK_PX)) for n in depth.shape)
        depth[v : v + JUNK_PX, u : u + JUNK_PX] = rng.uniform(*JUNK_M)
    return depth


def _inverse(values: Depth) -> Depth:
    """One over each value; 0 stays 0."""
    return np.divide(np.float32(1), values, out=np.zeros_like(values), where=values > 0)


@kernel()
def _smooth(image: Depth) -> None:
    """Filter the rows of an image (h, w) in place, to the right and back."""
    for v in range(image.shape[0]):
        row = image[v]
        for way in range(2):
            before = np.float32(0)
            for k in range(image.shape[1]):
                u = image.shape[1] - 1 - k if way else k
                if row[u] > 0 and before > 0 and abs(row[u] - before) < STEP:
                    row[u] = before + SPATIAL_SHARE * (row[u] - before)
                before = row[u]
