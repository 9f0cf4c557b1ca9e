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

"""A number that was refused is never printed as equal to its bound."""

import numpy as np
import pytest

from debris_scanner.core.results import Check, at_least, at_most, compared, in_words


@pytest.mark.parametrize(
    ('value', 'bound', 'text'),
    [
        (0.5, 0.75, '0.50 < 0.75'),
        (0.7496, 0.75, '0.7496 < 0.7500'),
        (0.749, 0.75, '0.749 < 0.750'),
        (0.75 - 1e-12, 0.75, '0.749999999999 < 0.750000000000'),
        (1e-30, 2e-30, '1e-30 < 2e-30'),
        (-np.inf, 0.75, '-inf < 0.75'),
    ],
)
def test_as_many_decimals_as_it_takes(value, bound, text):
    assert compared(value, '<', bound) == text


def test_equal_numbers_end():
    assert compared(0.75, 'not >', 0.75) == '0.75 not > 0.75'


def test_neighbouring_doubles_differ():
    for bound in np.random.default_rng(0).uniform(0.001, 100, 50):
        value = float(np.nextafter(bound, 0))
        left, right = compared(value, '<', float(bound)).split(' < ')
        assert left != right


def test_checks_for_people():
    low, high = at_least('overlap', 0.31, 0.4), at_most('excess_loss', 0.2, 0.6)
    frames, told = at_least('frames', 3, 10), Check('correction_deg', 8.124)
    assert (low.passed, high.passed, told.passed) == (False, True, True)
    assert [c.words for c in (low, high, frames, told)] == [
        'overlap 0.31 not >= 0.40',
        'excess_loss 0.20 <= 0.60',
        'frames 3 not >= 10',
        'correction_deg 8.12',
    ]
    assert in_words([low, high, told]) == 'overlap 0.31 not >= 0.40, correction_deg 8.12'
    assert in_words([high, told], 'joined') == 'joined: excess_loss 0.20 <= 0.60, correction_deg 8.12'
    assert at_most('size_error', 0.004, 0.025).words == 'size_error 0.004 <= 0.025'
    assert in_words([], 'nothing') == 'nothing'
    assert not at_most('gain', np.nan, 1.0).passed and not at_least('gain', np.nan, 1.0).passed
