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

"""Sentences for readers: what of the surface, and of the turn, was seen."""

import numpy as np
import pytest

from debris_scanner.report.explanations import coverage_words, share_words, side, turn_explained


def coverage(share, number, *unseen):
    return {
        'observed_share': share,
        'openings': {'number': number, 'area_m2': 0.01},
        'unseen_directions': [list(d) for d in unseen],
    }


def test_coverage_names_the_sides_that_nobody_saw():
    assert coverage_words(coverage(0.961, 2, (0.1, 0.99, 0.05))) == (
        '96 % of the closed surface was seen; 2 openings; never seen were parts of its underside, '
        'from (0.10, 0.99, 0.05).'
    )
    assert coverage_words(coverage(0.7, 3, (0, 1, 0), (-1, 0, 0.2))) == (
        '70 % of the closed surface was seen; 3 openings; never seen were parts of its underside, '
        'from (0.00, 1.00, 0.00); and of its left side, from (−1.00, 0.00, 0.20).'
    )


def test_small_openings_and_none():
    assert coverage_words(coverage(0.995, 1)) == (
        '99.5 % of the closed surface was seen; 1 opening, each below 1 % of the surface.'
    )
    assert coverage_words(coverage(1.0, 0)) == '100 % of the closed surface was seen; no openings.'


def test_a_hundred_per_cent_is_all():
    assert [share_words(s) for s in (0.744, 0.9897, 0.9999, 1.0)] == ['74 %', '99 %', '99.9 %', '100 %']


@pytest.mark.parametrize(
    ('direction', 'name'),
    [
        ((0.9, 0.1, 0.2), 'right side'),
        ((-0.9, 0.1, 0.2), 'left side'),
        ((0, 1, 0), 'underside'),
        ((0, -1, 0), 'top'),
        ((0.3, 0.3, 0.8), 'back'),
        ((0.3, 0.3, -0.8), 'front'),
    ],
)
def test_sides_are_those_of_an_optical_frame(direction, name):
    assert side(direction) == name


def test_the_turn_is_told_where_no_loop_was_closed():
    assert turn_explained('no_closure', np.radians(220)) == 'Turn on: 220° of 360° seen.'
    assert 'hardly turned' in turn_explained('no_closure', np.radians(2))
    assert 'by 410°' in turn_explained('no_closure', np.radians(410))
    assert turn_explained('interrupted', np.radians(90)) == 'Turn on: 90° of 360° seen.'
    for reason in ('unobservable_rotation', 'inconsistent_model', None):
        assert turn_explained(reason, np.radians(90)) == ''
    assert turn_explained('no_closure', None) == ''
