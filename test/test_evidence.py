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

"""A model of truly posed frames explains them; one with a second surface, or a side missing, does not."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.modelling.evidence import FRAMES, _held_length, model_evidence, stretch_evidence
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.modelling.validation import VerdictSettings, judge_frames, judge_model

SETTINGS = VerdictSettings()


@pytest.fixture(scope='module')
def posed(recording):
    return [(recording.targets[k], recording.pose(k)) for k in range(0, 120, 2)]


def judged(frames):
    surface = fuse(frames, FusionSettings())
    evidence = model_evidence(surface, frames)
    stretches = stretch_evidence(surface, frames, FusionSettings())
    return judge_model(evidence, SETTINGS) or judge_frames(evidence, stretches, SETTINGS)


def test_a_model_of_truly_posed_frames_explains_them(posed):
    assert len(model_evidence(fuse(posed, FusionSettings()), posed)) == FRAMES
    assert judged(posed) is None


@pytest.mark.parametrize('shift', [(0.0, 0.0, 0.025), (0.03, 0.0, 0.0)])
def test_a_doubled_surface_contradicts_the_frames(posed, shift):
    """Every third frame is posed some centimetres off: what a slipped closure leaves."""
    slip = transform(np.eye(3), np.array(shift))
    doubled = [(f, compose(slip, T) if n % 3 == 0 else T) for n, (f, T) in enumerate(posed)]
    assert judged(doubled) is not None


@pytest.mark.parametrize('share', [3, 6])
def test_frames_two_degrees_off_are_out_of_place(posed, share):
    """What a gap bridged wrong leaves: a later turn does not meet the earlier one."""
    slip = transform(exp_so3(np.radians([0.0, 2.0, 0.0])), np.zeros(3))
    late = [(f, compose(slip, T) if n % share == 0 else T) for n, (f, T) in enumerate(posed)]
    assert 'out of place' in judged(late)


def test_a_turned_half_contradicts_the_frames(posed):
    turned = transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    flipped = [(f, compose(turned, T) if n > len(posed) // 2 else T) for n, (f, T) in enumerate(posed)]
    assert 'of the model' in judged(flipped) or 'explains' in judged(flipped)


def test_one_frame_far_out_of_place_is_enough(posed):
    """A submap posed wrong need not be a tenth of all frames."""
    slip = transform(exp_so3(np.radians([0.0, 6.0, 0.0])), np.zeros(3))
    frames = [(f, compose(slip, T) if n == 20 else T) for n, (f, T) in enumerate(posed[:FRAMES])]
    said = judged(frames)
    assert said is not None and said.startswith('a frame is out of place')


def test_a_shift_counts_as_far_as_the_frame_holds_the_model():
    """A face seen face-on: along it a shift proves nothing, towards the sensor it does."""
    information = np.diag([1.0, 1.0, 900.0])
    assert _held_length(np.array([0.003, 0.0, 0.0]), information) == pytest.approx(1e-4)
    assert _held_length(np.array([0.0, 0.0, 0.003]), information) == pytest.approx(3e-3)
