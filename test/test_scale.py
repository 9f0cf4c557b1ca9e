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

"""A scene twice as large, seen by the same camera, is scanned the same way, and its model is twice as large.

The frames are recorded ones. Twice their depth is exact, so what differs is what was left in metres.
"""

import dataclasses

import numpy as np
import pytest
from coarse_frames import coarse
from on_demand import OnDemand

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import compose, exp_se3, inverse, rotation_angle, transform
from debris_scanner.mapping.closures import VerificationSettings, verify
from debris_scanner.mapping.relaxation import Edge, relax
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import fuse, make_model
from debris_scanner.modelling.symmetry import rotational_symmetry
from debris_scanner.modelling.validation import PosedKeyFrames, VerdictSettings, judge_poses
from debris_scanner.registration.projective import register
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.normals import NormalSettings, fit_normals
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import View
from debris_scanner.tracking.pose_search import global_pose_search, tracking_surface

DOUBLE = 2.0
TURN = 126  # frames of a full turn
SHARES = ('overlap', 'rms', 'conflict_ratio', 'silhouette_violation_ratio', 'visible_inlier_ratio')


def doubled(T):
    """The pose with its translation doubled."""
    return transform(T[:3, :3], DOUBLE * T[:3, 3])


def doubled_frame(frame):
    depth = frame.depth * np.float32(DOUBLE)
    fitted, normals = fit_normals(depth, frame.camera, NormalSettings())
    return dataclasses.replace(frame, depth=depth, depth_fit=fitted, normals=normals)


@pytest.fixture(scope='module')
def large(recording):
    """The recorded target frames, of a scene twice as large."""
    return OnDemand(len(recording.targets), lambda k: doubled_frame(recording.targets[k]))


def apart(T, other):
    """Degrees and metres between two poses."""
    E = compose(inverse(other), T)
    return np.degrees(rotation_angle(E[:3, :3])), np.linalg.norm(E[:3, 3])


def same_stats(a, b):
    for name in SHARES:
        assert getattr(b, name) == pytest.approx(getattr(a, name), rel=0.005, abs=2e-3), name
    assert b.points == a.points


def off(T, degrees, metres):
    return compose(exp_se3(np.array([0, np.radians(degrees), 0, metres, 0, 0])), T)


def test_planes_and_views_are_those_of_the_small_scene(recording, large):
    for k in (0, 30):
        small, big = recording.views[k], View(large[k])
        assert big.footprint == pytest.approx(DOUBLE * small.footprint)
        np.testing.assert_allclose(large[k].depth_fit, DOUBLE * recording.targets[k].depth_fit, rtol=1e-6)
        np.testing.assert_allclose(large[k].normals, recording.targets[k].normals, atol=1e-5)
        np.testing.assert_allclose(big.points, DOUBLE * small.points, rtol=1e-5)
        np.testing.assert_array_equal(big.rim.edge, small.rim.edge)


def test_registered_poses_are_doubled(recording, large):
    start = off(recording.pose(4), 3.0, 0.005)
    T, lin = register(recording.views[4], start, recording.views[0], recording.pose(0))
    T_large, lin_large = register(View(large[4]), doubled(start), View(large[0]), doubled(recording.pose(0)))
    turn, shift = apart(T_large, doubled(T))
    assert turn < 0.01  # the iterations end with steps of a hundredth
    assert shift < 3e-4  # of the sensor, 1.6 m away
    same_stats(lin.stats, lin_large.stats)


@pytest.mark.parametrize(
    ('frame', 'degrees', 'shift'),
    [
        (TURN, 4.0, 0.0),
        (TURN, 0.0, 0.015),
        (TURN, 0.0, 0.04),
        (TURN, 12.0, 0.0),
        (63, 0.0, 0.0),
        (50, 0.0, 0.0),
    ],
)
def test_closures_are_decided_alike(recording, large, frame, degrees, shift):
    """Some are accepted, some are too far off to be found, some are of another face."""
    estimate = off(recording.pose(frame if frame == TURN else 0), degrees, shift)
    small = verify(
        recording.views[frame], estimate, recording.views[0], recording.pose(0), VerificationSettings()
    )
    big = verify(
        View(large[frame]),
        doubled(estimate),
        View(large[0]),
        doubled(recording.pose(0)),
        VerificationSettings(),
    )
    assert big.accepted == small.accepted == (frame == TURN and shift < 0.03)
    if small.accepted:
        turn, metres = apart(big.T_target_view, doubled(small.T_target_view))
        assert turn < 0.02
        assert metres < 2e-4
        same_stats(small.stats, big.stats)


