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

"""From key frames and closures to a judged model: when it is tried, what is refused, what is kept."""

import dataclasses

import numpy as np
import pytest
from occluded_frames import shaded

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.core.results import NO_CLOSURE, NO_TARGET, TOO_FEW_FRAMES, UNOBSERVABLE_ROTATION
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import Closure
from debris_scanner.settings import Settings
from debris_scanner.stages import make_model_builder

STEP = 4
AXIS = np.array([0.1, 0.3, 1.0]) / np.linalg.norm([0.1, 0.3, 1.0])


def drifted(recording, k, degrees=3.0):
    return compose(transform(exp_so3(np.radians(degrees) * k / 126 * AXIS), np.zeros(3)), recording.pose(k))


def grown(recording, last=126, timer=None, degrees=3.0, settings=None):
    """Key frames every fourth frame and the frames between them, poses drifting."""
    builder = make_model_builder(settings or Settings(), timer)
    for k in range(0, last + 1, 2):
        T = drifted(recording, k, degrees)
        if k % STEP == 0:
            builder.add_keyframe(KeyFrame(recording.targets[k], T, 0.05 * k), tracked=False)
        builder.add_frame(recording.targets[k], T, tracked=False)
    return builder


def closure(recording, a, b):
    T = compose(inverse(recording.pose(a)), recording.pose(b))
    return Closure(recording.frames[a].stamp_ns, recording.frames[b].stamp_ns, 0.9, True, 'test', T)


@pytest.fixture(scope='module')
def recording(coarse_recording):
    return coarse_recording


@pytest.fixture(scope='module')
def built(recording):
    """A builder after its first model, and that generation."""
    timer = StageTimer()
    builder = grown(recording, timer=timer)
    builder.add_closure(closure(recording, 0, 124))
    due = builder.should_rebuild
    return builder, builder.generate(), due, timer


def errors(poses, recording):
    """Attitude errors, degrees, after the alignment of the first pose."""
    first = min(poses)
    T = compose(poses[first], recording.truth[first])
    return np.degrees(
        [rotation_angle((compose(inverse(T), P) @ recording.truth[s])[:3, :3]) for s, P in poses.items()]
    )


def test_a_face_seen_from_aside_calls_for_none_before_a_turn(recording):
    builder = grown(recording, last=112)
    builder.add_closure(closure(recording, 4, 112))  # 30 degrees short
    assert not builder.should_rebuild
    builder.add_closure(closure(recording, 0, 108 + 4))
    assert not builder.should_rebuild
    for k in (116, 120, 124):
        T = drifted(recording, k)
        builder.add_keyframe(KeyFrame(recording.targets[k], T, 0.05 * k), tracked=False)
    builder.add_closure(closure(recording, 0, 124))  # the same face
    assert builder.should_rebuild


def test_a_first_closure_calls_for_a_model(recording, built):
    builder = grown(recording, 20)
    assert not builder.should_rebuild
    _, generation, due, _ = built
    assert due
    assert generation.model is not None
    assert generation.reason is None
    assert errors(generation.poses, recording).max() < 0.6


def test_model_is_in_the_frame_of_its_poses(built, recording):
    _, generation, _, timer = built
    # the model's own poses bring it to where the frames saw it
    target = recording.targets[40]
    T = inverse(generation.poses[target.stamp_ns])
    points = apply(T, generation.model.points.astype(float))
    points = points[
        (apply(T, (generation.model.points + generation.model.normals * 1e-3).astype(float)) - points)[:, 2]
        < -5e-4
    ]
    c = target.camera
    u = np.rint(points[:, 0] / points[:, 2] * c.fx + c.cx).astype(int)
    v = np.rint(points[:, 1] / points[:, 2] * c.fy + c.cy).astype(int)
    inside = (u >= 0) & (v >= 0) & (u < c.width) & (v < c.height)
    depth = np.where(inside, target.depth_fit[np.where(inside, v, 0), np.where(inside, u, 0)], 0)
    error = np.abs(points[:, 2] - depth)[depth > 0]
    assert np.median(error) < 0.5 * target.footprint  # m, of a pixel
    assert np.abs(generation.model.points.mean(axis=0)).max() < 1e-5
    assert timer.summary().keys() >= {'generation', 'relaxation', 'refinement', 'fusion'}


def test_frames_of_a_slip_are_forgotten(recording):
    builder = grown(recording, 20)
    third, fourth = (recording.frames[k].stamp_ns for k in (8, 12))
    builder.note_slips({fourth})
    assert [k.stamp_ns for k in builder.keyframes if k.slipped] == [fourth]
    stamps = [f.stamp_ns for f in builder.store.frames]
    assert recording.frames[10].stamp_ns not in stamps
    assert {third, fourth, recording.frames[14].stamp_ns} <= set(stamps)


