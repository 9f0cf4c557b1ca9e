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

"""A face is known again whatever its roll and wherever it is; two that agree say where its submap lies."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import in_words, passed
from debris_scanner.mapping.submap_closures import Proposal, Proposals, register_at_any_roll
from debris_scanner.registration.likelihood import UsualLoss, mutual_loss
from debris_scanner.sensing.views import View


def true_between(recording, later, earlier):
    """T_earlier_later."""
    a, b = (recording.truth[recording.frames[k].stamp_ns] for k in (earlier, later))
    return compose(a, inverse(b))


def usual_loss(recording):
    """Of frames five apart, as of key frames in a row."""
    usual = UsualLoss()
    for k in range(5, 60, 5):
        before, now = View(recording.targets[k - 5]), View(recording.targets[k])
        usual.add(mutual_loss(now, true_between(recording, k, k - 5), before, np.eye(4)))
    return usual


@pytest.mark.parametrize(('later', 'earlier'), [(127, 1), (131, 5)])
def test_a_face_is_known_again(recording, later, earlier):
    fit = register_at_any_roll(
        View(recording.targets[later]), View(recording.targets[earlier]), usual_loss(recording), 0.6
    )
    assert fit.certain and passed(fit.checks)
    assert fit.why == in_words(fit.checks, 'another submap')
    E = compose(inverse(true_between(recording, later, earlier)), fit.T_earlier_view)
    assert np.degrees(rotation_angle(E[:3, :3])) < 0.6
    assert np.linalg.norm(E[:3, 3]) < 0.01


@pytest.mark.parametrize(('later', 'earlier'), [(63, 0), (30, 0), (90, 10)])
def test_another_face_is_not_taken_for_it(recording, later, earlier):
    fit = register_at_any_roll(
        View(recording.targets[later]), View(recording.targets[earlier]), usual_loss(recording), 0.6
    )
    assert not fit.certain
    failed = {c.name for c in fit.checks if not c.passed}
    assert failed and failed <= {'loss_rank', 'overlap', 'lead_over_other_attitudes'}
    assert fit.T_earlier_view is not None  # what fitted best is told


def test_views_that_never_meet_have_no_pose(recording, monkeypatch):
    monkeypatch.setattr('debris_scanner.mapping.submap_closures.register', lambda *_: None)
    fit = register_at_any_roll(recording.views[1], recording.views[0], UsualLoss(), 0.6)
    assert (fit.T_earlier_view, fit.certain) == (None, False)
    assert [(c.name, c.value, c.passed) for c in fit.checks] == [('overlap', 0.0, False)]


def proposal(submap=0, to_index=5, turn_deg=0.0, shift=0.0):
    placed = transform(exp_so3(np.radians([0, 0, turn_deg])), np.array([shift, 0, 0]))
    return Proposal(submap, 0, to_index, 0.8, np.eye(4), placed)


TURNS = [exp_so3(np.radians([0, 3.0 * k, 0])) for k in range(20)]
CENTRE = np.array([0.0, 0.0, 0.1])
FOOTPRINT = 0.0015  # m, of a pixel


def test_two_that_agree_from_two_sides_are_needed():
    proposals = Proposals()
    assert proposals.match(1, proposal(), TURNS, CENTRE, FOOTPRINT) is None
    assert proposals.match(1, proposal(to_index=6), TURNS, CENTRE, FOOTPRINT) is None  # the same side again
    found = proposals.match(1, proposal(to_index=9), TURNS, CENTRE, FOOTPRINT)
    assert found is not None and found.to_index == 5


@pytest.mark.parametrize('other', [{'turn_deg': 6.0}, {'shift': 0.03}, {'submap': 7}])
def test_those_that_contradict_join_nothing(other):
    proposals = Proposals()
    assert proposals.match(1, proposal(), TURNS, CENTRE, FOOTPRINT) is None
    assert proposals.match(1, proposal(to_index=12, **other), TURNS, CENTRE, FOOTPRINT) is None


def test_proposals_end_with_the_submap_that_they_were_made_in():
    proposals = Proposals()
    assert proposals.match(1, proposal(), TURNS, CENTRE, FOOTPRINT) is None
    assert proposals.match(2, proposal(to_index=12), TURNS, CENTRE, FOOTPRINT) is None
