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

"""What makes a scan's graph a model, and the words for why not."""

from dataclasses import replace

import numpy as np
import pytest

from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
)
from debris_scanner.modelling.evidence import FrameEvidence, SegmentEvidence
from debris_scanner.modelling.validation import (
    Baseline,
    VerdictSettings,
    judge_frames,
    judge_graph,
    judge_model,
    judge_scan,
)
from debris_scanner.registration.projective import RegistrationStats

SETTINGS = VerdictSettings()
GOOD = RegistrationStats(points=1000, matched=900, square=900 * 0.93**2, visible=950, in_free_space=5)
BLURRED = RegistrationStats(points=1000, matched=900, square=900 * 2.0**2, visible=950, in_free_space=5)
CROSSING = RegistrationStats(points=1000, matched=900, square=900 * 0.93**2, visible=950, in_free_space=90)
STILL = FrameEvidence(GOOD, turn=0.002, gain=1.0, shift=0.0)
SLID = FrameEvidence(GOOD, turn=0.2, gain=1.05, shift=0.0)
MISPLACED = FrameEvidence(GOOD, turn=0.2, gain=1.2, shift=0.0)
EDGE_ON = FrameEvidence(RegistrationStats(points=1000, matched=90, visible=95), turn=0.2, gain=1.2, shift=0.0)
HELD = SegmentEvidence(turn=0.005, least_cost=1.6)
SEEN = [0.005, 0.004, 0.006]


def test_agreeing_graph_is_a_model():
    assert judge_graph([GOOD] * 20, [1.0] * 5, SEEN, SETTINGS) is None


@pytest.mark.parametrize(
    ('edge_stats', 'weights', 'observability', 'reason', 'word'),
    [
        ([BLURRED] * 20, [1.0], SEEN, INCONSISTENT_MODEL, 'residual 2.00 px'),
        ([GOOD] * 16 + [CROSSING] * 4, [1.0], SEEN, INCONSISTENT_MODEL, 'free space'),
        ([GOOD] * 20, [1.0] * 8 + [0.1] * 2, SEEN, INCONSISTENT_MODEL, '20%'),
        ([GOOD] * 20, [1.0], [0.0005, 0.0004, 0.01], UNOBSERVABLE_ROTATION, '0.0005'),
        ([GOOD] * 20, [1.0], [], UNOBSERVABLE_ROTATION, 'rotation information'),
    ],
)
def test_contradiction_is_no_model(edge_stats, weights, observability, reason, word):
    verdict = judge_graph(edge_stats, weights, observability, SETTINGS)
    assert verdict is not None
    assert verdict[0] == reason
    assert word in verdict[1]


def test_a_few_bad_edges_of_many_are_forgiven():
    assert judge_graph([GOOD] * 38 + [BLURRED, CROSSING], [1.0] * 19 + [0.1], SEEN, SETTINGS) is None


@pytest.mark.parametrize(
    ('frames', 'observability', 'reason'),
    [
        (0, [], NO_TARGET),
        (SETTINGS.min_frames - 1, SEEN, TOO_FEW_FRAMES),
        (SETTINGS.min_frames, SEEN, NO_CLOSURE),
        (SETTINGS.min_frames, [], NO_CLOSURE),  # nothing moved, so nothing was compared
        (200, [0.0003, 0.0004], UNOBSERVABLE_ROTATION),
        (3, [0.0003], TOO_FEW_FRAMES),
    ],
)
def test_reason_of_a_scan_without_a_loop(frames, observability, reason):
    found, why = judge_scan(frames, observability, SETTINGS)
    assert found == reason
    assert why


def test_a_frame_that_fits_hardly_better_elsewhere_is_forgiven():
    assert judge_frames([STILL] * 39 + [SLID], [HELD] * 3, SETTINGS) is None
    assert judge_frames([STILL] * 39 + [EDGE_ON], [HELD] * 3, SETTINGS) is None


@pytest.mark.parametrize(
    'other',
    [SegmentEvidence(turn=0.005, least_cost=1.02), SegmentEvidence(turn=np.radians(2), least_cost=1.6)],
)
def test_it_is_not_where_the_others_do_not_confirm_a_segment(other):
    said = judge_frames([STILL] * 39 + [SLID], [HELD, HELD, other], SETTINGS)
    assert said is not None and '11.46 > 3.00 deg' in said


def test_a_frame_that_fits_better_elsewhere_is_out_of_place():
    assert judge_frames([STILL] * 38 + [SLID, MISPLACED], [HELD] * 3, SETTINGS) is not None


def test_segments_are_asked_only_where_a_frame_turns():
    assert judge_frames([STILL] * 40, iter(lambda: pytest.fail('asked'), None), SETTINGS) is None


def test_what_neighbours_show_is_the_sensors_doing():
    baseline = Baseline.of([BLURRED] * 10)
    assert baseline.rms == pytest.approx(2.0)
    assert judge_graph([BLURRED] * 20, [1.0], SEEN, SETTINGS, baseline) is None
    doubled = replace(BLURRED, square=900 * 3.0**2)
    verdict = judge_graph([doubled] * 20, [1.0], SEEN, SETTINGS, baseline)
    assert verdict is not None and 'residual 3.00 px > 2.50 px' in verdict[1]


def test_good_neighbours_loosen_nothing():
    assert judge_graph([BLURRED] * 20, [1.0], SEEN, SETTINGS, Baseline.of([GOOD] * 10)) is not None
    assert Baseline.of([]) == Baseline()


COARSE = FrameEvidence(replace(GOOD, matched=600), turn=0.002, gain=1.0, shift=0.0)


def test_a_model_coarser_than_its_frames_is_held_to_what_they_show_of_each_other():
    baseline = Baseline.of([GOOD] * 10)
    assert judge_model([COARSE] * 20, SETTINGS, baseline, [GOOD] * 20) is None
    contradicting = [replace(GOOD, matched=700)] * 20
    said = judge_model([COARSE] * 20, SETTINGS, baseline, contradicting)
    assert said is not None and 'the model explains' in said
    assert judge_model([COARSE] * 20, SETTINGS, baseline) == said  # nothing speaks for it
