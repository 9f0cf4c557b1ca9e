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

"""Poses of all frames, depth of a bounded number."""

import numpy as np
import pytest
from synthetic import CAMERA, sphere_depth, target_frame

from debris_scanner.core.frames import KeyPose
from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, transform
from debris_scanner.modelling.frame_store import (
    FrameStore,
    Restorer,
    StoredFrame,
    between,
    followed,
    reassign,
)
from debris_scanner.sensing.normals import NormalSettings

SETTINGS = NormalSettings()
T = exp_se3(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))


def fill(capacity, count):
    store = FrameStore(capacity)
    small = target_frame(np.full((20, 20), 0.7, np.float32))
    for k in range(count):
        store.add(type(small)(k, CAMERA, small.depth, small.depth_fit, small.normals), None, np.eye(4))
    return store


def test_frame_comes_back_as_it_was():
    frame = target_frame(sphere_depth(), 17)
    store = FrameStore(10)
    store.add(frame, 5, T)
    restored = store.frames[0].restore(SETTINGS)
    assert restored.stamp_ns == 17
    assert restored.camera == CAMERA
    np.testing.assert_allclose(restored.depth, frame.depth, atol=5.1e-5)
    np.testing.assert_array_equal(restored.depth > 0, frame.depth > 0)
    both = (frame.depth_fit > 0) & (restored.depth_fit > 0)
    assert both.sum() > 0.99 * (frame.depth_fit > 0).sum()
    assert (restored.normals * frame.normals).sum(-1)[both].min() > 0.999


def test_a_far_target_comes_back_too():
    frame = target_frame(10 * sphere_depth())
    store = FrameStore(10)
    store.add(frame, 5, T)
    np.testing.assert_allclose(store.frames[0].restore(SETTINGS).depth, frame.depth, atol=1e-4)


def test_pose_follows_its_key_frame():
    store = FrameStore(10)
    store.add(target_frame(sphere_depth(), 1), 99, T)
    store.add(target_frame(sphere_depth(), 2), None, T)
    key = exp_se3(np.array([-0.3, 0.1, 0, 1, 2, 3]))
    np.testing.assert_allclose(store.frames[0].pose({99: key}), compose(key, T), atol=1e-12)
    np.testing.assert_array_equal(store.frames[1].pose({99: key}), T)


@pytest.mark.parametrize(('capacity', 'count'), [(10, 10), (10, 11), (10, 100), (16, 1000), (3, 50)])
def test_depths_are_bounded_and_evenly_spread(capacity, count):
    store = fill(capacity, count)
    kept = [f.stamp_ns for f in store.with_depth]
    assert [f.stamp_ns for f in store.frames] == list(range(count))
    assert min(count, capacity) / 2 <= len(kept) <= capacity
    assert len(set(np.diff(kept))) <= 1
    assert kept[0] == 0
    assert count - 1 - kept[-1] < max(1, kept[1] - kept[0])


def test_depth_that_was_not_kept_is_named():
    store = fill(2, 9)
    gone = next(f for f in store.frames if f.depth is None)
    with pytest.raises(ValueError, match=str(gone.stamp_ns)):
        gone.restore(SETTINGS)


def test_restored_frames_are_a_sequence_that_keeps_the_first_ones():
    store = FrameStore(10)
    for k in range(5):
        store.add(target_frame(sphere_depth(), k), None, exp_se3(np.array([0, 0, 0, k, 0, 0.0])))
    size = 5 * sphere_depth().nbytes  # depth, planes' depth, and three numbers of a normal
    frames = Restorer(SETTINGS, room=3 * size).posed(store.frames)
    assert len(frames) == 5
    assert [f.stamp_ns for f, _ in frames] == list(range(5))
    frame, pose = frames[3]
    np.testing.assert_array_equal(frame.normals, store.frames[3].restore(SETTINGS).normals)
    np.testing.assert_array_equal(pose, store.frames[3].T)
    assert [f.stamp_ns for f, _ in frames[::2]] == [0, 2, 4]
    assert frames[2][0] is frames[2][0]
    assert frames[3][0] is not frame


