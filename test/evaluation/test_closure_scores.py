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

"""Closures are judged by the pose that was registered, and missed where a face was seen again."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, inverse, transform
from debris_scanner.core.results import ClosureRecord
from debris_scanner.evaluation.closure_scores import (
    BY_ATTITUDE,
    BY_POSE,
    closure_scores,
    has_true_pose,
    seen_again,
)

S = 1_000_000_000
SIZE = 0.3  # m: 2 % are 6 mm
SPIN = np.array([0.0, -1.0, 0.0])  # across the line of sight
ROLL = np.array([0.0, 0.0, 1.0])  # along it


def turning(count=126, step_deg=3.0, axis=SPIN):
    """Truth by stamp: one frame a second, the target 0.8 m away, drifting sideways."""
    return {
        k * S: transform(exp_so3(np.radians(step_deg * k) * axis), np.array([0.001 * k, 0.0, 0.8]))
        for k in range(count)
    }


def closure(truth, a, b, turn_deg=0.0, shift=0.0, accepted=True):
    """A closure whose pose is off: the target is turned about its origin, and shifted, as seen at ``a``."""
    off = transform(exp_so3(np.radians([0, turn_deg, 0])), np.array([0, shift, 0]))
    T = compose(truth[a * S], off, inverse(truth[b * S]))
    return ClosureRecord(a * S, b * S, 0.9, accepted, '', T)


@pytest.mark.parametrize(
    ('turn_deg', 'shift', 'true'),
    [
        (0.0, 0.0, True),
        (1.9, 0.0, True),
        (0.0, 0.0059, True),
        (-1.9, -0.0059, True),
        (2.1, 0.0, False),
        (0.0, 0.0061, False),
        (180.0, 0.0, False),
    ],
)
def test_a_pose_is_true_within_two_degrees_and_two_per_cent(turn_deg, shift, true):
    truth = turning()
    # 120: the attitude is the same; 116: 12 degrees short of it, which the thesis calls false
    for b in (120, 116, 60):
        assert has_true_pose(truth, closure(truth, 0, b, turn_deg, shift), SIZE) is true


def test_the_bound_on_the_shift_grows_with_the_target():
    truth = turning()
    found = closure(truth, 0, 120, shift=0.008)
    assert not has_true_pose(truth, found, 0.3)
    assert has_true_pose(truth, found, 0.5)


def test_the_lever_from_the_sensor_does_not_count():
    """A turn of 1.9 degrees about the target moves the sensor, 0.8 m away, by 27 mm."""
    truth = turning()
    found = closure(truth, 0, 120, turn_deg=1.9).T_from_to
    true = compose(truth[0], inverse(truth[120 * S]))
    assert np.linalg.norm(found[:3, 3] - true[:3, 3]) > 0.025
    assert has_true_pose(truth, closure(truth, 0, 120, turn_deg=1.9), SIZE)


def test_the_pose_maps_points_of_the_later_frame_into_the_earlier():
    truth = turning()
    right = closure(truth, 0, 100)
    reversed_ = ClosureRecord(0, 100 * S, 0.9, True, '', inverse(right.T_from_to))
    assert has_true_pose(truth, right, SIZE)
    assert has_true_pose(truth, reversed_, SIZE) is False


def test_a_frame_without_truth_leaves_it_open():
    truth = turning()
    assert has_true_pose(truth, ClosureRecord(0, 999 * S, 0.9, True, '', np.eye(4)), SIZE) is None
    assert has_true_pose(truth, ClosureRecord(0, 120 * S, 0.9, True, ''), SIZE) is False


def seconds(stamps):
    return sorted(s // S for s in stamps)


def test_a_face_is_seen_again_from_within_fifteen_degrees():
    truth = turning()
    keyframes = [k * S for k in range(0, 126, 2)]
    # the sensor drifts 0.07 degrees sideways a frame, eight in a turn
    assert seconds(seen_again(truth, keyframes)) == list(range(114, 126, 2))
    assert seen_again(truth, []) == set()
    assert seen_again({}, keyframes) == set()
    # frames that are no key frames count for the path, not as faces
    assert seen_again(truth, [0, 60 * S]) == set()
    assert seconds(seen_again(truth, [0, 120 * S])) == [120]


def test_half_a_turn_adds_up_and_less_is_no_return():
    roll = turning(70, axis=ROLL)  # looks at the same face all the time, rolled
    assert seconds(seen_again(roll, list(roll))) == list(range(60, 70))
    # there and back again: 2 x 87 degrees of rotation are too little, 2 x 90 enough
    there = turning(60)
    for farthest, found in ((29, []), (30, [60])):
        rock = {k * S: there[min(k, 2 * farthest - k) * S] for k in range(2 * farthest + 1)}
        assert seconds(seen_again(rock, [0, max(rock)])) == found


def test_precision_and_recall():
    truth = turning()
    keyframes = [k * S for k in range(0, 126, 2)]
    closures = [
        closure(truth, 0, 120),
        closure(truth, 2, 120),
        closure(truth, 0, 116),  # other attitudes, registered right
        closure(truth, 4, 122, turn_deg=30.0),  # the same attitude, registered wrong
        closure(truth, 4, 124, accepted=False),
        ClosureRecord(0, 999 * S, 0.9, True, '', np.eye(4)),
    ]
    scores, judged_by = closure_scores(truth, closures, keyframes, SIZE)
    assert scores == {'precision': 3 / 4, 'recall': pytest.approx(2 / 6), 'false': 1}
    assert judged_by == BY_POSE
    nothing = {'precision': None, 'recall': 0.0, 'false': 0}
    assert closure_scores(truth, [], keyframes, SIZE) == (nothing, BY_POSE)
    assert closure_scores(truth, [], [], SIZE)[0] == {'precision': None, 'recall': None, 'false': 0}


def test_closures_of_an_earlier_release_are_judged_by_attitude():
    truth = turning()
    keyframes = [k * S for k in range(0, 126, 2)]
    old = [ClosureRecord(0, b * S, 0.9, True, '') for b in (120, 116)]
    scores, judged_by = closure_scores(truth, old, keyframes, SIZE)
    # four key frames return to within ten degrees of an earlier one's attitude
    assert scores == {'precision': 0.5, 'recall': 0.25, 'false': 1}
    assert judged_by == BY_ATTITUDE
    # refused hypotheses need no pose
    unmet = ClosureRecord(0, 60 * S, 0.2, False, 'the views do not overlap')
    assert closure_scores(truth, [closure(truth, 0, 120), unmet], keyframes, SIZE)[1] == BY_POSE
