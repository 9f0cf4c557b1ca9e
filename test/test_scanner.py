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

"""The whole scanner over the recorded session: its states, its model, and scans without one."""

import dataclasses

import numpy as np
import pytest
import trimesh
from coarse_frames import coarse

from debris_scanner.core.frames import DepthFrame, Model
from debris_scanner.core.geometry import compose, inverse, rotation_angle
from debris_scanner.core.results import INTERRUPTED, NO_CLOSURE, NO_MATCH, NO_TARGET, TOO_FEW_FRAMES
from debris_scanner.evaluation.trajectory_errors import align, pose_errors
from debris_scanner.modelling import validation
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.sim.sensors import SENSORS
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import make_target

FRAMES = 139


@pytest.fixture(scope='module')
def frames(recording):
    """A turn and a bit."""
    return recording.frames[:FRAMES]


@pytest.fixture(scope='module')
def scan(frames):
    """A turn and a bit: the scanner, the steps, its state after each, and the result."""
    scanner = Scanner()
    steps, states = [], []
    for frame in frames:
        steps.append(scanner.process(frame))
        states.append(scanner.state)
    progress = []
    result = scanner.finish(progress=lambda *what: progress.append(what))
    return scanner, steps, states, result, progress


@pytest.mark.slow
def test_scanning_becomes_tracking_when_the_model_comes(scan):
    _, steps, states, _, _ = scan
    (generated,) = [
        k for k, s in enumerate(steps) if s.generation is not None and s.generation.model is not None
    ]
    assert states[:generated] == ['scanning'] * generated
    assert states[generated:] == ['tracking'] * (FRAMES - generated)
    assert 118 <= generated <= 132  # 126 frames are a turn
    assert any(c.accepted for c in steps[generated].closures)
    assert steps[generated].generation.reason is None
    assert all(s.rejected is None and s.estimate.accepted for s in steps)


def test_every_key_frame_comes_with_its_hypotheses(scan):
    scanner, steps, _, result, _ = scan
    assert all(s.estimate.keyframe is not None for s in steps if s.closures)
    assert (
        [c.record for s in steps for c in s.closures] == result.closures == scanner.back_end.recorder.closures
    )
    assert [s.estimate.keyframe.stamp_ns for s in steps if s.estimate.keyframe] == [
        k.stamp_ns for k in result.keyframe_poses
    ]


def test_model_and_poses_are_right(scan, frames, recording):
    _, _, _, result, _ = scan
    assert result.reason is None
    assert result.model is not None and len(result.model.points) > 20_000
    assert np.abs(result.model.points.mean(axis=0)).max() < 1e-3
    estimate = {p.stamp_ns: p.T_sensor_target for p in result.poses}
    assert list(estimate) == [f.stamp_ns for f in frames]
    attitude, position = pose_errors(recording.truth, estimate, align(recording.truth, estimate))
    assert np.degrees(np.median(attitude)) < 0.3
    assert np.degrees(attitude.max()) < 1.0
    assert position.max() < 0.002


def test_odometry_is_what_was_said_live(scan):
    """Before the loop closed, to the letter; afterwards continued in the scan's own target frame."""
    _, steps, states, result, _ = scan
    first = states.index('tracking')
    for step, pose in zip(steps[: first + 1], result.odometry, strict=False):
        np.testing.assert_array_equal(pose.T_sensor_target, step.estimate.T_sensor_target)
    jump = compose(
        inverse(result.odometry[first].T_sensor_target), result.odometry[first + 1].T_sensor_target
    )
    # one frame's turn, 2.9 degrees, and no jump of the model's frame against the scan's
    assert np.degrees(rotation_angle(jump[:3, :3])) < 4.5


def test_rotation_is_reported(scan, recording):
    result = scan[3]
    assert result.rotation_period_s == pytest.approx(4 * np.pi, rel=0.02)
    a, b = (recording.truth[recording.frames[k].stamp_ns][:3, :3] for k in (0, 40))
    turn = b @ a.T
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    assert result.rotation_axis_sensor @ axis / np.linalg.norm(axis) > np.cos(np.radians(3))


def test_timing_has_a_row_for_every_stage(scan):
    timing = scan[3].timing
    for stage in ('isolate', 'normals', 'registration', 'tracking', 'descriptor', 'generation', 'fusion'):
        assert timing[stage]['count'] > 0
        assert 0 < timing[stage]['p50_ms'] <= timing[stage]['p99_ms']
    assert timing['isolate']['count'] == FRAMES


def test_progress_of_the_end_counts_up_to_its_total(scan):
    progress = scan[4]
    assert progress
    for what in {w for w, _, _ in progress}:
        done = [(d, n) for w, d, n in progress if w == what]
        assert [d for d, _ in done] == list(range(1, done[0][1] + 1))