def turned(degrees):
    return transform(exp_so3(np.array([0, 0, np.radians(degrees)])), np.array([0, 0, 0.1 * degrees]))


def scanned(keyframes, frames):
    """Key frames and frames by time, s, and turn, deg; frames move with the key frame before them."""
    poses = [KeyPose(round(t * 1e9), turned(a), 0.0) for t, a in keyframes]
    stored = []
    for t, a in frames:
        before = [k for k in poses if k.stamp_ns <= t * 1e9][-1]
        T = compose(inverse(before.T_target_sensor), turned(a))
        depth = np.zeros((2, 2), np.uint16)
        stored.append(StoredFrame(round(t * 1e9), CAMERA, before.stamp_ns, T, depth, 1e-3))
    return poses, stored


def test_frames_become_key_frames_where_these_lie_far_apart():
    """Key frames every 6 degrees, then one after 44; frames every 1.25."""
    keyframes = [(0.5 * k, 6.0 * k) for k in range(10)] + [(8.0, 97.75)]
    frames = [(0.1 * k, 1.2 * k) for k in range(45)] + [(4.5 + 0.1 * k, 54 + 1.25 * k) for k in range(60)]
    poses, stored = scanned(keyframes, frames)
    chosen = between(stored, poses, 100)
    assert all(unbroken for _, unbroken in chosen)
    assert [round(f.stamp_ns * 1e-9, 1) for f, _ in chosen] == [5, 5.5, 6, 6.5, 7, 7.5, 8.5, 9, 9.5, 10]
    assert len(between(stored, poses, 3)) in (2, 3)
    assert between(stored, poses[:1], 3) == []  # nothing says how far apart they are


@pytest.mark.parametrize('slower', [1, 20])
def test_a_frame_after_an_interruption_is_not_tracked_on(slower):
    keyframes = [(0.5 * k * slower, 6.0 * k) for k in range(10)]
    frames = [((4.5 + 0.1 * k) * slower, 54.0 + 1.3 * k) for k in range(10)] + [
        ((8.0 + 0.1 * k) * slower, 80.0 + 1.1 * k) for k in range(8)
    ]
    poses, stored = scanned(keyframes, frames)
    assert [(f.stamp_ns, unbroken) for f, unbroken in between(stored, poses, 9)][1:] == [
        (8_000_000_000 * slower, False),
        (8_600_000_000 * slower, True),
    ]


def test_frames_move_with_the_key_frames_that_there_are_now():
    poses, stored = scanned([(0.0, 0.0), (1.0, 6.0)], [(0.2, 1.0), (0.7, 4.0), (1.5, 9.0)])
    far = StoredFrame(300_000_000, CAMERA, 77, np.eye(4), None)  # of another submap
    dense = sorted([*poses, KeyPose(600_000_000, turned(3.5), 0.0)], key=lambda k: k.stamp_ns)
    reassign([*stored, far], dense)
    assert [f.keyframe_ns for f in stored] == [0, 600_000_000, 1_000_000_000]
    assert far.keyframe_ns == 77
    for frame, degrees in zip(stored, (1.0, 4.0, 9.0), strict=True):
        np.testing.assert_allclose(
            frame.pose({k.stamp_ns: k.T_target_sensor for k in dense}), turned(degrees), atol=1e-12
        )


def test_a_target_is_followed_where_no_second_passes_without_a_frame():
    tenths = [*range(8), *range(20, 30)]  # between 0.7 and 2.0 s it is out of sight
    frames = [StoredFrame(k * 10**8, CAMERA, None, np.eye(4), None) for k in tenths]
    assert followed(frames, [0, 5 * 10**8, 21 * 10**8, 25 * 10**8]) == [True, True, False, True]
    slow = [StoredFrame(k * 10**9, CAMERA, None, np.eye(4), None) for k in range(9)]
    assert all(followed(slow, [0, 3 * 10**9, 8 * 10**9]))
