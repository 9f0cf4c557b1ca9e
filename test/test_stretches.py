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

"""Frames of a gap bridged wrong are held against those of before and after, not against what they made."""

import dataclasses

import numpy as np
import pytest
from posed_frames import tumbling

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.modelling.evidence import stretch_evidence
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.modelling.validation import VerdictSettings

FUSION = FusionSettings()
BOUND = VerdictSettings().telling_cost


@pytest.fixture(scope='module')
def frames():
    """Of an upper stage, three stretches with two seconds between them."""
    seen = [f for n, f in enumerate(tumbling('upper_stage')) if n % 26 < 20][:66]
    return [
        (dataclasses.replace(f, stamp_ns=n * 10**8 + n // 22 * 2 * 10**9), T) for n, (f, T) in enumerate(seen)
    ]


def evidence(frames):
    return list(stretch_evidence(fuse(frames, FUSION), frames, FUSION))


def test_stretches_truly_posed_hold(frames):
    said = evidence(frames)
    assert len(said) == 3
    for stretch in said:
        assert np.degrees(stretch.turn) < 0.5
        assert stretch.least_cost > 1.2 * BOUND


@pytest.mark.slow
@pytest.mark.parametrize('turn_deg', [20.0, 80.0])
def test_a_turned_stretch_does_not(frames, turn_deg):
    """About the long axis, where the upper stage is nearly one of revolution."""
    turn = transform(exp_so3(np.radians([0.0, 0.0, turn_deg])), np.zeros(3))
    bridged = [(f, compose(turn, T) if n // 22 == 1 else T) for n, (f, T) in enumerate(frames)]
    assert evidence(bridged)[1].least_cost < BOUND


def test_a_scan_without_gaps_is_asked_by_thirds(frames):
    seamless = [(dataclasses.replace(f, stamp_ns=n * 10**8), T) for n, (f, T) in enumerate(frames[::3])]
    assert len(evidence(seamless)) == 3


def test_what_no_other_stretch_saw_does_not_hold(frames):
    """Views from opposite sides have nothing in common."""
    seen = np.array([T[:3, 2] @ frames[0][1][:3, 2] for _, T in frames])
    apart = [(frames[k], 0) for k in np.flatnonzero(seen > 0.7)] + [
        (frames[k], 10**10) for k in np.flatnonzero(seen < -0.7)
    ]
    alone = [(dataclasses.replace(f, stamp_ns=n * 10**8 + late), T) for n, ((f, T), late) in enumerate(apart)]
    said = evidence(alone)
    assert len(said) == 2
    assert all(s.turn > np.radians(3.0) for s in said)
