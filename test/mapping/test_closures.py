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

"""Geometric verification tells the same face from another, and says by which number.

The closure detector over one turn of key frames: finds the loop where it closes, and says why not.
"""

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import in_words
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closure_search import ClosureSearchSettings
from debris_scanner.mapping.closures import (
    ClosureDetector,
    ClosureSettings,
    Steps,
    VerificationSettings,
    verify,
)
from debris_scanner.mapping.descriptors import DescriptorSettings
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.registration.likelihood import UsualLoss
from debris_scanner.registration.projective import MIN_OVERLAP
from debris_scanner.sensing.normals import NormalSettings

SETTINGS = VerificationSettings()
TURN = 126  # frames of a full turn


def drifted(view, T, degrees, shift=0.0):
    """The pose turned about what the view sees, as drift would leave it."""
    return drifted_about(
        np.array([0.3, 0.9, -0.2]) / np.linalg.norm([0.3, 0.9, -0.2]), view, T, degrees, shift
    )


def drifted_about(axis, view, T, degrees, shift=0.0):
    """The pose turned about an axis through what the view sees."""
    centre = T[:3, :3] @ view.centroid + T[:3, 3]
    to, back = transform(np.eye(3), centre), transform(np.eye(3), -centre)
    turn = exp_se3(np.concatenate([np.radians(degrees) * axis, [shift, 0, 0]]))
    return compose(to, turn, back, T)


@pytest.mark.parametrize(('degrees', 'shift'), [(0, 0), (4, 0.0), (8, 0.0), (3, 0.015)])
def test_face_that_came_round_again_is_recognised(recording, degrees, shift):
    view, reference = recording.views[TURN], recording.views[0]
    estimate = drifted(view, recording.pose(TURN), degrees, shift)
    found = verify(view, estimate, reference, recording.pose(0), SETTINGS)
    assert found.accepted, found.why
    assert [c.name for c in found.checks] == ['overlap', 'excess_loss', 'correction_deg']
    assert found.checks[0] == ('overlap', found.stats.overlap, MIN_OVERLAP, True)
    assert found.checks[1].value < found.checks[1].bound == SETTINGS.max_loss
    assert found.why == in_words(found.checks)
    E = compose(inverse(recording.pose(TURN)), found.T_target_view)
    assert np.degrees(rotation_angle(E[:3, :3])) < 0.5
    assert found.stats.overlap > 0.85


def test_other_face_is_refused(recording):
    """Half a turn on, estimated to look like the start: a belly for a back."""
    view, reference = recording.views[63], recording.views[0]
    # upright there as it was at the start: the best that confusion could make of it
    shift = transform(np.eye(3), reference.centroid - view.centroid)
    found = verify(view, compose(recording.pose(0), shift), reference, recording.pose(0), SETTINGS)
    assert not found.accepted
    assert {c.name for c in found.checks if not c.passed} & {'overlap', 'excess_loss'}


def test_correction_that_asks_too_much_of_the_steps_is_refused(recording):
    view, reference = recording.views[TURN], recording.views[0]
    estimate = drifted(view, recording.pose(TURN), 8)
    corrections = []

    def asked(correction):
        corrections.append(np.degrees(rotation_angle(correction[:3, :3])))
        return 0.3, 0.1

    found = verify(view, estimate, reference, recording.pose(0), SETTINGS, asked=asked)
    assert not found.accepted
    assert [c for c in found.checks if not c.passed] == [('asked_of_a_step', 0.3, 0.1, False)]
    assert found.checks[-1].value == pytest.approx(8, abs=0.5)
    assert corrections == [pytest.approx(8, abs=0.5)]


def test_views_apart_do_not_overlap(recording):
    view = recording.views[0]
    beside = compose(recording.pose(0), transform(np.eye(3), np.array([0.6, 0, 0])))
    found = verify(view, beside, view, recording.pose(0), SETTINGS)
    assert not found.accepted
    assert found.checks == (('overlap', 0.0, MIN_OVERLAP, False),)
    assert found.T_target_view is None  # not the estimate that was given
    assert found.stats.points == 0


