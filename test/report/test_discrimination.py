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

"""Entropy and ROC on cases known by hand."""

import numpy as np
import pytest

from debris_scanner.report.discrimination import ENTROPY_BINS, area_under, entropy_bits, roc


def test_entropy_of_a_constant_and_of_all_bins():
    assert entropy_bits(np.full(100, 0.3)) == 0.0
    assert entropy_bits((np.arange(ENTROPY_BINS) + 0.5) / ENTROPY_BINS) == pytest.approx(6.0)
    assert entropy_bits(np.array([0.1, 0.1, 0.9, 0.9])) == pytest.approx(1.0)
    assert entropy_bits(np.array([0.1, 0.9, 0.9, 0.9])) == pytest.approx(0.811278, abs=1e-6)


def test_entropy_takes_both_ends_and_nothing():
    assert entropy_bits(np.array([0.0, 1.0])) == pytest.approx(1.0)
    assert entropy_bits(np.zeros(0)) == 0.0


def test_roc_of_a_perfect_a_reversed_and_a_blind_measure():
    same = np.array([True, True, False, False, False])
    assert area_under(*roc(np.array([0.9, 0.8, 0.7, 0.2, 0.1]), same)) == 1.0
    assert area_under(*roc(np.array([0.1, 0.2, 0.7, 0.8, 0.9]), same)) == 0.0
    assert area_under(*roc(np.full(5, 0.5), same)) == 0.5


def test_roc_step_by_step():
    false, true = roc(np.array([0.9, 0.7, 0.8, 0.7]), np.array([True, True, False, False]))
    assert false.tolist() == [0.0, 0.0, 0.5, 1.0]
    assert true.tolist() == [0.0, 0.5, 0.5, 1.0]


def test_area_is_the_share_of_pairs_in_the_right_order():
    rng = np.random.default_rng(4)
    values, same = rng.integers(0, 20, 200) / 20, rng.random(200) < 0.3
    difference = values[same][:, None] - values[~same][None]
    expected = ((difference > 0) + 0.5 * (difference == 0)).mean()
    assert area_under(*roc(values, same)) == pytest.approx(expected)


@pytest.mark.parametrize('same', [[True, True], [False, False]])
def test_one_kind_alone_has_no_curve(same):
    with pytest.raises(ValueError, match='both kinds'):
        roc(np.array([0.1, 0.2]), np.array(same))
