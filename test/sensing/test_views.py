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

"""Depth with ridges: the measured one where the surface bends, the fitted one elsewhere."""

import numpy as np
from synthetic import target_frame

from debris_scanner.sensing.views import depth_with_ridges


def roof():
    """Two planes that meet in the middle column, tilted by 45 degrees each way."""
    u = np.abs(np.arange(60) - 30) * np.float32(0.0015)
    return target_frame((0.8 + np.broadcast_to(u, (50, 60))).astype(np.float32))


def test_only_the_ridge_is_measured():
    frame = roof()
    measured = frame.depth + np.float32(0.001)
    mixed = depth_with_ridges(measured, frame.depth_fit, frame.normals, 3, 0.96)
    ridge = mixed == measured
    assert ridge[25, 28:33].all()
    assert not ridge[25, :24].any() and not ridge[25, 37:].any()
    np.testing.assert_array_equal(mixed[~ridge], frame.depth_fit[~ridge])


def test_it_is_what_numpy_says():
    frame = roof()
    n = frame.normals + np.random.default_rng(0).normal(0, 0.1, frame.normals.shape).astype(np.float32)
    ridge = np.zeros(frame.depth.shape, bool)
    ridge[3:-3] |= (n[6:] * n[:-6]).sum(axis=-1) < 0.96
    ridge[:, 3:-3] |= (n[:, 6:] * n[:, :-6]).sum(axis=-1) < 0.96
    expected = np.where(ridge & (frame.depth_fit > 0), frame.depth, frame.depth_fit)
    np.testing.assert_array_equal(depth_with_ridges(frame.depth, frame.depth_fit, n, 3, 0.96), expected)
