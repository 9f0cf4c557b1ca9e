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

"""Frames refined against their key frames, and the model made of the fused surface."""

from itertools import pairwise

import numpy as np
import pytest
from posed_frames import tumbling
from synthetic import CAMERA, sphere_depth, target_frame

from debris_scanner.core.frames import ClosedMesh, KeyFrame, KeyPose, TargetFrame
from debris_scanner.core.geometry import (
    compose,
    exp_se3,
    exp_so3,
    inverse,
    log_so3,
    rotation_angle,
    transform,
)
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.modelling.frame_store import StoredFrame
from debris_scanner.modelling.fusion import FusedSurface, FusionSettings
from debris_scanner.modelling.refinement import (
    CLOUD_SPACING,
    colour,
    fuse,
    interpolated,
    make_model,
    pose_frames,
    refine_pose,
    refine_to_model,
    refined_poses,
)
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.sensor_model import typical_sensor
from debris_scanner.sensing.views import Surface, View

CENTRE = np.zeros(3)
VOXEL = 0.0015  # m, of the field


@pytest.fixture(scope='module')
def keyframes(recording):
    chosen = KeyFrameSet(NormalSettings())
    for k in range(0, 60, 4):
        chosen.add(KeyFrame(recording.targets[k], recording.pose(k), 0.0), recording.views[k])
    return chosen


def keypose(seconds, T, T_previous=None):
    return KeyPose(round(seconds * 1e9), T, 0.0, linked=T_previous is not None, T_previous=T_previous)


def seen_turned(angle_deg, position=(0.0, 0.0, 1.0)):
    """T_target_sensor of a target turned about y."""
    return inverse(transform(exp_so3(np.radians([0, angle_deg, 0])), np.array(position)))


@pytest.mark.parametrize('drift_deg', [0.0, 4.0, -90.0])
def test_frames_lead_from_key_frame_to_key_frame(drift_deg):
    """Relaxation found the later key frame to be 40 degrees on; the frame half-way between is 20 on."""
    a, b = seen_turned(0.0), seen_turned(40.0, (0.02, 0.0, 1.0))
    tracked = seen_turned(40.0 + drift_deg, (0.02, 0.0, 1.0))
    half_way = seen_turned((40.0 + drift_deg) / 2, (0.01, 0.0, 1.0))
    keyframes = [keypose(0, a), keypose(1, b, compose(inverse(a), tracked))]
    frame = StoredFrame(500_000_000, CAMERA, 0, compose(inverse(a), half_way), None)
    last = StoredFrame(1_200_000_000, CAMERA, 1_000_000_000, np.eye(4), None)
    found = interpolated([frame, last], keyframes, np.zeros(3))
    np.testing.assert_allclose(found[0], seen_turned(20.0, (0.01, 0.0, 1.0)), atol=1e-9)
    np.testing.assert_array_equal(found[1], b)


def test_frames_of_a_submap_stay_with_their_key_frame():
    keyframes = [keypose(0, np.eye(4)), keypose(1, seen_turned(40.0))]
    frame = StoredFrame(500_000_000, CAMERA, 0, seen_turned(3.0), None)
    found = interpolated([frame], keyframes, np.zeros(3))
    np.testing.assert_allclose(found[0], seen_turned(3.0), atol=1e-12)


def test_frames_that_were_not_refined_go_on_from_those_that_were():
    """Those of a key frame of which none was refined stay with it."""
    step = transform(exp_so3(np.radians([0.0, 2.0, 0.0])), np.array([0.01, 0.0, 0.0]))
    away = transform(exp_so3(np.radians([0.0, 0.0, 30.0])), np.array([0.0, 0.1, 0.0]))
    tracked = [np.eye(4), step, step @ step, step @ step @ step]
    frames = [StoredFrame(n, CAMERA, 0, T, None) for n, T in enumerate(tracked)]
    frames.append(StoredFrame(4, CAMERA, 4, step, None))
    pose_frames(frames, {0: np.eye(4), 2: away})
    found = [np.eye(4), step, away, away @ step, step]
    for frame, T in zip(frames, found, strict=True):
        np.testing.assert_allclose(frame.T, T, atol=1e-12)
    assert [f.keyframe_ns for f in frames] == [None, None, None, None, 4]