@pytest.mark.slow
def test_a_known_model_is_found_and_tracked(scan, recording):
    """From some moment on, within a second; final poses are those of the model."""
    model, truth = scan[3].model, recording.truth
    scanner, frames = Scanner(model=model), [coarse(f) for f in recording.frames[60:110]]
    steps = [scanner.process(f) for f in frames]
    placed = [k for k, s in enumerate(steps) if s.generation is not None and s.generation.model is not None]
    assert placed and placed[0] <= 10
    assert all(s.estimate.tracked for s in steps[placed[0] + 1 :])
    stored = scanner.back_end.builder.store.frames
    stored.insert(0, dataclasses.replace(stored[0], stamp_ns=1, keyframe_ns=2))  # of another submap
    result = scanner.finish()
    assert (result.reason, result.tracked) == (None, True)
    assert result.model is model
    own = {p.stamp_ns: p.T_sensor_target for p in scan[3].poses}
    T_target_truth = align(truth, own)
    estimate = {p.stamp_ns: p.T_sensor_target for p in result.poses}
    assert list(estimate) == [f.stamp_ns for f in frames]
    attitude, position = pose_errors(truth, estimate, T_target_truth)
    assert np.degrees(np.median(attitude)) < 0.15
    assert np.degrees(attitude.max()) < 0.5
    assert position.max() < 0.002


@pytest.mark.slow
def test_a_model_of_another_size_is_no_match(scan, recording):
    model = scan[3].model
    smaller = dataclasses.replace(
        model, points=0.95 * model.points, vertices=0.95 * model.vertices, closed=None
    )
    scanner = Scanner(model=smaller)
    for frame in recording.frames[60:76]:
        scanner.process(coarse(frame))
    result = scanner.finish()
    assert (result.reason, result.model, result.tracked) == (NO_MATCH, None, False)
    assert len(result.odometry) == 16
    assert 'of the size of the model' in scanner.back_end.builder.last.why


@pytest.mark.slow
def test_a_model_that_was_taken_for_the_target_is_given_up(recording):
    """The tank with its boosters, until the orbiter comes round."""
    tank = make_target('tank_boosters', size=1.03 * 0.34)
    mesh = trimesh.Trimesh(tank.vertices, tank.triangles, process=False)
    points, face = trimesh.sample.sample_surface(mesh, 8000, seed=0)
    points, normals = points.astype(np.float32), mesh.face_normals[face].astype(np.float32)
    model = Model(points, normals, tank.vertices.astype(np.float32), tank.triangles.astype(np.int32))
    scanner = Scanner(model=model)
    steps = [scanner.process(coarse(f)) for f in recording.frames[:32]]
    placed = [k for k, s in enumerate(steps) if s.generation is not None and s.generation.model is not None]
    given_up = [k for k, s in enumerate(steps) if s.generation is not None and s.generation.withdrawn]
    assert len(given_up) == 1 and placed[0] < given_up[0]
    before, after = (steps[k].estimate for k in (given_up[0], given_up[0] + 1))
    assert before.tracked and not after.tracked
    assert after.submap > before.submap
    assert not any(s.estimate.tracked for s in steps[given_up[0] + 1 :])
    assert not scanner.back_end.builder.has_model
    result = scanner.finish()
    assert (result.reason, result.model, result.tracked) == (NO_MATCH, None, False)


def scanned(frames, settings=None):
    scanner = Scanner(settings)
    steps = [scanner.process(f) for f in frames]
    return scanner, steps, scanner.finish()


def test_empty_scene_has_no_target(recording):
    empty = [DepthFrame(k, np.zeros((480, 640), np.float32), recording.frames[0].camera) for k in range(15)]
    scanner, steps, result = scanned(empty)
    assert {s.rejected for s in steps} == {'no_target'}
    assert scanner.state == 'scanning'
    assert (result.reason, result.model) == (NO_TARGET, None)
    assert (result.frames_read, result.frames_rejected) == (15, {'no_target': 15})
    assert result.poses == result.odometry == []


def still(frame, count):
    """The same image again and again, with fresh noise."""
    rng = np.random.default_rng(0)
    for k in range(count):
        noise = rng.normal(scale=0.0005, size=frame.depth.shape).astype(np.float32)
        depth = np.where(frame.depth > 0, frame.depth + noise, 0).astype(np.float32)
        yield DepthFrame(1 + k * 100_000_000, depth, frame.camera)


