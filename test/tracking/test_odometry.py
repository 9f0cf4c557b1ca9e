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

"""Odometry on the recorded spin: error bounds, key frames, losing the target and finding it again."""

import copy
import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from occluded_frames import shaded

from debris_scanner.core.frames import DepthFrame, TargetFrame
from debris_scanner.core.geometry import compose, exp_se3, inverse, rotation_angle
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping import keyframes
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.settings import Settings
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.stages import make_preprocessor
from debris_scanner.tracking.gating import OdometrySettings
from debris_scanner.tracking.motion_filter import MotionSettings
from debris_scanner.tracking.odometry import LOST, SCANNING, TRACKING, Odometry

RATE = 0.5  # rad/s, true


def make(timer=None, **options):
    return Odometry(OdometrySettings(**options), MotionSettings(), NormalSettings(), timer)


def drift(estimates, recording, first):
    """Attitude (degrees) and position (mm) errors, tied to the truth at one estimate."""
    T_true_est = compose(inverse(recording.truth[first.stamp_ns]), first.T_sensor_target)
    attitude, position = [], []
    for e in estimates:
        E = compose(inverse(compose(recording.truth[e.stamp_ns], T_true_est)), e.T_sensor_target)
        attitude.append(np.degrees(rotation_angle(E[:3, :3])))
        position.append(np.linalg.norm(E[:3, 3]) * 1e3)
    return np.array(attitude), np.array(position)


@pytest.fixture(scope='module')
def spin(recording):
    """The first 60 frames, 170 degrees of turn."""
    timer = StageTimer()
    odometry = make(timer)
    return odometry, [odometry.process(t) for t in recording.targets[:60]], timer


def test_short_spin_is_followed(spin, recording):
    odometry, estimates, _ = spin
    assert all(e.accepted for e in estimates)
    assert {e.state for e in estimates} == {SCANNING} == {odometry.state}
    attitude, position = drift(estimates, recording, estimates[0])
    assert attitude.max() < 1.5
    assert position.max() < 2.5


def test_rates_are_those_of_the_spin(spin, recording):
    for e in spin[1][15:]:
        assert np.linalg.norm(e.omega_target) == pytest.approx(RATE, abs=0.05)
        assert (e.omega_sigma < 0.2).all()
    mean = np.mean([e.omega_target for e in spin[1][15:]], axis=0)
    # the same axis, in the first frame's attitude
    first, last = (recording.truth[recording.frames[k].stamp_ns][:3, :3] for k in (0, 40))
    turn = last @ first.T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    axis /= np.linalg.norm(axis)
    assert np.degrees(np.arccos(mean @ axis / np.linalg.norm(mean))) < 3