def test_sensor_is_measured_before_there_is_a_model(recording):
    builder = make_model_builder(Settings(), None)
    measured = []
    for k in range(0, 17 * STEP, STEP):
        builder.add_keyframe(KeyFrame(recording.targets[k], recording.pose(k), 0.05 * k), tracked=False)
        measured.append(builder.sensor)
    assert measured[6] is None
    assert len({id(m) for m in measured[7:15]}) == 1  # measured again when the key frames have doubled
    assert measured[16] is not measured[7]
    figures = measured[16].in_brief()
    assert figures['range_m'] == pytest.approx(0.8, abs=0.1)
    assert 0.2 < figures['noise_mm'] < 2.0
    assert figures['footprint_mm'] == pytest.approx(
        1e3 * figures['range_m'] / recording.targets[0].camera.fx, rel=0.05
    )


def test_further_models_wait_for_a_new_side(built, recording):
    builder = built[0]
    assert not builder.should_rebuild
    n = len(builder.keyframes)
    more = int(np.ceil(n * (1 + builder.settings.builder.growth))) - n
    added = grown(recording, 0)  # a builder of its own, to count with: the shared one stays as it is
    added.T_model_scan, added.generated_with = np.eye(4), n
    for k in range(1, n + more - 1):
        added.add_keyframe(KeyFrame(recording.targets[k], np.eye(4), 0.0), tracked=True)
    assert not added.should_rebuild
    added.add_keyframe(KeyFrame(recording.targets[n + more], np.eye(4), 0.0), tracked=True)
    assert added.should_rebuild


def test_frames_of_the_scan_move_with_their_key_frames(built, recording):
    builder = built[0]
    poses = {k.stamp_ns: k.T_target_sensor for k in builder.keyframes}
    stored = {f.stamp_ns: f.pose(poses) for f in builder.store.frames}
    assert len(stored) == 64
    assert errors(stored, recording).max() < 0.8


def test_frames_under_way_when_the_model_came_arrive_in_its_frame(recording):
    builder = grown(recording)
    builder.add_closure(closure(recording, 0, 124))
    builder.generate()
    late = recording.targets[130]
    builder.add_keyframe(KeyFrame(late, drifted(recording, 130), 6.5), tracked=False)
    poses = {k.stamp_ns: k.T_target_sensor for k in builder.keyframes}
    assert errors(poses, recording).max() < 0.8
    # and a tracked one is in it already
    T = poses[recording.frames[124].stamp_ns]
    builder.add_frame(recording.targets[132], T, tracked=True)
    np.testing.assert_allclose(builder.store.frames[-1].pose(poses), T, atol=1e-12)


def test_tracked_frames_move_with_the_key_frame_that_slipped_with_them(recording):
    """A target found again 6 degrees off: relaxation puts the key frame right, the frames after it follow."""
    builder = grown(recording)
    builder.add_closure(closure(recording, 0, 124))
    builder.generate()
    last = builder.keyframes[-1]
    true = compose(last.T_target_sensor, compose(inverse(recording.pose(124)), recording.pose(130)))
    slip = transform(exp_so3(np.radians(6.0) * AXIS), np.zeros(3))
    found = compose(slip, true)
    builder.add_keyframe(KeyFrame(recording.targets[130], found, 6.5), tracked=True)
    builder.add_frame(recording.targets[131], found, tracked=True)
    frame = recording.targets[131]
    for later_s in (0.8, 1.6, 4.6):
        later = dataclasses.replace(frame, stamp_ns=frame.stamp_ns + round(later_s * 1e9))
        builder.add_frame(later, found, tracked=True)
    *followed, late = builder.store.frames[-4:]
    builder.keyframes[-1].T_target_sensor = true
    poses = {k.stamp_ns: k.T_target_sensor for k in builder.keyframes}
    for stored in followed:
        assert rotation_angle((inverse(true) @ stored.pose(poses))[:3, :3]) < 1e-9
    # one after a gap was found by itself
    assert rotation_angle((inverse(found) @ late.pose(poses))[:3, :3]) < 1e-9


def test_final_model_is_made_of_every_frame(recording):
    builder = grown(recording)
    builder.add_closure(closure(recording, 0, 124))
    first = builder.generate()
    outcome_text = []
    final = builder.generate(final=True, progress=lambda *what: outcome_text.append(what))
    assert final.model is not None
    assert len(final.model.points) > len(first.model.points)
    assert outcome_text == [('refine', n, 64) for n in range(1, 65)]
    assert np.abs(final.model.points.mean(axis=0)).max() < 1e-5
    poses = {f.stamp_ns: f.pose(final.poses) for f in builder.store.frames}
    assert np.median(errors(poses, recording)) < 0.25
    assert builder.last is final


def tracked_on(recording, slip_deg):
    """A builder with a model, that then tracked the next 44 degrees, slipping off by so much a frame."""
    builder = grown(recording)
    builder.add_closure(closure(recording, 0, 124))
    builder.generate()
    last = builder.keyframes[-1].T_target_sensor
    for n, k in enumerate(range(125, 140)):
        T = compose(last, compose(inverse(recording.pose(124)), recording.pose(k)))
        T = compose(transform(exp_so3(np.radians(slip_deg * (n + 1)) * AXIS), np.zeros(3)), T)
        builder.add_frame(recording.targets[k], T, tracked=True)
    return builder


