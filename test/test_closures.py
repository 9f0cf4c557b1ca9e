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

"""The closure detector over one turn of key frames: finds the loop where it closes, and says why not."""

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closure_search import ClosureSearchSettings
from debris_scanner.mapping.closures import ClosureDetector, ClosureSettings, VerificationSettings
from debris_scanner.mapping.descriptors import DescriptorSettings
from debris_scanner.sensing.normals import NormalSettings

STEP = 2  # frames between key frames: 5.7 degrees
OMEGA = 0.5  # rad/s
AXIS = np.array([0.0, 0.0, 1.0])  # of the spin, true target frame


def detector(timer=None, **options):
    return ClosureDetector(
        ClosureSettings(**options),
        ClosureSearchSettings(),
        DescriptorSettings(),
        VerificationSettings(),
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
    assert all(true_angle(recording, c) <= 10.0 for c in accepted)
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


def test_loop_that_is_only_nearly_closed_is_named_so(recording):
    _, closures = run(recording, accepted_angle_deg=4.0)
    nearly = [c for c in closures if not c.accepted and 'apart_deg' in c.why]
    assert nearly
    assert all(true_angle(recording, c) > 3.5 for c in nearly)
    assert all(true_angle(recording, c) < 4.5 for c in closures if c.accepted)


def test_records_are_for_the_summary(turned):
    for c in turned[1]:
        r = c.record
        assert (r.from_stamp_ns, r.to_stamp_ns, r.probability, r.accepted, r.why) == (
            c.from_stamp_ns,
            c.to_stamp_ns,
            c.probability,
            c.accepted,
            c.why,
        )
        assert r.why


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