def test_estimates_state_their_uncertainty_and_evidence(spin):
    for e in spin[1][1:]:
        np.testing.assert_allclose(e.covariance, e.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(e.covariance).min() > 0
        assert np.sqrt(np.diag(e.covariance)[:3]).max() < np.radians(2)
        assert e.stats.matched > 300
        assert e.observability > 0.001
    assert spin[1][0].observability is None


def test_key_frames_are_chosen_by_turn(spin):
    odometry, estimates, timer = spin
    chosen = [e.keyframe for e in estimates if e.keyframe is not None]
    assert chosen[0].stamp_ns == estimates[0].stamp_ns
    turns = [
        np.degrees(rotation_angle(a.T_target_sensor[:3, :3].T @ b.T_target_sensor[:3, :3]))
        for a, b in pairwise(chosen)
    ]
    limit = OdometrySettings().keyframe_angle_deg
    assert min(turns) > limit
    assert max(turns) < limit + 3.5  # a frame is 2.9 degrees
    # the path adds the turns up
    np.testing.assert_allclose(np.diff([np.degrees(k.path_rad) for k in chosen]), turns, atol=1e-6)
    assert [k.stamp_ns for k in odometry.keyframes.frames] == [k.stamp_ns for k in chosen]
    assert timer.summary()['registration']['count'] == len(estimates) - 1


def test_a_target_that_starts_after_a_long_rest_is_followed():
    """A prism, whose flat faces a filter that expects no acceleration would hold back."""
    prism = simulate(SimulationSettings(target='prism', seconds=1.5))
    process, odometry = make_preprocessor(Settings()), make()
    targets = [
        process.process(DepthFrame(f.stamp_ns, f.depth_mm * np.float32(1e-3), f.camera)) for f in prism
    ]
    rest_ns = 10 * 10**9
    first = targets[0]
    still = [dataclasses.replace(first, stamp_ns=first.stamp_ns + k * 10**8 - rest_ns) for k in range(100)]
    estimates = [odometry.process(t) for t in [*still, *targets]]
    assert all(e.accepted for e in estimates)
    assert np.linalg.norm(estimates[99].omega_target) < 0.01
    assert np.linalg.norm(estimates[-1].omega_target) == pytest.approx(RATE, abs=0.05)
    start, end = estimates[100].T_sensor_target, estimates[-1].T_sensor_target
    turned = np.degrees(rotation_angle(start[:3, :3].T @ end[:3, :3]))
    assert turned == pytest.approx(np.degrees(RATE) * 1.4, abs=1.0)


def test_a_target_turned_by_hand_from_step_to_step_is_followed(recording):
    """Pictures taken after turns of 14 to 34 deg, one after the other: no even motion foretells the next."""
    odometry, steps = make(), np.cumsum((0, 11, 11, 5, 8, 10, 8, 10, 10, 10, 5, 12, 9, 12))
    estimates = [
        odometry.process(dataclasses.replace(recording.targets[k], stamp_ns=(n + 1) * 10**8))
        for n, k in enumerate(steps)
    ]
    assert all(e.accepted and e.keyframe is not None and e.submap == 0 for e in estimates)
    first, last = (recording.truth[recording.targets[k].stamp_ns] for k in (steps[0], steps[-1]))
    true = last[:3, :3] @ first[:3, :3].T
    found = estimates[-1].T_sensor_target[:3, :3] @ estimates[0].T_sensor_target[:3, :3].T
    assert np.degrees(rotation_angle(found @ true.T)) < 3.0


def nothing(target):
    """The frame with all but a speck of the target hidden."""
    depth = np.zeros_like(target.depth)
    middle = tuple(s // 2 for s in depth.shape)
    depth[middle] = 0.8
    return TargetFrame(
        target.stamp_ns, target.camera, depth, np.zeros_like(depth), np.zeros_like(target.normals)
    )


def test_a_scan_that_begins_partially_occluded_starts_a_submap_once_unoccluded(recording):
    shares = [0.6] * 10 + [0.45, 0.3, 0.15]
    odometry, targets = make(), recording.targets
    early = [odometry.process(shaded(t, s)) for t, s in zip(targets, shares, strict=False)]
    later = [odometry.process(t) for t in targets[len(shares) : 40]]
    assert all(e.accepted for e in [*early, *later])  # it was never lost
    assert {e.submap for e in early[:10]} == {0}
    assert {e.submap for e in later} == {1}
    assert all(e.usable_for_mapping for e in later[3:])
    assert sum(e.keyframe is not None for e in later) == len(odometry.keyframes) > 6
    attitude, _ = drift(later, recording, later[0])
    assert attitude.max() < 1.0


def test_partially_occluded_for_long_gives_no_key_frames(recording):
    """Beyond the reach of all nearby unoccluded views, one from further away still reveals the occlusion."""
    odometry, targets = make(), recording.targets
    before = [odometry.process(t) for t in targets[:10]]
    hidden = [odometry.process(shaded(t, 0.4)) for t in targets[10:30]]  # 57 degrees
    after = [odometry.process(t) for t in targets[30:40]]
    assert all(e.accepted for e in hidden)
    assert not any(e.usable_for_mapping or e.keyframe for e in hidden)
    assert all(e.accepted and e.usable_for_mapping for e in after[2:])
    assert {e.submap for e in [*before, *hidden, *after]} == {0}
    attitude, position = drift(after, recording, before[0])
    assert attitude.max() < 1.5
    assert position.max() < 3


def test_hidden_target_is_lost_and_found_again(recording):
    odometry, after = make(), OdometrySettings().lost_after
    before = [odometry.process(t) for t in recording.targets[:20]]
    hidden = [odometry.process(nothing(t)) for t in recording.targets[20:27]]
    assert not any(e.accepted for e in hidden)
    assert [e.state for e in hidden] == [SCANNING] * (after - 1) + [LOST] * (len(hidden) - after + 1)
    assert all(e.keyframe is None for e in hidden)
    # the prediction runs on meanwhile, and grows unsure
    sigma = [np.diag(e.covariance)[:3].sum() for e in hidden]
    assert sigma == sorted(sigma)
    assert drift(hidden, recording, before[0])[0].max() < 15
    found = [odometry.process(t) for t in recording.targets[27:40]]
    assert all(e.accepted for e in found[2:])
    assert {e.state for e in found[2:]} == {SCANNING}
    attitude, position = drift(found[2:], recording, before[0])
    assert attitude.max() < 2
    assert position.max() < 3


def upside_down(target):
    """The frame mirrored top to bottom."""
    camera = dataclasses.replace(target.camera, cy=target.camera.height - 1 - target.camera.cy)
    normals = np.ascontiguousarray(target.normals[::-1] * np.array([1, -1, 1], np.float32))
    depth, fit = np.ascontiguousarray(target.depth[::-1]), np.ascontiguousarray(target.depth_fit[::-1])
    return TargetFrame(target.stamp_ns, camera, depth, fit, normals)


def test_other_body_is_rejected(recording):
    """Frames turned upside down show another silhouette and another surface."""
    odometry = make()
    for t in recording.targets[:10]:
        odometry.process(t)
    state = odometry.filter.copy()
    flipped = [odometry.process(upside_down(t)) for t in recording.targets[10:14]]
    assert not any(e.accepted for e in flipped)
    np.testing.assert_array_equal(odometry.filter.R, state.R)  # a rejected frame changes nothing


@pytest.fixture
def tracking(recording, true_model):
    """Odometry after 20 frames, and after it took over the model and the key frames' true poses."""
    odometry = make()
    for t in recording.targets[:20]:
        odometry.process(t)
    poses = {k.stamp_ns: inverse(recording.truth[k.stamp_ns]) for k in odometry.keyframes.frames}
    odometry.adopt_model(true_model, poses)
    return odometry


def test_the_frame_in_which_the_scan_began_stays_where_it_is_as_models_are_adopted(recording, true_model):
    odometry = make()
    for t in recording.targets[:20]:
        last = odometry.process(t)
    before = compose(last.T_sensor_target, odometry.T_target_scanning)
    np.testing.assert_allclose(before, last.T_sensor_target, atol=1e-12)
    poses = {k.stamp_ns: inverse(recording.truth[k.stamp_ns]) for k in odometry.keyframes.frames}
    odometry.adopt_model(true_model, poses)
    moved = exp_se3(np.array([0.0, 0.0, 0.1, 0.005, 0.0, 0.0]))
    odometry.adopt_model(true_model, {stamp_ns: compose(moved, T) for stamp_ns, T in poses.items()})
    assert np.linalg.norm(odometry.T_target_scanning[:3, 3]) > 4e-3  # the target frame has jumped
    now = compose(odometry.filter.T_sensor_target, odometry.T_target_scanning)
    np.testing.assert_allclose(now, before, atol=1e-9)


def true_errors(estimates, recording):
    """Against the truth itself: the model is in the true target frame."""
    E = [compose(inverse(recording.truth[e.stamp_ns]), e.T_sensor_target) for e in estimates]
    return (
        np.array([np.degrees(rotation_angle(e[:3, :3])) for e in E]),
        np.array([np.linalg.norm(e[:3, 3]) * 1e3 for e in E]),
    )


def test_model_is_tracked_without_drift(tracking, recording):
    estimates = [tracking.process(t) for t in recording.targets[20:139]]
    assert all(e.accepted for e in estimates)
    assert {e.state for e in estimates} == {TRACKING}
    attitude, position = true_errors(estimates, recording)
    assert np.sqrt(np.mean(attitude**2)) < 0.5
    assert attitude.max() < 1.0
    assert position.max() < 2.0


def test_target_is_found_again_anywhere_by_its_model(tracking, recording):
    """Hidden for 4 s, two thirds of a half turn: further than any prediction reaches."""
    for t in recording.targets[20:24]:
        tracking.process(t)
    for t in recording.targets[24:30]:
        tracking.process(nothing(t))
    assert tracking.state == LOST
    # it comes back as it would be seen 5.5 s later, though only half a second has gone by
    shown = [
        dataclasses.replace(t, stamp_ns=recording.frames[30 + n].stamp_ns)
        for n, t in enumerate(recording.targets[85:105])
    ]
    estimates = [tracking.process(t) for t in shown]
    accepted = [n for n, e in enumerate(estimates) if e.accepted]
    assert accepted and accepted[0] < 16
    assert tracking.state == TRACKING
    for n in accepted[2:]:
        truth = recording.truth[recording.frames[85 + n].stamp_ns]
        angle = np.degrees(rotation_angle(truth[:3, :3].T @ estimates[n].T_sensor_target[:3, :3]))
        assert angle < 2


def test_model_needs_a_key_frame_in_common(recording, true_model):
    odometry = make()
    with pytest.raises(ValueError, match='no key frame'):
        odometry.adopt_model(true_model, {1: np.eye(4)})
    odometry.process(recording.targets[0])
    with pytest.raises(ValueError, match='no key frame'):
        odometry.adopt_model(true_model, {1: np.eye(4)})
    assert odometry.model is None


def test_reset_starts_anew(recording):
    odometry = make()
    for t in recording.targets[:10]:
        odometry.process(t)
    odometry.reset()
    assert odometry.state == SCANNING and len(odometry.keyframes) == 0
    first = odometry.process(recording.targets[5])
    assert first.accepted and first.keyframe is not None
    np.testing.assert_array_equal(first.T_sensor_target[:3, :3], np.eye(3))


def test_views_that_were_put_away_change_nothing(spin, recording, monkeypatch):
    monkeypatch.setattr(keyframes, 'PREPARED', 1)
    odometry = make()
    for target, expected in zip(recording.targets[:30], spin[1], strict=False):
        np.testing.assert_array_equal(odometry.process(target).T_sensor_target, expected.T_sensor_target)
    assert odometry.keyframes.views.capacity == 1


def test_a_scan_that_is_full_goes_on_by_the_key_frames_that_it_has(recording):
    """One turn has room; the 40 degrees after it show sides that are known."""
    turn = 42  # key frames, every third frame
    odometry = make(max_keyframes=turn)
    estimates = [odometry.process(t) for t in recording.targets]
    assert all(e.accepted for e in estimates)
    made = [e.keyframe is not None for e in estimates]
    assert sum(made) == len(odometry.keyframes) == turn
    assert not any(made[-14:])
    assert odometry.submap == 0
    attitude, _ = drift(estimates[-5:], recording, estimates[0])
    assert attitude.max() < 1.5


def test_the_key_frames_of_all_submaps_count(recording):
    """A target that is lost again and again fills a scan as well."""
    odometry = make(max_keyframes=8)
    for t in recording.targets[:12]:  # four key frames
        odometry.process(t)
    gap_ns = 30_000_000_000
    for t in recording.targets[60:90]:
        odometry.process(dataclasses.replace(t, stamp_ns=t.stamp_ns + gap_ns))
    assert odometry.submap == 1
    assert len(odometry.keyframes) == 8 - 4
    assert odometry.full.startswith('8 key frames')
    for t in recording.targets[10:20]:
        odometry.process(dataclasses.replace(t, stamp_ns=t.stamp_ns + 3 * gap_ns))
    assert odometry.submap == 1  # there is no room for another


def test_a_model_is_tracked_when_there_is_no_room_for_new_sides(tracking, recording):
    unbounded = copy.deepcopy(tracking)
    tracking.settings = dataclasses.replace(tracking.settings, max_keyframes=len(tracking.keyframes))
    estimates = [tracking.process(t) for t in recording.targets[20:50]]
    assert all(e.accepted for e in estimates)
    assert not any(e.keyframe for e in estimates)
    assert true_errors(estimates, recording)[0].max() < 1.0
    assert any(unbounded.process(t).keyframe for t in recording.targets[20:50])


def test_a_full_scan_says_so():
    settings = OdometrySettings(max_keyframes=30)
    assert settings.full(29) == ''
    assert settings.full(30).startswith('30 key frames') and 'odometry.max_keyframes' in settings.full(30)


def test_a_search_without_result_leaves_no_doubt_later(recording):
    """Seen again within reach of the prediction the pose is consistent with it, and key frames go on."""
    odometry = make()
    for t in recording.targets[:10]:
        odometry.process(t)
    other = [odometry.process(upside_down(t)) for t in recording.targets[10:12]]
    after = [odometry.process(t) for t in recording.targets[12:40]]
    assert not any(e.accepted for e in other)
    assert all(e.accepted and e.usable_for_mapping for e in after)
    assert sum(e.keyframe is not None for e in after) >= 8
