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

"""Gates: a fit needs agreement, and the more of it the less the prediction constrains it."""

import dataclasses

import pytest
from frame_fits import fit

from debris_scanner.tracking.gating import (
    OdometrySettings,
    passes_gate,
    passes_strict_gate,
    shows_unmapped_surface,
)

SETTINGS = OdometrySettings()


def test_a_good_fit_passes_both_gates():
    assert passes_gate(fit(), SETTINGS)
    assert passes_strict_gate(fit(), SETTINGS)
    assert passes_strict_gate(fit(), SETTINGS, consistent_with_prediction=False)


@pytest.mark.parametrize(
    'flaw',
    [
        {'missing_reference_ratio': 0.2},
        {'rms': 1.75},
        {'free': 0.05},
        {'silhouette_violation_ratio': 0.1},
        {'overlap': 0.7, 'visible_inlier_ratio': 0.7},
    ],
)
def test_a_flaw_that_passes_near_the_prediction_fails_after_a_search(flaw):
    assert passes_gate(fit(**flaw), SETTINGS)
    assert not passes_strict_gate(fit(**flaw), SETTINGS)


def test_a_part_that_matches_well_is_enough():
    assert passes_strict_gate(fit(overlap=0.5, visible_inlier_ratio=0.93), SETTINGS)
    assert not passes_strict_gate(fit(overlap=0.5, visible_inlier_ratio=0.8), SETTINGS)
    assert not passes_strict_gate(fit(overlap=0.2, visible_inlier_ratio=0.93), SETTINGS)


def test_far_from_the_prediction_no_free_space_may_be_violated():
    flawed = fit(free=0.02)
    assert passes_strict_gate(flawed, SETTINGS)
    assert not passes_strict_gate(flawed, SETTINGS, consistent_with_prediction=False)


def test_settings_are_asked():
    strict = dataclasses.replace(SETTINGS, min_overlap=0.97)
    assert not passes_gate(fit(), strict)


def test_more_than_the_references_show_is_no_contradiction_of_them():
    assert shows_unmapped_surface(fit(overlap=0.5, silhouette_violation_ratio=0.4), SETTINGS)
    assert not shows_unmapped_surface(
        fit(silhouette_violation_ratio=0.1), SETTINGS
    )  # no more than an edge's noise
    for flaw in (
        {'missing_reference_ratio': 0.2},
        {'free': 0.1},
        {'rms': 2.7},
    ):  # it is elsewhere, or another body
        assert not shows_unmapped_surface(fit(silhouette_violation_ratio=0.4, **flaw), SETTINGS)