def test_what_was_tracked_is_relaxed_with_the_rest(recording):
    builder = tracked_on(recording, 0.1)
    final = builder.generate(final=True)
    assert final.model is not None
    added = [k for k in builder.keyframes if k.added]
    assert 2 <= len(added) <= 5
    poses = {f.stamp_ns: f.pose(final.poses) for f in builder.store.frames}
    assert max(poses) == recording.frames[139].stamp_ns
    assert errors(poses, recording).max() < 0.6  # 1.6 at the end as tracked


def test_what_was_tracked_astray_is_left_out_of_the_model(recording):
    builder = tracked_on(recording, 3.0)
    final = builder.generate(final=True)
    assert final.model is not None, final.why
    _, frames = builder.comparable(with_model=True)
    kept = {f.stamp_ns: f.pose(final.poses) for f in frames}
    assert len(kept) >= 60
    assert errors(kept, recording).max() < 2.0  # 48 at the end


@pytest.mark.parametrize(('last', 'reason'), [(-1, NO_TARGET), (4, TOO_FEW_FRAMES), (80, NO_CLOSURE)])
def test_without_a_loop_there_is_a_reason(recording, last, reason):
    generation = grown(recording, last).generate(final=True)
    assert (generation.model, generation.reason) == (None, reason)
    assert generation.why
    assert generation.optimised is None


def test_a_scan_that_is_refused_keeps_its_poses_and_loses_its_closure(recording):
    strict = Settings()
    strict = dataclasses.replace(strict, verdict=dataclasses.replace(strict.verdict, min_turning_loss=10.0))
    builder = grown(recording, settings=strict)
    before = [k.T_target_sensor.copy() for k in builder.keyframes]
    builder.add_closure(closure(recording, 0, 124))
    generation = builder.generate()
    assert (generation.model, generation.reason) == (None, UNOBSERVABLE_ROTATION)
    assert [c.name for c in generation.checks if not c.passed] == ['turning_loss']
    assert builder.T_model_scan is None
    assert builder.graph.closures == []
    assert not builder.should_rebuild
    for k, T in zip(builder.keyframes, before, strict=True):
        np.testing.assert_array_equal(k.T_target_sensor, T)


def test_later_failure_does_not_take_the_model_away(recording):
    builder = grown(recording)
    builder.add_closure(closure(recording, 0, 124))
    first = builder.generate()
    builder.settings.verdict = dataclasses.replace(builder.settings.verdict, min_turning_loss=10.0)
    assert builder.generate().model is None
    assert builder.last is first
    assert builder.graph.closures  # without those that made it there would be no model for good
    end = builder.generate(final=True)
    assert end.model is None
    assert builder.last is end  # the verdict on the whole scan, whoever asks for it


def test_a_target_that_seemed_to_stand_still_is_turned_back(recording):
    """Tracked as still for its first second: no closure says otherwise, but the motion and the views do."""
    builder = make_model_builder(Settings(), None)
    for k in range(0, 138, STEP):
        T = recording.pose(max(k, 12))
        builder.add_keyframe(KeyFrame(recording.targets[k], T, 0.05 * k), tracked=False)
        builder.add_frame(recording.targets[k], T, tracked=False)
    builder.add_closure(closure(recording, 12, 136))
    generation = builder.generate()
    assert generation.model is not None, generation.why
    assert errors(generation.poses, recording).max() < 1.0


def test_reset_forgets(recording):
    builder = grown(recording, 40)
    builder.reset()
    assert builder.keyframes == [] and builder.store.frames == [] and not builder.should_rebuild
    assert builder.generate().reason == NO_TARGET


def test_half_hidden_frames_enter_no_model(recording):
    """Key frames taken for whole that the others show to be half hidden, and the frames beside them."""
    hidden = {40, 44, 48}
    builder = make_model_builder(Settings())
    for k in range(0, 127, 2):
        frame = shaded(recording.targets[k], 0.5) if k - k % STEP in hidden else recording.targets[k]
        if k % STEP == 0:
            builder.add_keyframe(KeyFrame(frame, drifted(recording, k), 0.05 * k), tracked=False)
        builder.add_frame(frame, drifted(recording, k), tracked=False)
    builder.add_closure(closure(recording, 0, 124))
    generation = builder.generate()
    stamps = {recording.frames[k].stamp_ns for k in hidden}
    keyframes = builder.graph.keyframes
    assert {
        k.stamp_ns for n, k in enumerate(keyframes.frames) if not keyframes.views.is_unoccluded(n)
    } == stamps
    assert generation.model is not None
    assert stamps < set(generation.poses)  # where they are is known none the less
    used = {frame.stamp_ns for frame, _ in keyframes.posed}
    assert not used & stamps
    final = builder.generate(final=True)
    assert final.model is not None
    beside = {recording.frames[k + 2].stamp_ns for k in hidden}
    assert all(f.keyframe_ns in stamps for f in builder.store.frames if f.stamp_ns in stamps | beside)
