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

"""How well a measure of likeness distinguishes the same face from others: entropy and ROC.

Trowbridge 2014, section 5.3. Its eq. 5.1 sums over the data; entropy sums over the distinct values,
here over equal bins between 0 and 1.
"""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array

ENTROPY_BINS = 64


def entropy_bits(values: Array) -> float:
    """Shannon entropy of values (n,) between 0 and 1 in ``ENTROPY_BINS`` bins: at most 6 bits."""
    counts, _ = np.histogram(values, ENTROPY_BINS, (0.0, 1.0))
    p = counts[counts > 0] / max(counts.sum(), 1)
    return float(-(p * np.log2(p)).sum())


def roc(values: Array, same: NDArray[np.bool_]) -> tuple[Array, Array]:
    """False and true positive rates (m,) as the threshold falls from above the largest value.

    Raises:
        ValueError: all pairs are of one kind.
    """
    if same.all() or not same.any():
        raise ValueError('a ROC curve needs pairs of both kinds')
    order = np.argsort(-values, kind='stable')
    falls = np.flatnonzero(np.diff(values[order], append=-np.inf))  # equal values pass a threshold together
    true = np.cumsum(same[order])[falls] / same.sum()
    false = np.cumsum(~same[order])[falls] / (~same).sum()
    return np.concatenate([[0.0], false]), np.concatenate([[0.0], true])


def area_under(false_rate: Array, true_rate: Array) -> float:
    """Area under a ROC curve: 1 for a measure that never errs, 0.5 for a coin."""
    return float(np.trapezoid(true_rate, false_rate))
