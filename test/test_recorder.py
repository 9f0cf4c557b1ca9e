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

"""What a scan says, gathered into its result."""

from dataclasses import replace

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, transform
from debris_scanner.core.results import INTERRUPTED, NO_CLOSURE, NO_MATCH, NO_TARGET
from debris_scanner.faults import Faults
from debris_scanner.modelling.generation import Generation
from debris_scanner.recorder import FrameCounts, ScanRecorder
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.settings import Settings
from debris_scanner.stages import make_model_builder
from debris_scanner.tracking.odometry import NOT_REGISTERED, OdometryEstimate

OMEGA = np.array([0.1, 0.4, -0.2])
SIGMA = np.full(3, 0.01)


def pose(t):
    return transform(exp_so3(OMEGA * t), np.array([0, 0, 0.8]))


def estimate(stamp_ns, T, omega_target, accepted=True, tracked=False):
    return OdometryEstimate(
        stamp_ns=stamp_ns,
        state='scanning',
        accepted=accepted,
        T_sensor_target=T,
        covariance=np.eye(6),
        omega_target=omega_target,
        omega_sigma=SIGMA,
        velocity=np.zeros(3),
        stats=RegistrationStats(),
        observability=None,
        tracked=tracked,
    )


def recorded(omega_sensor=OMEGA, frames=20):
    recorder = ScanRecorder()
    for k in range(frames):
        T = pose(0.1 * k)
        recorder.add_estimate(estimate(k * 10**8, T, T[:3, :3].T @ omega_sensor), None)
    return recorder


def result(recorder, reason=NO_CLOSURE, builder=None, interrupted=None, counts=FrameCounts({}, {})):
    builder = builder or make_model_builder(Settings())
    generation = Generation(None, reason, 'why', {}, None)
    return recorder.result(builder, generation, counts, interrupted)


@pytest.fixture
def seen(recording):
    """A builder that has seen a frame."""
    builder = make_model_builder(Settings())
    builder.add_frame(recording.targets[0], np.eye(4), tracked=True)
    return builder


def test_axis_and_period_are_those_of_the_rates():
    found = result(recorded())
    np.testing.assert_allclose(found.rotation_axis_sensor, OMEGA / np.linalg.norm(OMEGA), atol=1e-9)
    assert found.rotation_period_s == pytest.approx(2 * np.pi / np.linalg.norm(OMEGA))


@pytest.mark.parametrize('recorder', [recorded(OMEGA * 0.01), recorded(frames=1), recorded(frames=0)])
def test_what_hardly_turns_has_no_period(recorder):
    found = result(recorder)
    assert found.rotation_period_s is None
    assert found.rotation_axis_sensor is None


def test_disbelieved_estimates_are_rates_but_no_poses():
    recorder = recorded(frames=5)
    recorder.add_estimate(estimate(10**9, pose(9), np.full(3, 7.0), accepted=False), None)
    found = result(recorder)
    assert len(found.odometry) == 5
    assert [r.accepted for r in found.rates] == [True] * 5 + [False]
    np.testing.assert_allclose(found.rotation_axis_sensor, OMEGA / np.linalg.norm(OMEGA), atol=1e-9)


def test_tracked_poses_are_told_in_the_scans_own_frame():
    T_model_scan = exp_se3(np.array([0.2, -0.1, 0.3, 0.01, 0.02, 0.03]))
    recorder = ScanRecorder()
    T = compose(pose(1.0), inverse(T_model_scan))
    recorder.add_estimate(estimate(1, T, OMEGA, tracked=True), T_model_scan)
    np.testing.assert_allclose(recorder.odometry[0].T_sensor_target, pose(1.0), atol=1e-12)


def test_axis_is_that_in_the_sensor_frame_whatever_the_target_frame():
    T_model_scan = exp_se3(np.array([0.4, -0.3, 0.5, 0.0, 0.0, 0.0]))
    recorder = ScanRecorder()
    for k in range(10):
        T = compose(pose(0.1 * k), inverse(T_model_scan))
        recorder.add_estimate(estimate(k, T, T[:3, :3].T @ OMEGA, tracked=True), T_model_scan)
    axis = result(recorder).rotation_axis_sensor
    np.testing.assert_allclose(axis, OMEGA / np.linalg.norm(OMEGA), atol=1e-9)


