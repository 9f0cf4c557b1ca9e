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

"""Views in bounded memory: what is put away comes back as it was."""

import dataclasses

import numpy as np
import pytest
from synthetic import sphere_depth, target_frame

from debris_scanner.mapping.keyframes import KeptViews, PackedFrame
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View

SETTINGS = NormalSettings()


def millimetres(stamp_ns, rgb=None):
    depth = np.rint(sphere_depth() * 1000).astype(np.float32) * np.float32(0.001)
    return dataclasses.replace(target_frame(depth, stamp_ns), rgb=rgb)


@pytest.fixture
def views():
    kept = KeptViews(3, SETTINGS)
    for k in range(8):
        kept.append(View(millimetres(k)))
    return kept


def test_views_come_back_to_the_bit(views):
    assert len(views) == 8
    for k in (0, 5, 7, -8, 0):
        expected = View(millimetres(k % 8))
        assert views[k].frame.stamp_ns == k % 8
        for name in ('points', 'normals', 'anchors', 'mask_distance', 'mask_gradient', 'normal_map'):
            np.testing.assert_array_equal(getattr(views[k], name), getattr(expected, name))
    assert [v.frame.stamp_ns for v in views[2:5]] == [2, 3, 4]
    with pytest.raises(IndexError):
        views[8]


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


def test_all_are_put_away_again_after_a_failure(views):
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
    kept = KeptViews(1, SETTINGS)
    for k in range(3):
        view = View(millimetres(k))
        view.whole = k != 1
        kept.append(view)
    assert [v.whole for v in kept] == [True, False, True]
    kept.judge(0, whole=False)
    kept.judge(1, whole=True)
    assert [v.whole for v in kept] == [kept.is_whole(k) for k in range(3)] == [False, True, True]