@pytest.mark.parametrize('k', [6, 22, 41])
def test_disturbed_frame_is_brought_back(recording, keyframes, k):
    truth = recording.pose(k)
    start = compose(exp_se3(np.array([0.015, -0.01, 0.012, 0.002, -0.001, 0.002])), truth)
    found, information = refine_pose(recording.views[k], start, keyframes, CENTRE)
    assert np.linalg.eigvalsh(information)[0] > 1
    E = compose(found, inverse(truth))
    assert np.degrees(rotation_angle(E[:3, :3])) < 0.25
    assert np.linalg.norm(E[:3, 3]) < 6e-4
    for kept, n in zip(keyframes.frames, range(0, 60, 4), strict=True):
        np.testing.assert_array_equal(kept.T_target_sensor, recording.pose(n))


def test_frames_whose_tracking_slipped_follow_each_other(recording, keyframes):
    """Tracking saw a third of every step; each frame alone is too far off to be brought back."""
    first, truth = recording.pose(0), [recording.pose(k) for k in range(0, 16, 2)]
    steps = [compose(inverse(a), b) for a, b in pairwise(truth)]
    tracked = [np.eye(4)]
    for step in steps:
        third = transform(exp_so3(log_so3(step[:3, :3]) / 3), step[:3, 3] / 3)
        tracked.append(compose(tracked[-1], third))
    frames = [StoredFrame(n, CAMERA, 0, T, None) for n, T in enumerate(tracked)]

    def errors(found):
        return np.degrees(
            [rotation_angle((inverse(a) @ b)[:3, :3]) for a, b in zip(found, truth, strict=True)]
        )

    def view_of(frame):
        return recording.views[2 * frame.stamp_ns]

    starts, sensor = [f.pose({0: first}) for f in frames], typical_sensor(recording.views)
    found = refined_poses(frames, starts, view_of, keyframes, sensor, lambda *_: None)
    assert errors([T for T, _ in found]).max() < 0.3
    alone = [refine_pose(view_of(f), T, keyframes, CENTRE)[0] for f, T in zip(frames, starts, strict=True)]
    assert errors(alone).max() > 3


def test_what_no_neighbour_constrains_stays(keyframes, recording):
    """A view that shares nothing with any key frame keeps the pose it came with."""
    away = compose(recording.pose(0), transform(np.eye(3), np.array([0.6, 0, 0])))
    found, information = refine_pose(recording.views[0], away, keyframes, CENTRE)
    np.testing.assert_allclose(found, away, atol=1e-9)
    assert not information.any()


def test_little_information_is_enough_to_come_back():
    """A nearly round target tells little of its turn: no prior may hold it where it was."""
    frames = tumbling('upper_stage')
    surface = fuse(frames, FusionSettings())
    known = Surface.sampled(surface.vertices, surface.normals, 3000)
    turn = transform(exp_so3(np.radians([0.0, 0.0, 0.8])), np.zeros(3))  # about the stage's own axis
    off = []
    for frame, truth in frames[5::12]:
        found, _ = refine_to_model(View(frame), compose(turn, truth), known)
        off.append(np.degrees(rotation_angle(compose(found, inverse(truth))[:3, :3])))
    assert np.median(off) < 0.4


def blob(centre, radius, n=24):
    """Vertices and triangles of a sphere."""
    a, b = np.meshgrid(np.linspace(0, np.pi, n), np.linspace(0, 2 * np.pi, 2 * n), indexing='ij')
    p = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1).reshape(-1, 3)
    i = np.arange((n - 1) * 2 * n).reshape(n - 1, 2 * n)[:, :-1].ravel()
    triangles = np.concatenate(
        [np.stack([i, i + 2 * n, i + 1], 1), np.stack([i + 1, i + 2 * n, i + 2 * n + 1], 1)]
    )
    return FusedSurface(
        (p * radius + centre).astype(np.float32), p.astype(np.float32), triangles.astype(np.int32), VOXEL
    )


