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

"""Geometric verification tells the same face from another, and says by which number."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_se3, inverse, rotation_angle, transform
from debris_scanner.mapping.closures import VerificationSettings, verify

SETTINGS = VerificationSettings()
TURN = 126  # frames of a full turn


def drifted(view, T, degrees, shift=0.0):
    """The pose turned about what the view sees, as drift would leave it."""
    centre = T[:3, :3] @ view.centroid + T[:3, 3]
    axis = np.array([0.3, 0.9, -0.2]) / np.linalg.norm([0.3, 0.9, -0.2])
    to, back = transform(np.eye(3), centre), transform(np.eye(3), -centre)
    turn = exp_se3(np.concatenate([np.radians(degrees) * axis, [shift, 0, 0]]))
    return compose(to, turn, back, T)


@pytest.mark.parametrize(('degrees', 'shift'), [(0, 0), (4, 0.0), (8, 0.0), (3, 0.015)])
def test_face_that_came_round_again_is_recognised(recording, degrees, shift):
    view, reference = recording.views[TURN], recording.views[0]
    estimate = drifted(view, recording.pose(TURN), degrees, shift)
    found = verify(view, estimate, reference, recording.pose(0), SETTINGS)
    assert found.accepted, found.why
    # every number that decided is told
    for name in ('overlap', 'residual_mm', 'free_space', 'outside', 'correction_deg', 'correction_mm'):
        assert name in found.why
    E = compose(inverse(recording.pose(TURN)), found.T_target_view)
    assert np.degrees(rotation_angle(E[:3, :3])) < 0.5
    assert found.agreement.overlap > 0.85


def test_other_face_is_refused(recording):
    """Half a turn on, estimated to look like the start: a belly for a back."""
    view, reference = recording.views[63], recording.views[0]
    # upright there as it was at the start: the best that confusion could make of it
    shift = transform(np.eye(3), reference.centroid - view.centroid)
    found = verify(view, compose(recording.pose(0), shift), reference, recording.pose(0), SETTINGS)
    assert not found.accepted
    assert 'not' in found.why
    assert 'overlap' in found.why or 'free_space' in found.why or 'residual' in found.why


def test_correction_beyond_the_drift_that_is_possible_is_refused(recording):
    view, reference = recording.views[TURN], recording.views[0]
    estimate = drifted(view, recording.pose(TURN), 8)
    strict = VerificationSettings(max_turn_deg=5.0)
    found = verify(view, estimate, reference, recording.pose(0), strict)
    assert not found.accepted
    assert 'correction_deg' in found.why and 'not <= 5' in found.why
    assert 'overlap' not in found.why  # only what failed is named
    shifted = verify(
        view,
        drifted(view, recording.pose(TURN), 0, 0.012),
        reference,
        recording.pose(0),
        VerificationSettings(max_shift=0.005),
    )
    assert not shifted.accepted
    assert 'correction_mm' in shifted.why


def test_views_apart_do_not_overlap(recording):
    view = recording.views[0]
    beside = compose(recording.pose(0), transform(np.eye(3), np.array([0.6, 0, 0])))
    found = verify(view, beside, view, recording.pose(0), SETTINGS)
    assert (found.accepted, found.why) == (False, 'the views do not overlap')
    np.testing.assert_array_equal(found.T_target_view, beside)
    assert found.agreement.points == 0


@pytest.mark.parametrize(
    ('bound', 'value', 'word'),
    [
        ('min_overlap', 0.999, 'overlap'),
        ('max_rms', 1e-4, 'residual_mm'),
        ('max_free_space', 0.0, 'free_space'),
    ],
)
def test_every_bound_can_refuse(recording, bound, value, word):
    strict = VerificationSettings(**{bound: value})
    found = verify(recording.views[TURN], recording.pose(TURN), recording.views[0], recording.pose(0), strict)
    assert not found.accepted
    assert found.why.startswith(f'{word} ')
