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

"""A model of truly posed frames explains them; one with a second surface, or a side missing, does not.

Turned about its weakest axis a cylinder fits its frames as well as before; nothing else here does.

Frames of a gap bridged wrong are held against those of before and after, not against what they made.
"""

import dataclasses

import numpy as np
import pytest
from posed_frames import tumbling

from debris_scanner.core.geometry import compose, exp_so3, transform
from debris_scanner.modelling.evidence import (
    FRAMES,
    PROFILE_TURNS_DEG,
    RotationCostProfile,
    _informed_length,
    model_evidence,
    profile_weakest_axis,
    segment_evidence,
)
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse
from debris_scanner.modelling.validation import VerdictSettings, judge_frames, judge_model, judge_rotation

SETTINGS = VerdictSettings()


@pytest.fixture(scope='module')
def posed(recording):
    return [(recording.targets[k], recording.pose(k)) for k in range(0, 120, 2)]


def judged(frames):
    surface = fuse(frames, FusionSettings())
    evidence = model_evidence(surface, frames)
    segments = segment_evidence(surface, frames, FusionSettings())
    return judge_model(evidence, SETTINGS) or judge_frames(evidence, segments, SETTINGS)


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


def test_a_shift_counts_as_far_as_the_frame_informs_it():
    """A face seen face-on: along it a shift proves nothing, towards the sensor it does."""
    information = np.diag([1.0, 1.0, 900.0])
    assert _informed_length(np.array([0.003, 0.0, 0.0]), information) == pytest.approx(1e-4)
    assert _informed_length(np.array([0.0, 0.0, 0.003]), information) == pytest.approx(3e-3)


def test_where_one_side_was_seen_most_the_axis_is_still_found():
    """Turned about the middle of what was seen, a cylinder would move sideways."""
    frames = tumbling('cylinder')[8:28]
    scan = profile_weakest_axis(fuse(frames, FusionSettings()), frames)
    assert judge_rotation(scan, SETTINGS) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ('target', 'seen'), [('cylinder', False), ('upper_stage', True), ('tank_boosters', True), ('prism', True)]
)
def test_a_turn_of_a_cylinder_costs_nothing(target, seen):
    frames = tumbling(target)
    scan = profile_weakest_axis(fuse(frames, FusionSettings()), frames)
    assert abs(scan.axis[2]) > 0.99  # each of them is longest or roundest along z
    assert len(scan.costs) == len(PROFILE_TURNS_DEG)
    assert (judge_rotation(scan, SETTINGS) is None) is seen


def test_the_words_name_axis_and_cost():
    scan = RotationCostProfile(np.array([0.0, 0.0, 1.0]), PROFILE_TURNS_DEG, (2.0, 1.5, 1.1, 1.2, 1.6, 2.1))
    said = judge_rotation(scan, SETTINGS)
    assert said is not None and '(0.00, 0.00, 1.00)' in said and '1.10 < 1.40' in said


FUSION = FusionSettings()
BOUND = VerdictSettings().min_cost_ratio


@pytest.fixture(scope='module')
def frames():
    """Of an upper stage, three segments with two seconds between them."""
    seen = [f for n, f in enumerate(tumbling('upper_stage')) if n % 26 < 20][:66]
    return [
        (dataclasses.replace(f, stamp_ns=n * 10**8 + n // 22 * 2 * 10**9), T) for n, (f, T) in enumerate(seen)
    ]


def evidence(frames):
    return list(segment_evidence(fuse(frames, FUSION), frames, FUSION))


def test_segments_at_true_poses_are_confirmed(frames):
    said = evidence(frames)
    assert len(said) == 3
    for segment in said:
        assert np.degrees(segment.turn) < 0.5
        assert segment.least_cost > 1.15 * BOUND


@pytest.mark.slow
@pytest.mark.parametrize('turn_deg', [20.0, 80.0])
def test_a_rotated_segment_is_not(frames, turn_deg):
    """About the long axis, where the upper stage is nearly one of revolution."""
    turn = transform(exp_so3(np.radians([0.0, 0.0, turn_deg])), np.zeros(3))
    bridged = [(f, compose(turn, T) if n // 22 == 1 else T) for n, (f, T) in enumerate(frames)]
    assert evidence(bridged)[1].least_cost < BOUND


def test_a_scan_without_gaps_is_asked_by_thirds(frames):
    seamless = [(dataclasses.replace(f, stamp_ns=n * 10**8), T) for n, (f, T) in enumerate(frames[::3])]
    assert len(evidence(seamless)) == 3


def test_what_no_other_segment_saw_is_not_confirmed(frames):
    """Views from opposite sides have nothing in common."""
    seen = np.array([T[:3, 2] @ frames[0][1][:3, 2] for _, T in frames])
    apart = [(frames[k], 0) for k in np.flatnonzero(seen > 0.7)] + [
        (frames[k], 10**10) for k in np.flatnonzero(seen < -0.7)
    ]
    alone = [(dataclasses.replace(f, stamp_ns=n * 10**8 + late), T) for n, ((f, T), late) in enumerate(apart)]
    said = evidence(alone)
    assert len(said) == 2
    assert all(s.turn > np.radians(3.0) for s in said)