def test_model_is_centred_thinned_and_normalised():
    centre = np.array([0.1, -0.2, 0.05])
    surface = blob(centre, 0.08, 160)
    model, shift = make_model(surface, [], None)
    np.testing.assert_allclose(shift, centre, atol=1e-3)
    assert np.abs(model.points.mean(axis=0)).max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(model.points, axis=1), 0.08, atol=5e-4)
    np.testing.assert_allclose(np.linalg.norm(model.normals, axis=1), 1, atol=1e-5)
    assert ((model.normals * model.points).sum(1) > 0).all()
    # about one point a cell of the cloud's voxel grid
    assert len(model.points) < 3 * 4 * np.pi * 0.08**2 / (CLOUD_SPACING * VOXEL) ** 2
    assert len(model.points) > 0.5 * 4 * np.pi * 0.08**2 / (CLOUD_SPACING * VOXEL) ** 2
    np.testing.assert_allclose(model.vertices + shift, surface.vertices, atol=1e-6)
    np.testing.assert_array_equal(model.triangles, surface.triangles)
    assert model.rgb is None
    kept, zero = make_model(surface, [], np.zeros(3))
    assert not zero.any()
    assert np.linalg.norm(kept.points.mean(axis=0) - centre) < 1e-3


@pytest.mark.parametrize(('seen', 'told_apart'), [(0.9, True), (0.3, False)])
def test_a_closed_surface_that_does_not_tell_what_was_seen_leaves_the_fused_one(seen, told_apart):
    surface = blob(np.zeros(3), 0.08, 160)
    observed = np.arange(len(surface.triangles)) < seen * len(surface.triangles)
    model, _ = make_model(surface, [], None, ClosedMesh(surface.vertices, surface.triangles, observed))
    assert (model.closed is not None) == told_apart
    assert len(model.triangles) == (observed.sum() if told_apart else len(surface.triangles))


def test_recorded_frames_fuse_to_one_surface_without_small_parts(recording):
    posed = [(recording.targets[k], recording.pose(k)) for k in range(0, 126, 6)]
    surface = fuse(posed, FusionSettings(voxel=2.0))
    assert 0.30 < np.ptp(surface.vertices, axis=0).max() < 0.40
    # one large part; what is left beside it is not dust
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    t = surface.triangles
    links = coo_array(
        (np.ones(2 * len(t)), (np.r_[t[:, 0], t[:, 1]], np.r_[t[:, 1], t[:, 2]])), (t.max() + 1,) * 2
    )
    _, label = connected_components(links, directed=False)
    sizes = np.bincount(label)
    assert sizes.max() > 0.7 * sizes.sum()
    assert sizes.min() >= 20


def test_nothing_to_fuse_is_no_surface():
    hidden = target_frame(sphere_depth(radius=0.1))
    # no plane fits anywhere, so that nothing can be integrated
    hidden = TargetFrame(0, CAMERA, hidden.depth, np.zeros_like(hidden.depth), np.zeros_like(hidden.normals))
    assert fuse([(hidden, np.eye(4))], FusionSettings()) is None


def test_colour_is_the_mean_of_what_key_frames_saw():
    T_sensor_target = transform(np.eye(3), np.array([0, 0, 0.5]))
    depth = sphere_depth((0, 0, 0.5), 0.08)

    def seen(value):
        rgb = np.zeros((120, 160, 3), np.uint8)
        rgb[...] = value
        return KeyFrame(target_frame(depth, rgb=rgb), inverse(T_sensor_target), 0.0)

    front, back = np.array([[0.0, 0.0, -0.08], [0.03, 0.01, -0.073]]), np.array([[0.0, 0.0, 0.08]])
    points = np.concatenate([front, back])
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    rgb = colour(points, normals, [seen((10, 100, 250)), seen((20, 100, 200))])
    np.testing.assert_array_equal(rgb, [[15, 100, 225], [15, 100, 225], [128, 128, 128]])
    grey = KeyFrame(target_frame(depth), inverse(T_sensor_target), 0.0)
    assert colour(points, normals, [grey]) is None
    np.testing.assert_array_equal(colour(points, normals, [grey, seen((9, 8, 7))])[0], [9, 8, 7])
