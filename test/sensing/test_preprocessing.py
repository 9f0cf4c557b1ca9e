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

"""Depth frame in, target frame out."""

import numpy as np
import pytest
from synthetic import CAMERA, depth_frame, rays, sphere_depth

from debris_scanner.core.frames import DepthFrame, FrameRejected
from debris_scanner.core.timing import StageTimer
from debris_scanner.sensing.isolation import IsolationSettings
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.sensing.silhouette import MARGIN_PX


def make(timer=None):
    return Preprocessor(IsolationSettings(), NormalSettings(), timer)


def cloud(frame):
    """Points of the window, as its own camera sees them."""
    return (rays(frame.camera) * frame.depth[..., None])[frame.depth > 0]


def test_window_holds_the_same_points_as_the_image():
    depth = sphere_depth((0.03, -0.02, 0.6), 0.07)
    target = make().process(depth_frame(depth, 5))
    assert target.stamp_ns == 5
    expected = (rays() * depth[..., None])[depth > 0]
    np.testing.assert_allclose(cloud(target), expected, atol=1e-6)


def test_window_has_a_free_border_up_to_the_edge_of_the_image():
    depth = sphere_depth((0.17, 0.0, 0.6), 0.07)  # cut off by the image's right edge
    assert (depth[:, -1] > 0).any()
    preprocessor = make()
    preprocessor.process(depth_frame(sphere_depth((0.1, 0.0, 0.6), 0.07), 0))
    target = preprocessor.process(depth_frame(depth, 10**8))
    assert target.depth[:, -1].any()
    assert not target.depth[:MARGIN_PX].any() and target.depth[MARGIN_PX].any()
    assert not target.depth[:, :MARGIN_PX].any() and target.depth[:, MARGIN_PX].any()
    assert target.depth.shape == (target.camera.height, target.camera.width)


def test_colour_is_cut_with_the_depth():
    depth = sphere_depth((0.03, -0.02, 0.6), 0.07)
    rgb = np.arange(160 * 120 * 3, dtype=np.uint32).reshape(120, 160, 3).astype(np.uint8)
    target = make().process(DepthFrame(0, depth, CAMERA, rgb))
    np.testing.assert_array_equal(target.rgb[target.depth > 0], rgb[depth > 0])


def test_what_is_not_the_target_is_cut_out():
    depth = np.maximum(sphere_depth((-0.07, 0, 0.6), 0.06), sphere_depth((0.1, 0, 0.6), 0.04))
    preprocessor = make()
    for k in range(14):
        with pytest.raises(FrameRejected, match='settling'):
            preprocessor.process(depth_frame(depth, k * 90_000_000))
    target = preprocessor.process(depth_frame(depth, 10**10))
    assert (target.depth > 0).sum() == (sphere_depth((-0.07, 0, 0.6), 0.06) > 0).sum()


@pytest.mark.parametrize('second', [10, 9])
def test_time_must_go_forward(second):
    preprocessor = make()
    preprocessor.process(depth_frame(sphere_depth(), 10))
    with pytest.raises(FrameRejected) as rejected:
        preprocessor.process(depth_frame(sphere_depth(), second))
    assert rejected.value.reason == 'non_monotone_stamp'
    assert preprocessor.process(depth_frame(sphere_depth(), 11)).stamp_ns == 11
    preprocessor.reset()
    assert preprocessor.process(depth_frame(sphere_depth(), 3)).stamp_ns == 3


def test_a_frame_without_target_still_moves_time_on():
    preprocessor = make()
    with pytest.raises(FrameRejected, match='no_target'):
        preprocessor.process(depth_frame(np.zeros((120, 160), np.float32), 10))
    with pytest.raises(FrameRejected, match='non_monotone_stamp'):
        preprocessor.process(depth_frame(sphere_depth(), 10))


def test_stages_are_timed():
    timer = StageTimer()
    frame = make(timer).process(depth_frame(sphere_depth()))
    assert {name: row['count'] for name, row in timer.summary().items()} == {'isolate': 1}
    assert frame.normals.any() and frame.depth_fit.any()  # fitted once, when they are asked for
    assert {name: row['count'] for name, row in timer.summary().items()} == {'isolate': 1, 'normals': 1}