def test_relaxed_poses_are_doubled(recording, large):
    chosen = [0, 4, 8, 12, 16]
    edges = [Edge(k + 1, k, False) for k in range(4)] + [Edge(k + 2, k, True) for k in range(3)]
    start = [off(recording.pose(k), 0.4 * n, 0.001 * n) for n, k in enumerate(chosen)]
    small = relax([recording.views[k] for k in chosen], start, edges, 12)
    big = relax([View(large[k]) for k in chosen], [doubled(T) for T in start], edges, 12)
    assert big.weights == small.weights
    for T, T_large in zip(small.poses, big.poses, strict=True):
        turn, shift = apart(T_large, doubled(T))
        assert turn < 0.04  # the iterations end with steps of a hundredth
        assert shift < 1e-3  # of the sensor, 1.6 m away


@pytest.fixture(scope='module')
def models(recording, large):
    """Surface, posed frames and model of both scenes."""

    def made(frames, poses):
        posed = list(zip(frames, poses, strict=True))
        surface = fuse(posed, FusionSettings())
        return surface, posed, make_model(surface, [], np.zeros(3))[0]

    chosen = range(0, TURN, 6)
    poses = [recording.pose(k) for k in chosen]
    return (
        made([recording.targets[k] for k in chosen], poses),
        made([large[k] for k in chosen], [doubled(T) for T in poses]),
    )


def test_the_model_is_doubled(models):
    (small_surface, _, small), (big_surface, _, big) = models
    assert big_surface.voxel == pytest.approx(DOUBLE * small_surface.voxel, rel=1e-5)
    assert len(big.points) == pytest.approx(len(small.points), rel=0.002)
    assert len(big.triangles) == pytest.approx(len(small.triangles), rel=0.002)
    assert big.spacing == pytest.approx(DOUBLE * small.spacing, rel=0.01)
    assert big.radius == pytest.approx(DOUBLE * small.radius, rel=0.005)
    np.testing.assert_allclose(np.ptp(big.points, axis=0), DOUBLE * np.ptp(small.points, axis=0), rtol=0.005)
    assert rotational_symmetry(big) == rotational_symmetry(small)


def test_the_verdict_is_the_same(models):
    for slipped in (False, True):
        verdicts = []
        for (_, posed, _), scale in zip(models, (1.0, DOUBLE), strict=True):
            by = transform(np.eye(3), np.array([0.03 * scale, 0.0, 0.0]))
            views = [View(f) for f, _ in posed]
            poses = [compose(by, T) if slipped and n % 3 == 0 else T for n, (_, T) in enumerate(posed)]
            no, yes = [False] * len(views), [True] * len(views)
            found = PosedKeyFrames(views, poses, poses, no, yes, no)
            verdicts.append(judge_poses(found, typical_sensor(views), VerdictSettings()))
        assert verdicts[0].reason == verdicts[1].reason
        assert (verdicts[0].reason is None) == (not slipped)


def test_a_pose_found_in_the_model_is_doubled(models, recording, large):
    (_, _, small), (_, _, big) = models
    T = global_pose_search(tracking_surface(small), recording.views[0])[0]
    T_large = global_pose_search(tracking_surface(big), View(large[0]))[0]
    truth = recording.truth[recording.frames[0].stamp_ns]
    for found, true in ((T, truth), (T_large, doubled(truth))):
        turn, shift = apart(found, true)
        assert turn < 4
        assert shift < 0.016


@pytest.mark.slow
def test_a_scan_is_doubled(recording):
    """Every frame is accepted or rejected alike, the loop closes at the same frame, poses are doubled."""
    scans = []
    for scale in (1.0, DOUBLE):
        scanner, steps = Scanner(), []
        for frame in map(coarse, recording.frames[:139:4]):
            depth = frame.depth * np.float32(scale)
            steps.append(scanner.process(DepthFrame(frame.stamp_ns, depth, frame.camera)))
        scans.append((steps, scanner.finish()))
    (small_steps, small), (big_steps, big) = scans
    for a, b in zip(small_steps, big_steps, strict=True):
        assert a.rejected == b.rejected
        assert a.estimate.accepted == b.estimate.accepted
        assert (a.estimate.keyframe is None) == (b.estimate.keyframe is None)
        assert (a.generation is None) == (b.generation is None)
        turn, shift = apart(b.estimate.T_sensor_target, doubled(a.estimate.T_sensor_target))
        assert turn < 0.3
        assert shift < 0.003
    assert small.reason is big.reason is None
    assert [(c.from_stamp_ns, c.to_stamp_ns, c.accepted) for c in big.closures] == [
        (c.from_stamp_ns, c.to_stamp_ns, c.accepted) for c in small.closures
    ]
    for a, b in zip(small.poses, big.poses, strict=True):
        turn, shift = apart(b.T_sensor_target, doubled(a.T_sensor_target))
        assert turn < 0.3
        assert shift < 0.003
    assert len(big.model.points) == pytest.approx(len(small.model.points), rel=0.01)
    assert big.model.radius == pytest.approx(DOUBLE * small.model.radius, rel=0.01)
    assert big.symmetry == small.symmetry
