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

"""Binary EFPFH: one bit a histogram bin, 180 bits in three 64-bit words.

Trowbridge 2014, section 2.9, eq. 2.68-2.72. A bit says that the bin holds more than a threshold: the
histogram's own median (the thesis), its own mean (the thesis's counter-example), or, better than
either, that bin's median over all frames seen so far. The difference of two descriptors is their
exclusive or; the printed eq. 2.69 (u and not v) is not symmetric and contradicts its own text.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.efpfh import SIZE

WORDS = 3
Words = NDArray[np.uint64]
_PADDING = WORDS * 64 - SIZE


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
    """Binary descriptors of all frames so far, each bin cut at its median over those frames.

    The medians move as frames arrive, which changes the bits of earlier frames. Float histograms are
    therefore kept (720 bytes a frame) and all bits are made anew whenever the number of frames has
    grown by a tenth since the last time: every frame up to the tenth, then ever more rarely, so that
    the work a frame stays constant on average. In between, a new frame is cut at the medians in force.
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
        """Medians in force, (180,)."""
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
        """Take the histogram (180,) of a new frame; returns its index."""
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
