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

"""The set of key frames: who looks from where, and moving them together."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, transform
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings


@pytest.fixture
def keyframes(recording):
    """Every tenth frame of the first three, 0, 29 and 57 degrees of turn, at their true poses."""
    chosen = KeyFrameSet(NormalSettings())
    for k in (0, 10, 20):
        chosen.add(KeyFrame(recording.targets[k], recording.pose(k), 0.0), recording.views[k])
    return chosen


def test_key_frames_are_found_by_stamp(keyframes, recording):
    assert len(keyframes) == 3
    assert keyframes.index == {recording.frames[k].stamp_ns: n for n, k in enumerate((0, 10, 20))}
    assert keyframes.views[1] is recording.views[10]


def test_the_set_moves_its_own_copies(recording):
    mine = KeyFrame(recording.targets[0], recording.pose(0), 0.0)
    chosen = KeyFrameSet(NormalSettings())
    chosen.add(mine)
    chosen.move({}, transform(np.eye(3), np.array([1.0, 0, 0])))
    np.testing.assert_array_equal(mine.T_target_sensor, recording.pose(0))
    assert chosen.frames[0].T_target_sensor[0, 3] == pytest.approx(recording.pose(0)[0, 3] + 1)
    assert len(chosen.views[0].points) == len(recording.views[0].points)  # prepared here


def test_centre_is_within_the_target(keyframes):
    # the true target frame's origin is the centroid of its surface; its front half is seen
    assert np.linalg.norm(keyframes.centre) < 0.08


def test_view_angles_are_those_of_the_motion():
    """Three sensors on a circle of 1 m about the centre."""
    centre = np.array([0.3, -0.2, 0.1])
    poses = [
        transform(np.eye(3), centre + np.array([np.sin(a), 0.0, -np.cos(a)])) for a in np.radians([0, 30, 90])
    ]
    chosen = KeyFrameSet(NormalSettings())
    chosen.frames = [KeyFrame(None, T, 0.0) for T in poses]
    angles = np.degrees(chosen.view_angles(poses[1], centre))
    np.testing.assert_allclose(angles, [30, 0, 60], atol=1e-6)
    # a roll about the line of sight is the same view
    rolled = compose(poses[1], transform(exp_so3(np.array([0, 0, 2.0])), np.zeros(3)))
    np.testing.assert_allclose(np.degrees(chosen.view_angles(rolled, centre)), [30, 0, 60], atol=1e-6)


def test_optimised_poses_are_set_and_the_others_follow(keyframes, recording):
    stamps = [recording.frames[k].stamp_ns for k in (0, 10, 20)]
    before = [k.T_target_sensor.copy() for k in keyframes.frames]
    T_new_old = exp_se3(np.array([0.1, 0.2, -0.1, 0.01, 0.02, 0.03]))
    given = {s: compose(exp_se3(np.full(6, 0.01 * n)), before[n]) for n, s in enumerate(stamps[:2])}
    keyframes.move(given, T_new_old)
    for n, s in enumerate(stamps[:2]):
        np.testing.assert_array_equal(keyframes.frames[n].T_target_sensor, given[s])
    np.testing.assert_allclose(keyframes.frames[2].T_target_sensor, compose(T_new_old, before[2]), atol=1e-12)
    assert np.linalg.norm(inverse(before[2]) - np.eye(4)) > 0.1  # the test's poses are no identities


def fresh(recording, k, rgb=None):
    """A frame of the recording that nobody else holds."""
    target = recording.targets[k]
    return dataclasses.replace(target, depth=target.depth.copy(), rgb=rgb)


def test_images_of_no_more_than_so_many_key_frames_are_held(recording):
    chosen, held = KeyFrameSet(NormalSettings(), prepared=3), []
    for k in range(8):
        keyframe = KeyFrame(fresh(recording, k), recording.pose(k), 0.1 * k)
        held.append(weakref.ref(keyframe.frame))
        chosen.add(keyframe)
    del keyframe
    gc.collect()
    assert [ref() is not None for ref in held] == [False] * 5 + [True] * 3
    assert [k.path_rad for k in chosen.frames] == pytest.approx([0.1 * k for k in range(8)])
    frame, T = chosen.posed[1]
    np.testing.assert_array_equal(frame.depth, recording.targets[1].depth)
    np.testing.assert_array_equal(frame.normals, recording.targets[1].normals)
    np.testing.assert_array_equal(T, recording.pose(1))
    assert [f.stamp_ns for f, _ in chosen.posed[2:6:3]] == [recording.targets[k].stamp_ns for k in (2, 5)]


def test_key_frames_with_colours_are_found(recording):
    chosen = KeyFrameSet(NormalSettings(), prepared=1)
    rgb = np.full((*recording.targets[1].depth.shape, 3), 77, np.uint8)
    for k in range(3):
        chosen.add(KeyFrame(fresh(recording, k, rgb if k == 1 else None), recording.pose(k), 0.0))
    (coloured,) = chosen.coloured()
    assert coloured.stamp_ns == recording.targets[1].stamp_ns
    np.testing.assert_array_equal(coloured.frame.rgb, rgb)
    np.testing.assert_array_equal(coloured.T_target_sensor, recording.pose(1))


def test_submaps_are_kept_apart_until_one_is_joined(recording):
    """Seven key frames, the last four of a submap whose target frame is turned and shifted."""
    other = transform(exp_so3(np.array([0.3, -0.8, 0.5])), np.array([0.1, 0.2, -0.3]))
    keyframes = KeyFrameSet(NormalSettings())
    for n, k in enumerate(range(0, 21, 3)):
        T = recording.pose(k)
        of_second = n >= 3
        pose = compose(other, T) if of_second else T
        keyframes.add(KeyFrame(recording.targets[k], pose, 0.0, submap=int(of_second)))
    assert keyframes.active == [3, 4, 5, 6]
    assert [f.linked for f in keyframes.frames] == [False, True, True, False, True, True, True]
    angles = keyframes.view_angles(keyframes.frames[4].T_target_sensor, keyframes.centre)
    assert np.isinf(angles[:3]).all()
    assert np.isfinite(angles[3:]).all()
    assert len(keyframes.posed) == 4
    centre = keyframes.centre

    stamps = [f.stamp_ns for f in keyframes.frames]
    T_earlier_later = compose(inverse(recording.pose(3)), recording.pose(12))
    keyframes.join(stamps[1], stamps[4], T_earlier_later)
    assert keyframes.active == list(range(7))
    for frame, k in zip(keyframes.frames, range(0, 21, 3), strict=True):
        np.testing.assert_allclose(
            frame.T_target_sensor, compose(other, recording.pose(k)), atol=1e-9
        )  # the earlier ones were moved, those of the active submap were not
    assert np.linalg.norm(keyframes.centre - centre) < 0.05
    assert not keyframes.frames[3].linked
    with pytest.raises(ValueError, match='no closure possible'):
        keyframes.join(1, stamps[4], np.eye(4))


@pytest.mark.parametrize('pair', [(1, 3), (3, 5), (1, 5)])
def test_a_closure_that_comes_late_joins_whichever_submaps_it_is_of(recording, pair):
    """Of three submaps of two key frames each; the active one's target frame stays, else the later one's."""
    frame_of = [exp_se3(np.array([0.2, 0.5, -0.4, 0.1, 0.0, 0.3]) * n) for n in range(3)]
    keyframes = KeyFrameSet(NormalSettings())
    for n, k in enumerate(range(0, 18, 3)):
        pose = compose(frame_of[n // 2], recording.pose(k))
        keyframes.add(KeyFrame(recording.targets[k], pose, 0.0, submap=n // 2))
    earlier, later = pair
    stamps = [f.stamp_ns for f in keyframes.frames]
    between = compose(inverse(recording.pose(3 * earlier)), recording.pose(3 * later))
    keyframes.join(stamps[earlier], stamps[later], between)
    joined = {earlier // 2, later // 2}
    label = max(joined)
    assert [f.submap for f in keyframes.frames] == [label if n // 2 in joined else n // 2 for n in range(6)]
    for n, frame in enumerate(keyframes.frames):
        kept = frame_of[label if n // 2 in joined else n // 2]
        np.testing.assert_allclose(frame.T_target_sensor, compose(kept, recording.pose(3 * n)), atol=1e-9)
    if label == 2:  # what the active submap holds is held, though the closure be older
        other = ({0, 1} - joined).pop()
        n = 2 * other
        back = compose(inverse(recording.pose(3 * earlier)), recording.pose(3 * n))
        pair = (
            (stamps[earlier], stamps[n], back) if earlier < n else (stamps[n], stamps[earlier], inverse(back))
        )
        keyframes.join(*pair)
        assert keyframes.active == list(range(6))
        np.testing.assert_allclose(
            keyframes.frames[5].T_target_sensor, compose(frame_of[2], recording.pose(15)), atol=1e-9
        )


def test_joined_submaps_are_known_as_such(recording):
    chosen = KeyFrameSet(NormalSettings())
    for n, k in enumerate((0, 10, 20)):
        chosen.add(KeyFrame(recording.targets[k], recording.pose(k), 0.0, submap=n // 2))
    assert not chosen.joined and chosen.active == [2]
    between = recording.frames[10].stamp_ns, recording.frames[20].stamp_ns
    chosen.join(*between, compose(inverse(recording.pose(10)), recording.pose(20)))
    assert chosen.joined and chosen.active == [0, 1, 2]