def test_still_target_closes_no_loop(recording):
    _, steps, result = scanned(still(recording.frames[0], 25))
    assert (result.reason, result.model) == (NO_CLOSURE, None)
    assert len(result.keyframe_poses) == 1
    assert all(s.estimate.accepted for s in steps)
    assert result.closures == []
    assert result.rotation_period_s is None and result.rotation_axis_sensor is None
    assert len(result.poses) == 25
    assert max(rotation_angle(p.T_sensor_target[:3, :3]) for p in result.poses) < np.radians(1.5)


@pytest.mark.parametrize(('count', 'reason'), [(5, TOO_FEW_FRAMES), (20, NO_CLOSURE)])
def test_short_scans(recording, count, reason):
    assert scanned(recording.frames[:count])[2].reason == reason


def test_nothing_at_all_is_no_target():
    result = Scanner().finish()
    assert (result.reason, result.frames_read) == (NO_TARGET, 0)


def test_interruption_is_the_reason_where_there_is_no_model(recording):
    scanner = Scanner()
    for frame in recording.frames[:12]:
        scanner.process(frame)
    assert scanner.finish(INTERRUPTED).reason == INTERRUPTED


def test_undecodable_input_is_counted(recording):
    scanner = Scanner()
    scanner.reject('malformed')
    scanner.process(recording.frames[0])
    scanner.reject('malformed')
    scanner.process(recording.frames[0])  # the same stamp again
    result = scanner.finish()
    assert result.frames_read == 4
    assert result.frames_rejected == {'malformed': 2, 'non_monotone_stamp': 1}


def test_reset_starts_a_new_scan(scan, frames):
    scanner = Scanner()
    for frame in frames[:30]:
        scanner.process(frame)
    scanner.reject('malformed')
    scanner.reset()
    assert (scanner.frames_used, dict(scanner.front_end.rejected), scanner.state) == (0, {}, 'scanning')
    again = [scanner.process(f).estimate.T_sensor_target for f in frames[:10]]
    for T, step in zip(again, scan[1], strict=False):
        np.testing.assert_array_equal(T, step.estimate.T_sensor_target)


def test_settings_reach_their_stages():
    from debris_scanner.core.parameters import updated

    scanner = Scanner(updated(Settings(), {'odometry.keyframe_angle_deg': 11.0, 'fusion.voxel': 2.7}))
    assert scanner.front_end.odometry.settings.keyframe_angle_deg == 11.0
    assert scanner.back_end.builder.settings.fusion.voxel == 2.7


GAP_NS = 30_000_000_000


def after_a_gap(frames):
    """The same frames, half a minute later."""
    return [dataclasses.replace(f, stamp_ns=f.stamp_ns + GAP_NS) for f in frames]


def test_out_of_sight_for_too_long_a_submap_begins(recording):
    """Half a minute later it shows another side: nothing tells how it got there."""
    scanner = Scanner()
    before = [scanner.process(f) for f in recording.frames[:20]]
    after = [scanner.process(f) for f in after_a_gap(recording.frames[60:66])]
    assert all(s.estimate.accepted and s.estimate.submap == 0 for s in before)
    assert after[-1].estimate.accepted and after[-1].estimate.submap == 1
    first = next(s.estimate for s in after if s.estimate.submap == 1)
    assert first.keyframe is not None and first.keyframe.submap == 1
    result = scanner.finish()
    assert result.reason == NO_CLOSURE
    # the larger submap is what can be told: poses of the other are in another frame
    assert [p.stamp_ns for p in result.poses] == [f.stamp_ns for f in recording.frames[:20]]
    assert [p.stamp_ns for p in result.odometry] == [p.stamp_ns for p in result.poses]
    assert len(result.keyframe_poses) == 7


@pytest.mark.slow
def test_submaps_that_show_a_side_in_common_become_one(recording):
    """Two parts of a turn that overlap by a fifth of it; neither closes a loop of its own."""
    scanner = Scanner()
    frames = [*recording.frames[:70:2], *after_a_gap(recording.frames[45:115:2])]
    steps = [scanner.process(coarse(f)) for f in frames]
    joined = [c for s in steps for c in s.closures if c.accepted and 'joins a submap' in c.why]
    assert len(joined) == 2
    assert all(c.from_stamp_ns < GAP_NS / 2 < c.to_stamp_ns for c in joined)
    result = scanner.finish()
    assert result.reason is None
    assert len(result.poses) > 65
    truth = dict(recording.truth)
    truth |= {stamp + GAP_NS: T for stamp, T in recording.truth.items()}
    estimate = {p.stamp_ns: p.T_sensor_target for p in result.poses}
    assert min(estimate) < GAP_NS / 2 < max(estimate)
    attitude, position = pose_errors(truth, estimate, align(truth, estimate))
    assert np.degrees(np.median(attitude)) < 0.3
    assert np.degrees(attitude.max()) < 1.0
    assert position.max() < 0.002
    assert {(e.i, e.j) for e in result.edges} <= {
        (i, j) for i in range(60) for j in range(i + 1, len(result.keyframe_poses))
    }


