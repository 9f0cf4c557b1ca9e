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

"""How alike two views are, judged by their histograms: the Jaccard coefficient, 0..1.

Trowbridge 2014, sections 2.10.3, 2.10.4 and 5.3. Every function compares one view with many.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from debris_scanner.efpfh import SIZE
from debris_scanner.geometry import Array

# A spread below this is rounding: such a sample says nothing about what is usual.
MIN_SIGMA = 1e-9


def float_similarity(histogram: NDArray[np.floating], histograms: NDArray[np.floating]) -> Array:
    """P_s,f (n,) of a histogram (180,) against many (n, 180), Trowbridge 2014, eq. 2.86-2.90.

    Histograms are normalised to sum 1 (eq. 2.88). Two empty ones share nothing: 0.
    """
    dtype = np.float32 if histograms.dtype == np.float32 else np.float64
    # the compiled type; what is read-only is copied
    one, many = (np.require(h, dtype, ['C', 'W']) for h in (histogram, histograms))
    return _jaccard(one, many)


@njit(
    ['float64[::1](float32[::1], float32[:, ::1])', 'float64[::1](float64[::1], float64[:, ::1])'],
    cache=True,
    fastmath=True,
    nogil=True,
    error_model='numpy',
)
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


def binary_similarity(distance: NDArray[np.integer]) -> Array:
    """P_s,b of Hamming distances 0..180, Trowbridge 2014, eq. 2.94."""
    return (SIZE - distance) / (SIZE + distance)


def normalised_similarity(similarity: Array, mean: float, sigma: float) -> Array:
    """Similarities stretched so that six sigma about the mean span 0..1, Trowbridge 2014, eq. 5.2.

    Values beyond three sigma are cut off at 0 and 1, so that the joint probability stays defined.
    Without spread (sigma near 0) nothing can be told apart and all become 0.5.
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
        """Take a batch (n,) into the sample."""
        n = similarity.size
        if n == 0:
            return
        mean = float(similarity.mean())
        # Merging moments about each batch's own mean keeps all digits where sums of squares lose them.
        shift = mean - self.mean
        total = self.count + n
        self._squares += float(((similarity - mean) ** 2).sum()) + shift**2 * self.count * n / total
        self.mean += shift * n / total
        self.count = total

    def normalise(self, similarity: Array) -> Array:
        """Similarities (n,) by the window as it stands."""
        return normalised_similarity(similarity, self.mean, self.sigma)
