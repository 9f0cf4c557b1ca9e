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

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra import numpy as hnp

from debris_scanner.mapping.descriptors import (
    SIZE,
    PerBinThreshold,
    binarise,
    hamming,
    mean_threshold,
    median_threshold,
)

BITS = hnp.arrays(bool, SIZE)


def pack(bits):
    return binarise(np.asarray(bits, float), np.array(0.5))


def frames(count, seed=0):
    """Histograms with bins of very different sizes that vary a little from frame to frame."""
    rng = np.random.default_rng(seed)
    level = rng.exponential(size=SIZE)
    h = level * rng.uniform(0.5, 1.5, (count, SIZE))
    return (h / h.sum(axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize('k', [0, 1, 63, 64, 127, 128, 179])
def test_bin_k_is_bit_k_of_the_words(k):
    words = pack(np.arange(SIZE) == k)
    assert words.dtype == np.uint64
    assert [int(w) for w in words] == [1 << (k % 64) if k // 64 == w else 0 for w in range(3)]


@settings(derandomize=True, max_examples=60)
@given(BITS, BITS, BITS)
def test_hamming_is_a_metric_that_counts_differing_bits(u, v, w):
    distance = {(a, b): int(hamming(pack(x), pack(y))) for a, x in zip('uvw', (u, v, w), strict=True)
                for b, y in zip('uvw', (u, v, w), strict=True)}  # fmt: skip
    assert distance['u', 'v'] == (u != v).sum()
    assert distance['u', 'u'] == 0
    assert distance['u', 'v'] == distance['v', 'u']
    assert distance['u', 'w'] <= distance['u', 'v'] + distance['v', 'w']
    assert int(hamming(pack(u), pack(~u))) == SIZE


def test_difference_is_exclusive_or_and_not_the_printed_equation():
    # Eq. 2.69 as printed, u and not v, would find no difference when v only adds bits.
    u, v = np.zeros(SIZE, bool), np.ones(SIZE, bool)
    assert int(hamming(pack(u), pack(v))) == SIZE


def test_one_against_many():
    h = frames(20)
    words = binarise(h, median_threshold(h))
    distances = hamming(words[3], words)
    assert distances.shape == (20,)
    assert distances[3] == 0
    assert distances[7] == hamming(words[3], words[7])


def test_own_median_sets_half_of_the_bits():
    h = frames(5)
    set_bits = hamming(np.zeros(3, np.uint64), binarise(h, median_threshold(h)))
    np.testing.assert_array_equal(set_bits, SIZE // 2)


def test_own_mean_sets_fewer_bits_of_a_peaked_histogram():
    h = frames(5)
    set_bits = hamming(np.zeros(3, np.uint64), binarise(h, mean_threshold(h)))
    assert (set_bits < SIZE // 2).all()
    assert (set_bits > 0).all()


def test_empty_bins_stay_zero():
    h = np.zeros(SIZE)
    h[:10] = 0.1
    assert int(hamming(np.zeros(3, np.uint64), binarise(h, median_threshold(h)))) == 10


def test_threshold_is_the_median_of_each_bin_over_the_frames():
    h = frames(10)
    running = PerBinThreshold()
    for k, row in enumerate(h):
        assert running.add(row) == k
        # Up to the tenth frame the medians are refreshed by every one.
        np.testing.assert_array_equal(running.threshold, np.median(h[: k + 1], axis=0))
        np.testing.assert_array_equal(running.words, binarise(h[: k + 1], running.threshold))


def test_words_of_all_frames_share_the_threshold_in_force():
    h = frames(300)
    running = PerBinThreshold()
    refreshed = set()
    for row in h:
        running.add(row)
        refreshed.add(running.threshold.tobytes())
        np.testing.assert_array_equal(running.words[0], binarise(h[0], running.threshold))
    np.testing.assert_array_equal(running.histograms, h)
    np.testing.assert_array_equal(running.words, binarise(h, running.threshold))
    assert len(refreshed) < 60  # ever more rarely
    # Never based on fewer than nine tenths of the frames, so close to the exact median.
    shift = np.abs(running.threshold - np.median(h, axis=0)) / h.std(axis=0)
    assert shift.max() < 0.3


def test_separates_two_faces_better_than_the_thesis():
    # Two faces differ by a tenth in every bin: their own medians hardly move, the bins' medians do.
    rng = np.random.default_rng(1)
    level = rng.exponential(size=SIZE)
    face = np.where(rng.random(SIZE) < 0.5, 1.1, 1 / 1.1)
    a, b = level * face, level / face
    h = np.array([(a if k % 2 else b) * rng.normal(1, 0.01, SIZE) for k in range(40)])
    h /= h.sum(axis=1, keepdims=True)
    running = PerBinThreshold()
    for row in h:
        running.add(row)
    ours = running.hamming_to_earlier(39)
    thesis_words = binarise(h, median_threshold(h))
    thesis = hamming(thesis_words[39], thesis_words[:39])
    same = np.arange(39) % 2 == 1
    assert ours[~same].min() - ours[same].max() > 90
    assert thesis[~same].min() - thesis[same].max() < 30


def test_ten_thousand_frames_stay_cheap():
    h = frames(2000)
    running = PerBinThreshold()
    refreshes, last = 0, b''
    for row in np.tile(h, (5, 1)):
        running.add(row)
        if running.threshold.tobytes() != last:
            refreshes, last = refreshes + 1, running.threshold.tobytes()
    assert len(running) == 10_000
    assert refreshes < 100
