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

"""What a driver does to images: noise is smoothed, edges stay, what vanishes lingers."""

import numpy as np
import pytest

from debris_scanner.sim.image_filters import JUNK_M, TemporalFilter, spatially_filtered, with_junk

NEAR, FAR, SIGMA = 0.6, 0.7, 0.001


def step_edge(seed=0):
    """A noisy step from near to far, with a hole."""
    depth = np.full((60, 80), NEAR, np.float32)
    depth[:, 40:] = FAR
    depth += np.random.default_rng(seed).normal(0, SIGMA, depth.shape).astype(np.float32)
    depth[20:25, 10:15] = 0
    return depth


def test_the_spatial_filter_smooths_up_to_edges_and_fills_nothing():
    depth = step_edge()
    smooth = spatially_filtered(depth)
    np.testing.assert_array_equal(smooth == 0, depth == 0)
    for part, true in ((smooth[30:, :40], NEAR), (smooth[30:, 40:], FAR)):
        assert part.std() < 0.5 * SIGMA
        assert np.abs(part - true).max() < 3 * SIGMA


def test_the_temporal_filter_averages_what_stays_and_passes_what_jumps():
    state = TemporalFilter.begin((60, 80))
    for k in range(12):
        state = state.after(step_edge(k))
    assert 0.4 * SIGMA < state.depth[30:, :40].std() < 0.6 * SIGMA  # root of 0.4 / 1.6
    moved = state.after(np.full((60, 80), FAR, np.float32)).depth
    np.testing.assert_allclose(moved[:, :40], FAR, atol=1e-6)


def test_what_was_seen_twice_lingers_for_two_images():
    seen, nothing = np.full((2, 2), NEAR, np.float32), np.zeros((2, 2), np.float32)
    state = TemporalFilter.begin((2, 2)).after(seen)
    assert not state.after(nothing).depth.any()
    state, lingers = state.after(seen).after(seen), []
    for _ in range(4):
        state = state.after(nothing)
        lingers.append(bool(state.depth.any()))
    assert lingers == [True, True, True, False]


def test_junk_is_the_stated_share_far_away():
    depth = np.full((480, 640), NEAR, np.float32)
    images = [with_junk(depth, 0.003, np.random.default_rng(k)) for k in range(20)]
    far = np.array([image > 1 for image in images])
    assert far.mean() == pytest.approx(0.003, rel=0.2)
    assert all(JUNK_M[0] <= image[image > 1].min() <= image.max() <= JUNK_M[1] for image in images)
    assert (depth == np.float32(NEAR)).all()
