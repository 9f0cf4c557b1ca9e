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

"""Entropy and ROC against values worked out by hand, and the pooling of section 5.3."""

import numpy as np
import pytest

from debris_scanner.report.discrimination import area_under, entropy_bits, roc
from debris_scanner.research.reproduce.heuristics import ATTITUDE, Pool, summary
from debris_scanner.research.reproduce.likeness import Likeness
from debris_scanner.research.reproduce.likeness_figures import chosen_row
from debris_scanner.research.thesis.loop_closures import similarities
from debris_scanner.research.thesis.settings import SIMILARITIES


@pytest.mark.parametrize(
    ('values', 'bits'),
    [
        ([0.3] * 7, 0.0),  # one value says nothing
        ([0.1, 0.9], 1.0),
        ([0.1, 0.3, 0.6, 0.9], 2.0),
        ([0.1, 0.1, 0.1, 0.9], 0.8113),  # -(3/4 log2 3/4 + 1/4 log2 1/4)
        (np.linspace(0, 1, 6400, endpoint=False), 6.0),  # 64 bins, all alike
    ],
)
def test_entropy_sums_over_the_distinct_values(values, bits):
    assert entropy_bits(np.array(values)) == pytest.approx(bits, abs=1e-3)


def test_roc_of_four_pairs():
    values = np.array([0.9, 0.8, 0.7, 0.1])
    false, true = roc(values, np.array([True, False, True, False]))
    assert false.tolist() == [0, 0, 0.5, 0.5, 1]
    assert true.tolist() == [0, 0.5, 0.5, 1, 1]
    assert area_under(false, true) == 0.75  # of the four mixed pairs of pairs, three stand in the right order


def test_roc_of_equal_values_is_a_coin():
    false, true = roc(np.full(6, 0.5), np.array([True, False] * 3))
    assert area_under(false, true) == 0.5


@pytest.fixture
def likeness():
    """Eight frames over two turns of four faces each."""
    faces = np.random.default_rng(3).dirichlet(np.full(180, 0.2), 4)
    histograms = np.concatenate([faces, faces])
    n = len(histograms)
    path = np.arange(n) * np.pi / 2
    apart = np.abs((path[:, None] - path[None] + np.pi) % (2 * np.pi) - np.pi)
    lower = np.tril(np.ones((n, n), bool), -1)
    return Likeness(
        np.arange(n) * 10**9,
        histograms,
        {kind: similarities(histograms, kind) for kind in SIMILARITIES},
        np.where(lower, 1 - apart / np.pi, np.nan),
        apart < 0.1,
        path,
    )


def test_late_pairs_are_those_of_the_last_half(likeness):
    rows, columns = np.nonzero(likeness.late)
    assert rows.min() == 4
    assert (columns < rows).all()
    assert len(rows) == 4 + 5 + 6 + 7


def test_pairs_apart_have_half_a_turn_in_between(likeness):
    rows, columns = np.nonzero(likeness.apart)
    assert (rows - columns).min() == 2
    assert len(rows) == sum(range(1, 7))


def test_measures_that_find_the_same_face_have_area_one(likeness):
    late, apart = Pool.of([likeness, likeness], late=True), Pool.of([likeness, likeness], late=False)
    assert len(late.attitude) == 2 * 22
    assert apart.same.sum() == 2 * 4
    lines = summary(late, apart)
    assert set(lines) == {ATTITUDE, *SIMILARITIES, *(f'joint_{k}' for k in SIMILARITIES)}
    for kind in ('float', 'binary_median', 'binary_mean', ATTITUDE, 'joint_float'):
        assert lines[kind]['roc_area'] == 1.0, kind
    assert lines['float']['mean'] == pytest.approx(late.similarity['float'].mean(), abs=1e-4)


def test_without_a_pair_of_the_same_face_there_is_no_curve(likeness):
    nobody = Likeness(
        likeness.stamps,
        likeness.histograms,
        likeness.similarity,
        likeness.attitude,
        np.zeros_like(likeness.same),
        likeness.path,
    )
    pool = Pool.of([nobody], late=False)
    assert pool.curve(pool.attitude) is None
    assert summary(pool, pool)['float']['roc_area'] is None


def test_the_row_that_is_drawn_comes_back_to_an_earlier_face(likeness):
    assert chosen_row(likeness) == 7


def test_likeness_survives_the_file(likeness, tmp_path):
    (tmp_path / 'likeness.npz').write_bytes(likeness.encode())
    again = Likeness.read(tmp_path / 'likeness.npz')
    np.testing.assert_array_equal(again.same, likeness.same)
    for kind in SIMILARITIES:
        np.testing.assert_array_equal(again.similarity[kind], likeness.similarity[kind])
