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

"""Views in bounded memory: what is put away comes back as it was.

The set of key frames: who looks from where, and moving them together.
"""

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from synthetic import sphere_depth, target_frame

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import compose, exp_se3, exp_so3, inverse, transform
from debris_scanner.mapping.keyframes import KeyFrameSet, PackedFrame, ViewCache
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View

SETTINGS = NormalSettings()


def millimetres(stamp_ns, rgb=None):
    depth = np.rint(sphere_depth() * 1000).astype(np.float32) * np.float32(0.001)
    return dataclasses.replace(target_frame(depth, stamp_ns), rgb=rgb)


@pytest.fixture
def views():
    kept = ViewCache(3, SETTINGS)
    for k in range(8):
        kept.append(View(millimetres(k)))
    return kept


def test_views_come_back_to_the_bit(views):
    assert len(views) == 8
    for k in (0, 5, 7, -8, 0):
        expected = View(millimetres(k % 8))
        assert views[k].frame.stamp_ns == k % 8
        for name in ('points', 'normals', 'anchors', 'beside', 'normal_map'):
            np.testing.assert_array_equal(getattr(views[k], name), getattr(expected, name))
    assert [v.frame.stamp_ns for v in views[2:5]] == [2, 3, 4]
    with pytest.raises(IndexError):
        views[8]


def test_views_are_free_from_the_offset_and_frames_are_kept_as_measured(views):
    raw = [np.array(v.frame.depth) for v in views]
    views.offset = DepthOffset(0.05, (-20, -20), np.full((44, 44), 0.01))
    for k in (0, 7):
        np.testing.assert_allclose(views[k].frame.depth, 0.99 * raw[k], rtol=1e-6)
        np.testing.assert_array_equal(views[k].frame.measured, raw[k])
        np.testing.assert_allclose(views.frame(k).depth, 0.99 * raw[k], rtol=1e-6)
    views.append(views.prepare(millimetres(8)))
    views.rest()
    views.offset = NO_OFFSET
    for k, depth in enumerate([*raw, millimetres(8).depth]):
        np.testing.assert_array_equal(views[k].frame.depth, depth)
        assert views[k].frame.raw is None


def test_at_rest_no_view_is_prepared_and_all_come_back(views):
    first = views[0]
    views.rest()
    assert views[0] is not first
    np.testing.assert_array_equal(views[0].points, first.points)
    assert views.capacity == 3


def test_what_was_used_last_stays_prepared(views):
    first = views[0]
    assert views[0] is first
    _ = views[1], views[0], views[2]
    assert views[0] is first
    _ = views[3], views[4], views[5]
    assert views[0] is not first


def test_the_centroids_need_no_view(views):
    np.testing.assert_array_equal(views.centroids, [v.centroid for v in views])


def test_a_packed_frame_is_small_and_keeps_its_colours():
    depth = millimetres(3).depth
    rgb = np.random.default_rng(0).integers(0, 255, (*depth.shape, 3), dtype=np.uint8)
    frame = millimetres(3, rgb)
    packed = PackedFrame(frame)
    restored = packed.restore(SETTINGS)
    np.testing.assert_array_equal(restored.depth, frame.depth)
    np.testing.assert_array_equal(restored.rgb, rgb)
    assert restored.stamp_ns == packed.stamp_ns == 3
    assert PackedFrame(millimetres(3)).nbytes < depth.size / 2


def test_a_frame_can_be_had_without_its_view(views):
    latest = views[7]
    assert views.frame(7) is latest.frame
    np.testing.assert_array_equal(views.frame(0).normals, View(millimetres(0)).normal_map)
    assert views[5] is views[5]  # nothing was put away for it
    assert views[7] is latest


def test_all_are_prepared_but_once_where_they_are_needed_together(views):
    with views.all_prepared():
        first = [views[k] for k in range(8)]
        assert all(a is b for a, b in zip(first, views, strict=True))
    assert [views[k] is first[k] for k in (7, 6, 5)] == [True] * 3
    assert views[4] is not first[4]


def test_all_are_packed_again_after_a_failure(views):
    first = None

    def failing():
        nonlocal first
        with views.all_prepared():
            first, *_ = views
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        failing()
    assert views[0] is not first


def test_a_partly_hidden_view_comes_back_as_one():
    kept = ViewCache(1, SETTINGS)
    for k in range(3):
        view = View(millimetres(k))
        view.unoccluded = k != 1
        kept.append(view)
    assert [v.unoccluded for v in kept] == [True, False, True]
    kept.set_unoccluded(0, unoccluded=False)
    kept.set_unoccluded(1, unoccluded=True)
    assert [v.unoccluded for v in kept] == [kept.is_unoccluded(k) for k in range(3)] == [False, True, True]


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
        assert chosen.has_colour == (k >= 1)
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
    assert not keyframes.part([stamps[5]])  # it was never joined
    assert keyframes.active == list(range(7))
    assert keyframes.part([stamps[1]])
    assert keyframes.active == [3, 4, 5, 6] and [f.submap for f in keyframes.frames[:3]] == [0, 0, 0]


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


def test_further_key_frames_go_between_those_so_far(recording):
    """Two more among three: in order of time, with the views, marks and colours of both."""
    rgb = np.zeros((*recording.targets[20].depth.shape, 3), np.uint8)
    chosen = KeyFrameSet(NormalSettings(), prepared=1)
    for k in (0, 10, 20):
        frame = dataclasses.replace(recording.targets[k], rgb=rgb if k == 20 else None)
        chosen.add(KeyFrame(frame, recording.pose(k), 0.1 * k))
    chosen.views.set_unoccluded(1, unoccluded=False)
    chosen.frames[1].usable_for_mapping = False
    more = [KeyFrame(recording.targets[k], recording.pose(k), 0.0) for k in (5, 15)]
    dense = chosen.interleaved(more, [True, False])
    order = (0, 5, 10, 15, 20)
    assert dense.index == {recording.frames[k].stamp_ns: n for n, k in enumerate(order)}
    assert [f.added for f in dense.frames] == [False, True, False, True, False]
    assert [f.linked for f in dense.frames] == [False, True, True, False, True]
    assert [dense.views.is_unoccluded(n) for n in range(5)] == [True, True, False, True, True]
    assert dense.active == [0, 1, 2, 3, 4]
    assert [k.stamp_ns for k in dense.coloured()] == [recording.frames[20].stamp_ns]
    for n, k in enumerate(order):
        np.testing.assert_array_equal(dense.views[n].points, recording.views[k].points)
        np.testing.assert_allclose(dense.views.centroids[n], recording.views[k].centroid)
    for n in (1, 2, 4):  # each leads on from the one before it now
        step = compose(inverse(recording.pose(order[n - 1])), recording.pose(order[n]))
        np.testing.assert_allclose(dense.frames[n].T_previous, step, atol=1e-12)
    # those so far are as they were
    dense.frames[0].usable_for_mapping = False
    assert chosen.frames[0].usable_for_mapping and len(chosen) == 3