def test_the_usual_loss_is_that_of_the_scan(recording):
    """Views that explain each other as a typical sensor's do are refused where a scan's own do better."""
    better = UsualLoss()
    for _ in range(10):
        better.add(-1.0)
    pair = recording.views[TURN], recording.pose(TURN), recording.views[0], recording.pose(0)
    assert verify(*pair, SETTINGS).accepted
    found = verify(*pair, SETTINGS, usual=better)
    assert not found.accepted
    assert [c.name for c in found.checks if not c.passed] == ['excess_loss']


STEP = 2  # frames between key frames: 5.7 degrees
OMEGA = 0.5  # rad/s
AXIS = np.array([0.0, 0.0, 1.0])  # of the spin, true target frame


def detector(timer=None, verification=None, **options):
    return ClosureDetector(
        ClosureSettings(**options),
        ClosureSearchSettings(),
        DescriptorSettings(),
        verification or VerificationSettings(),
        NormalSettings(),
        timer,
    )


def keyframes(recording, drift_deg=0.0):
    """Key frames over one turn and 40 degrees, whose poses drift evenly about the spin axis."""
    result = []
    for k in range(0, 140, STEP):
        drift = transform(exp_so3(np.radians(drift_deg) * k / 126 * AXIS), np.zeros(3))
        pose = compose(drift, recording.pose(k))
        result.append(KeyFrame(recording.targets[k], pose, OMEGA * 0.1 * k))
    return result


def run(recording, drift_deg=0.0, timer=None, **options):
    found = detector(timer, **options)
    return found, [c for k in keyframes(recording, drift_deg) for c in found.add(k)]


@pytest.fixture(scope='module')
def turned(recording):
    return run(recording, drift_deg=4.0)


def true_angle(recording, closure):
    a, b = (recording.truth[s] for s in (closure.from_stamp_ns, closure.to_stamp_ns))
    return np.degrees(rotation_angle(a[:3, :3].T @ b[:3, :3]))


def test_every_accepted_closure_is_true(turned, recording):
    accepted = [c for c in turned[1] if c.accepted]
    assert accepted
    for c in accepted:
        a, b = (recording.truth[s] for s in (c.from_stamp_ns, c.to_stamp_ns))
        error = compose(c.T_from_to, inverse(compose(a, inverse(b))))
        assert np.degrees(rotation_angle(error[:3, :3])) < 2.0
        centre = a[:3, 3]  # of the target, in the earlier view
        assert np.linalg.norm(error[:3, :3] @ centre + error[:3, 3] - centre) < 0.02 * 0.4
    assert all(0 < c.probability <= 1 for c in accepted)


def test_loop_is_found_as_soon_as_it_closes(turned, recording):
    first = next(c for c in turned[1] if c.accepted)
    assert first.from_stamp_ns == recording.frames[0].stamp_ns
    # the first key frame within ten degrees of the start is the 122nd frame
    assert first.to_stamp_ns - first.from_stamp_ns <= 124 * 10**8


def test_closure_is_registered_whatever_the_drift(turned, recording):
    for c in turned[1]:
        if c.accepted:
            truth = recording.truth[c.from_stamp_ns] @ inverse(recording.truth[c.to_stamp_ns])
            E = compose(inverse(truth), c.T_from_to)
            assert np.degrees(rotation_angle(E[:3, :3])) < 0.5
            assert np.linalg.norm(E[:3, 3]) < 0.006  # at the sensor, 0.8 m off the target


def test_nothing_is_tried_before_the_target_has_turned_away(turned, recording):
    start = recording.frames[0].stamp_ns
    assert min(c.to_stamp_ns for c in turned[1]) - start > 100 * 10**8