def test_reasons(seen):
    recorder = recorded()
    assert result(recorder, builder=seen).reason == NO_CLOSURE
    assert result(recorder).reason == NO_TARGET  # frames were read, but none was believed
    assert result(recorder, builder=seen, interrupted=INTERRUPTED).reason == INTERRUPTED
    assert result(recorder, reason=None, builder=seen, interrupted=INTERRUPTED).reason is None


def test_a_known_model_that_is_given_up_at_the_end_is_no_target_that_was_not_seen(recording):
    builder = make_model_builder(Settings())
    target = recording.targets[0]
    builder.add_keyframe(KeyFrame(target, np.eye(4), 0.0), tracked=False)
    builder.add_frame(target, np.eye(4), tracked=False)
    builder.withdraw(target.stamp_ns)
    assert result(recorded(), builder=builder, reason=NO_MATCH).reason == NO_MATCH


def test_records_are_passed_on_and_frames_are_counted_here_and_elsewhere(seen):
    recorder = recorded()
    for reason in (None, 'no_target'):
        disbelieved = replace(estimate(3 * 10**9, pose(3), OMEGA, accepted=False), rejected=reason)
        recorder.add_estimate(disbelieved, None)
    assert (recorder.used, recorder.taken) == (20, 22)
    faults = Faults(log=lambda _: None)
    faults.note(ValueError('here'), 'a frame')
    counts = FrameCounts({'no_target': 5}, {'stage': {'count': 1}}, errors={'KeyError': 2, 'ValueError': 1})
    found = recorder.result(seen, Generation(None, NO_CLOSURE, 'why', {}, None), counts, faults=faults)
    assert (found.frames_read, found.frames_rejected) == (27, {'no_target': 6, NOT_REGISTERED: 1})
    assert (found.errors, found.timing) == ({'KeyError': 2, 'ValueError': 2}, {'stage': {'count': 1}})
    assert found.rates is recorder.rates and found.closures is recorder.closures
    assert [p.stamp_ns for p in found.poses] == [f.stamp_ns for f in seen.store.frames]


@pytest.mark.parametrize(('rejected', 'hint'), [(20, 'unit'), (21, 'scale; unit')])
def test_the_hint_is_given_where_most_frames_were_of_no_use_and_the_unit_always(seen, rejected, hint):
    counts = FrameCounts({'no_target': rejected}, {}, hint='scale', units='unit')
    assert result(recorded(), builder=seen, counts=counts).hint == hint


def test_edges_of_a_model_are_between_neighbours_and_carry_information(recording):
    from debris_scanner.mapping.closures import Closure

    builder = make_model_builder(Settings())
    for k in range(0, 127, 6):
        builder.add_keyframe(KeyFrame(recording.targets[k], recording.pose(k), 0.05 * k), tracked=False)
        builder.add_frame(recording.targets[k], recording.pose(k), tracked=False)
    a, b = recording.frames[0].stamp_ns, recording.frames[126].stamp_ns
    builder.add_closure(Closure(a, b, 0.9, True, 'test', np.eye(4)))
    generation = builder.generate()
    assert generation.model is not None
    found = ScanRecorder().result(builder, generation, FrameCounts({}, {}))
    assert {(e.i, e.j) for e in found.edges} >= {(k, k + 1) for k in range(21)}
    for edge in found.edges:
        assert 0 <= edge.i < edge.j < 22
        np.testing.assert_allclose(edge.information, edge.information.T, rtol=1e-6, atol=1e-3)
        assert np.linalg.eigvalsh(edge.information).min() > 0
        i, j = (inverse(found.keyframe_poses[n].T_sensor_target) for n in (edge.i, edge.j))
        np.testing.assert_allclose(edge.T_i_j, compose(inverse(i), j), atol=1e-9)
    # a metre is dearer than it is known: standard deviations below a millimetre and a few milliradians
    sigma = np.sqrt(np.diag(np.linalg.inv(found.edges[0].information)))
    assert sigma[:3].max() < 0.02 and sigma[3:].max() < 0.02