@pytest.mark.slow
def test_a_part_that_may_lie_otherwise_is_taken_out(recording, monkeypatch):
    """Then neither of the two has closed a loop."""
    monkeypatch.setattr(validation, 'least_joining_loss', lambda *_: 0.0)
    scanner = Scanner()
    for frame in [*recording.frames[:70:2], *after_a_gap(recording.frames[45:115:2])]:
        scanner.process(coarse(frame))
    result = scanner.finish()
    assert result.reason == NO_CLOSURE
    assert len(result.poses) <= 35  # of one part


@pytest.mark.parametrize(('scale', 'unit'), [(1.0, ''), (39.37, 'inches'), (100.0, 'centimetres')])
def test_a_model_in_another_unit_is_asked_for_when_the_target_is_seen(recording, scale, unit):
    stack = make_target('shuttle_stack', size=0.34)
    mesh = trimesh.Trimesh(scale * stack.vertices, stack.triangles, process=False)
    points, face = trimesh.sample.sample_surface(mesh, 3000, seed=0)
    vertices, normals = mesh.vertices.astype(np.float32), mesh.face_normals[face].astype(np.float32)
    scanner = Scanner(
        model=Model(points.astype(np.float32), normals, vertices, stack.triangles.astype(np.int32))
    )
    assert scanner.model_warning == ''
    scanner.process(recording.frames[0])
    assert (f'is it in {unit}?' in scanner.model_warning) if unit else scanner.model_warning == ''


def test_frames_before_it_is_known_what_stands_still_are_taken_up():
    """Steps of 12 degrees, beside a mug: the first seven frames could not tell the two apart."""
    scanner = Scanner()
    steps = []
    settings = SimulationSettings('shuttle_stack', seconds=2.4, rate_hz=5.0, spin_rad_s=1.0, clutter='object')
    for f in Simulation(settings):
        frame = DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera)
        steps.append(scanner.process(coarse(frame)))
    assert steps[0].rejected == 'settling' and steps[-1].rejected is None
    assert not scanner.front_end.rejected
    result = scanner.finish()
    assert len(result.odometry) == len(steps)
    stamps = [p.stamp_ns for p in result.odometry]
    assert stamps == sorted(stamps)


@pytest.mark.slow
def test_a_target_on_a_desk_is_scanned_without_the_desk():
    """It touches the desk from the first frame, turns on it by 12 degrees a frame, and is all that moves."""
    scanner = Scanner()
    settings = SimulationSettings(
        'asteroid', seconds=8.0, rate_hz=5.0, spin_rad_s=1.05, clutter='desk', axis_sensor=(0.0, 0.85, 0.5)
    )
    simulation = Simulation(settings)
    for f in simulation:
        frame = DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera)
        scanner.process(coarse(frame))
    result = scanner.finish()
    assert len(result.odometry) == len(simulation)  # the first ones too
    assert result.reason is None
    true = simulation.target.vertices
    reach = np.linalg.norm(true - true.mean(axis=0), axis=1).max()
    seen = result.model.points
    assert np.linalg.norm(seen - seen.mean(axis=0), axis=1).max() < 1.1 * reach


@pytest.mark.slow
def test_a_sensor_that_bends_its_images_is_calibrated():
    """A prism turns before a time-of-flight camera; the offset goes with the model to odometry and result."""
    scanner, truth = Scanner(Settings()), {}
    settings = SimulationSettings(target='prism', motion='tumble', sensor='flexx', rate_hz=5.0, seconds=40.0)
    for f in Simulation(settings):
        step = scanner.process(DepthFrame(f.stamp_ns, f.depth, f.camera))
        truth[f.stamp_ns] = f.T_sensor_target
        keyframes = scanner.back_end.builder.keyframes
        if len(keyframes) == 55 and step.estimate.keyframe is not None:  # a live scan would not wait longer
            scanner.front_end.adopt(scanner.back_end.generate())
    result = scanner.finish()
    assert result.reason is None
    offset = scanner.front_end.odometry.keyframes.views.offset
    assert 0.5 < offset.rms / SENSORS['flexx'].offset_share < 2.5
    assert result.sensor['offset_m'] == pytest.approx(offset.rms * result.sensor['range_m'], rel=0.3)
    poses = {p.stamp_ns: p.T_sensor_target for p in result.poses}
    attitude, _ = pose_errors(truth, poses, align(truth, poses))
    assert np.degrees(np.median(attitude)) < 0.4  # 1.0 without
