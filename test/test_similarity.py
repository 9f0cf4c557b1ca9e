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
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from debris_scanner.mapping.descriptors import (
    SIZE,
    SimilarityWindow,
    binary_similarity,
    float_similarity,
    normalised_similarity,
)

HISTOGRAM = hnp.arrays(float, SIZE, elements=st.floats(0, 1, width=32)).filter(lambda h: h.sum() > 0)


@settings(derandomize=True, max_examples=60)
@given(HISTOGRAM, HISTOGRAM)
def test_float_similarity_is_bounded_symmetric_and_one_for_equals(u, v):
    u, v = u / u.sum(), v / v.sum()
    p = float_similarity(u, np.array([u, v]))
    assert p[0] == pytest.approx(1.0, abs=1e-12)
    assert 0.0 <= p[1] <= 1.0 + 1e-12
    assert p[1] == pytest.approx(float_similarity(v, u[None])[0], abs=1e-12)


def test_float_similarity_by_hand():
    u, v = np.zeros(SIZE), np.zeros(SIZE)
    u[:2] = 0.5
    v[1:3] = 0.5
    # Half of each is shared: 0.5 / (1 + 1 - 0.5).
    assert float_similarity(u, v[None])[0] == pytest.approx(1 / 3)
    assert float_similarity(u, np.roll(u, 90)[None])[0] == 0.0


def test_float_similarity_of_empty_histograms_is_zero():
    assert float_similarity(np.zeros(SIZE), np.zeros((2, SIZE))).tolist() == [0.0, 0.0]


def test_float_similarity_of_single_precision_rows():
    h = np.random.default_rng(0).random((50, SIZE)).astype(np.float32)
    h /= h.sum(axis=1, keepdims=True)
    single = float_similarity(h[0], h)
    np.testing.assert_allclose(single, float_similarity(h[0].astype(float), h.astype(float)), atol=1e-6)


def test_binary_similarity_values():
    np.testing.assert_allclose(binary_similarity(np.array([0, 60, 180])), [1.0, 0.5, 0.0])


def test_binary_similarity_falls_with_every_bit():
    p = binary_similarity(np.arange(SIZE + 1))
    assert (np.diff(p) < 0).all()


def test_six_sigma_window_spans_zero_to_one():
    p = np.array([0.9 - 0.15, 0.9, 0.9 + 0.15, 0.5, 1.2])
    np.testing.assert_allclose(normalised_similarity(p, 0.9, 0.05), [0.0, 0.5, 1.0, 0.0, 1.0], atol=1e-12)


def test_without_spread_nothing_is_told_apart():
    assert normalised_similarity(np.array([0.2, 0.9]), 0.9, 0.0).tolist() == [0.5, 0.5]


def test_window_equals_moments_of_all_batches():
    rng = np.random.default_rng(5)
    batches = [rng.normal(0.95, 0.001, n) for n in (0, 1, 7, 500, 2)]
    window = SimilarityWindow()
    assert window.sigma == 0.0
    for batch in batches:
        window.add(batch)
    everything = np.concatenate(batches)
    assert window.count == len(everything)
    assert window.mean == pytest.approx(everything.mean(), rel=1e-12)
    assert window.sigma == pytest.approx(everything.std(), rel=1e-9)
    np.testing.assert_allclose(
        window.normalise(everything), normalised_similarity(everything, everything.mean(), everything.std())
    )


def test_normalisation_keeps_the_ranking_within_the_window():
    p = binary_similarity(np.array([3, 30, 9, 12]))
    assert np.argsort(normalised_similarity(p, p.mean(), p.std())).tolist() == np.argsort(p).tolist()
