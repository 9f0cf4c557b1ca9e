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

"""Similarity matrices of all key frames by every measure, for plots and comparisons.

The closure detector computes only the newest key frame's row, in one measure. These matrices are computed at
the end of a scan, with thresholds and moments over all key frames given.
"""

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.results import Descriptions
from debris_scanner.mapping.closure_search import attitude_probability, joint_probability
from debris_scanner.mapping.descriptors import (
    Words,
    binarise,
    binary_similarity,
    float_similarity,
    hamming,
    median_threshold,
    normalised_similarity,
)

MOST_KEYFRAMES = 300  # the last ones of a longer scan: matrices grow with the square
STAMPS = 'stamp_ns'
# Similarity of the views by float descriptors; by binary ones (each thresholded at its own median, as in the
# thesis); by the same normalised (eq. 5.2); by binary ones thresholded bin by bin. Similarity of the
# attitudes. Joint: the last two, by which the detector ranks.
MEASURES = ('float', 'binary', 'normalised', 'per_bin', 'attitude', 'joint')


class ClosureMatricesError(ValueError):
    """A file of closure probabilities that cannot be read; the message names it."""


@dataclass(frozen=True)
class ClosureMatrices:
    """Probabilities that two key frames show the same face, for all pairs."""

    stamps_ns: NDArray[np.int64]  # (n,)
    by_measure: dict[str, NDArray[np.float32]]  # (n, n), symmetric, of each of MEASURES

    @staticmethod
    def of(descriptions: Descriptions) -> 'ClosureMatrices':
        """The matrices of the last ``MOST_KEYFRAMES`` key frames."""
        stamps = descriptions.stamps_ns[-MOST_KEYFRAMES:]
        histograms = descriptions.histograms[-MOST_KEYFRAMES:]
        R = descriptions.attitudes[-MOST_KEYFRAMES:]
        n = len(stamps)
        if n == 0:
            return ClosureMatrices(stamps, {name: np.zeros((0, 0), np.float32) for name in MEASURES})
        binary = _binary(binarise(histograms, median_threshold(histograms)))
        per_bin = _binary(binarise(histograms, np.median(histograms, axis=0)))
        attitude = _rows(n, lambda k: attitude_probability(R[k], R))
        pairs = binary[np.tril_indices(n, -1)] if n > 1 else np.zeros(1)
        matrices = {
            'float': _rows(n, lambda k: float_similarity(histograms[k], histograms)),
            'binary': binary,
            'normalised': normalised_similarity(binary, float(pairs.mean()), float(pairs.std())),
            'per_bin': per_bin,
            'attitude': attitude,
            'joint': joint_probability(per_bin, attitude),
        }
        return ClosureMatrices(stamps, {name: matrices[name].astype(np.float32) for name in MEASURES})

    def encode(self) -> bytes:
        """As an npz file; the same matrices give the same bytes."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **{STAMPS: self.stamps_ns}, **self.by_measure)  # type: ignore[arg-type]
        return buffer.getvalue()

    @staticmethod
    def read(path: Path) -> 'ClosureMatrices':
        """The matrices in an npz file.

        Raises:
            ClosureMatricesError: the file is not one, or its arrays do not fit each other.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                stamps = np.asarray(file[STAMPS], np.int64)
                matrices = {name: np.asarray(file[name], np.float32) for name in MEASURES}
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
            raise ClosureMatricesError(f'cannot read closure probabilities {path}: {error}') from error
        n = stamps.size
        if any(m.shape != (n, n) for m in matrices.values()):
            raise ClosureMatricesError(f'closure probabilities {path}: no matrix of {n} x {n} key frames')
        return ClosureMatrices(stamps.reshape(n), matrices)


def _binary(words: Words) -> Array:
    return _rows(len(words), lambda k: binary_similarity(hamming(words[k], words)))


def _rows(n: int, row: Callable[[int], Array]) -> Array:
    return np.array([row(k) for k in range(n)])
