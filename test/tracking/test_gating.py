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

import numpy as np
from frame_fits import fit

from debris_scanner.tracking.gating import (
    OdometrySettings,
    ScanLevel,
    passes_gate,
    passes_strict_gate,
    shows_unmapped_surface,
)

SETTINGS = OdometrySettings()
USUAL = 0.5  # nats


def level(usual=USUAL, missing=0.0):
    made = ScanLevel()
    for _ in range(10):
        made.add(
            dataclasses.replace(
                fit(missing_reference_ratio=missing), loss=usual, has_unoccluded_reference=True
            ),
            unoccluded=True,
        )
    return made


def losing(excess, **values):
    """A fit whose loss exceeds the usual one."""
    return dataclasses.replace(fit(**values), loss=USUAL + excess, covered_loss=USUAL + excess)


def test_a_usual_fit_passes_both_gates():
    assert passes_gate(losing(0.1), level(), SETTINGS)
    assert passes_strict_gate(losing(0.1), level(), SETTINGS)


def test_a_loss_that_passes_near_the_prediction_fails_after_a_search():
    assert passes_gate(losing(0.5), level(), SETTINGS)
    assert not passes_strict_gate(losing(0.5), level(), SETTINGS)
    assert not passes_gate(losing(0.7), level(), SETTINGS)


def test_what_a_half_hidden_frame_lacks_is_no_evidence():
    hidden = losing(0.1, missing_reference_ratio=0.8)
    assert passes_gate(hidden, level(), SETTINGS)
    assert passes_strict_gate(hidden, level(), SETTINGS)


def test_what_is_usual_for_the_sensor_is_no_flaw():
    poor = dataclasses.replace(fit(), loss=1.0)
    assert passes_strict_gate(poor, level(usual=0.9), SETTINGS)
    assert not passes_strict_gate(poor, level(usual=0.2), SETTINGS)
    assert passes_gate(poor, ScanLevel(), SETTINGS)  # the first frames of a scan
    assert not passes_gate(dataclasses.replace(fit(), loss=4.0), ScanLevel(), SETTINGS)
    assert not passes_gate(dataclasses.replace(fit(), loss=np.inf), ScanLevel(), SETTINGS)


def test_settings_are_asked():
    strict = dataclasses.replace(SETTINGS, max_loss=0.05)
    assert not passes_gate(losing(0.1), level(), strict)


def test_more_than_the_references_show_is_no_contradiction_of_them():
    more = dataclasses.replace(losing(3.0), covered_loss=USUAL + 0.1)
    assert shows_unmapped_surface(more, level(), SETTINGS)
    edge = losing(0.2)  # no more than an edge's noise
    assert not shows_unmapped_surface(edge, level(), SETTINGS)
    # it is elsewhere, or another body
    assert not shows_unmapped_surface(losing(0.8), level(), SETTINGS)
    lacking = dataclasses.replace(more, missing_reference_ratio=0.2)
    assert not shows_unmapped_surface(lacking, level(), SETTINGS)
    assert shows_unmapped_surface(lacking, level(missing=0.18), SETTINGS)