def test_how_far_apart_the_faces_look_does_not_matter(turned, recording):
    assert max(true_angle(recording, c) for c in turned[1] if c.accepted) > 10.0


@pytest.fixture(scope='module')
def chain(recording):
    """Key frames of two thirds of a turn, and what their steps disagree by."""
    keyframes = KeyFrameSet(NormalSettings(), prepared=30)
    steps, path = Steps(keyframes), 0.0
    for n, k in enumerate(range(0, 84, 3)):
        path += np.radians(8.6) * (n > 0)
        keyframes.add(KeyFrame(recording.targets[k], recording.pose(k), path))
        steps.learn()
    return steps, len(keyframes) - 1


def about(view, T, degrees):
    """The correction that turns what a view sees about the spin's axis."""
    return compose(drifted_about(AXIS, view, T, degrees), inverse(T))


@pytest.mark.parametrize('degrees', [0.0, 4.0, 8.0])
def test_a_drift_asks_no_more_of_steps_than_they_disagree_by(chain, recording, degrees):
    steps, last = chain
    T = steps._keyframes.frames[last].T_target_sensor
    asked, most = steps.asked(0, last, about(recording.views[81], T, degrees))
    assert asked <= most < 0.05


@pytest.mark.parametrize('degrees', [-60.0, 45.0, 60.0, 90.0])
def test_a_whole_face_asks_more(chain, recording, degrees):
    steps, last = chain
    T = steps._keyframes.frames[last].T_target_sensor
    asked, most = steps.asked(0, last, about(recording.views[81], T, degrees))
    assert asked > 2 * most


def test_what_few_steps_disagree_by_is_not_known(recording):
    keyframes = KeyFrameSet(NormalSettings())
    steps = Steps(keyframes)
    for k in range(0, 15, 3):
        keyframes.add(KeyFrame(recording.targets[k], recording.pose(k), 0.15 * k))
        steps.learn()
    assert steps.asked(0, 4, np.eye(4)) == (0.0, np.inf)


def test_records_are_for_the_summary(turned):
    for c in turned[1]:
        r = c.record
        assert (r.from_stamp_ns, r.to_stamp_ns, r.probability, r.accepted, r.why, r.checks) == (
            c.from_stamp_ns,
            c.to_stamp_ns,
            c.probability,
            c.accepted,
            c.why,
            c.checks,
        )
        assert r.why
        np.testing.assert_array_equal(r.T_from_to, c.T_from_to)


def test_a_refused_hypothesis_has_its_pose_too(recording):
    _, closures = run(recording, verification=VerificationSettings(max_loss=-5.0))
    refused = [c for c in closures if not c.accepted and c.T_from_to is not None]
    assert refused and all(c.record.T_from_to is not None for c in refused)


def test_views_that_were_never_registered_have_no_pose(recording, monkeypatch):
    found, (*earlier, newest) = detector(), keyframes(recording)
    for k in earlier:
        found.remember(k)
    monkeypatch.setattr('debris_scanner.mapping.closures.register', lambda *_: None)
    unmet = found.add(newest)
    assert unmet
    for c in unmet:
        assert (c.accepted, c.T_from_to, c.record.T_from_to) == (False, None, None)


def test_at_most_the_set_number_is_verified(recording):
    timer = StageTimer()
    _, closures = run(recording, timer=timer, verified=1)
    assert max(np.unique([c.to_stamp_ns for c in closures], return_counts=True)[1]) == 1
    assert timer.summary()['descriptor']['count'] == 70


def test_best_probability_rises_towards_the_closure(recording):
    found, series = detector(), []
    for k in keyframes(recording):
        found.add(k)
        series.append(found.best_probability)
    half, full = series[31], max(series[58:66])
    assert series[0] == 0
    assert full > half + 0.1


def test_reset_forgets(recording):
    found, _ = run(recording)
    found.reset()
    assert len(found.keyframes) == 0
    assert found.add(keyframes(recording)[-1]) == []
