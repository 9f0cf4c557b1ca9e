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

"""An offset of the depth: what it is at a pixel, on another lattice, and a frame without it."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings, fit_normals

CAMERA = Camera(100.0, 110.0, 30.0, 20.0, 64, 48)
WAVY = DepthOffset(0.1, (-3, -2), 2e-3 * np.random.default_rng(0).normal(size=(9, 8)))


def test_equal_coefficients_are_an_equal_share():
    even = DepthOffset(0.1, (-3, -2), np.full((9, 8), 0.004))
    np.testing.assert_allclose(even.share(CAMERA), np.full((48, 64), 0.004))


def test_the_share_is_that_of_the_ray():
    """A window of another camera sees the same."""
    finer = Camera(200.0, 220.0, 10.0, 0.0, 100, 90)
    u, v = np.meshgrid(np.arange(20, 76, 2), np.arange(0, 54, 2))
    x, y = (u - 10) / 200, v / 220
    same = WAVY.share(CAMERA)[np.rint(20 + 110 * y).astype(int), np.rint(30 + 100 * x).astype(int)]
    np.testing.assert_allclose(WAVY.share(finer)[v, u], same, atol=1e-12)


def test_it_is_smooth_and_stays_as_it_is_beyond_the_lattice():
    wide = Camera(1000.0, 1000.0, 1000.0, 20.0, 2001, 1)
    row = WAVY.share(wide)[0]
    assert np.abs(np.diff(row[700:1300], 2)).max() < 2e-6
    assert np.ptp(row[:690]) == 0 < np.ptp(row)
    assert np.ptp(row[1310:]) == 0


@pytest.mark.parametrize('low, high', [((-0.1, 0.0), (0.1, 0.1)), ((-0.75, -0.2), (0.31, 0.9))])
def test_a_larger_lattice_says_the_same(low, high):
    larger = WAVY.covering(np.array(low), np.array(high))
    inside = Camera(100.0, 100.0, 25.0, 15.0, 50, 40)
    np.testing.assert_allclose(larger.share(inside), WAVY.share(inside), atol=1e-15)
    again = larger.covering(np.array(low), np.array(high))
    assert again.first == larger.first
    assert again.coefficients.shape == larger.coefficients.shape
    assert (np.array(larger.first) * 0.1 <= np.array(low) + 1e-9).all()


def test_a_coarser_lattice_says_nearly_the_same():
    smooth = DepthOffset(
        0.01, (-40, -40), np.fromfunction(lambda i, j: 1e-3 * np.sin(i / 20 + j / 30), (80, 80))
    )
    lattice = DepthOffset.none_over(np.array([-0.35, -0.25]), np.array([0.35, 0.3]), 0.05)
    coarser = smooth.resampled(lattice)
    assert coarser.coefficients.size < smooth.coefficients.size / 10
    np.testing.assert_allclose(coarser.share(CAMERA), smooth.share(CAMERA), atol=1e-5)
    assert NO_OFFSET.resampled(lattice) is lattice


def test_size_and_length_of_a_wave():
    k = np.arange(1, 190)  # three waves
    wave = DepthOffset(0.01, (0, 0), 1e-3 * np.sin(k / 10)[:, None] * np.sin(k / 10))
    assert wave.rms == pytest.approx(0.5e-3, rel=0.01)
    assert wave.length == pytest.approx(np.sqrt(2) * 10 * 0.01, rel=0.02)
    assert NO_OFFSET.is_none
    assert (NO_OFFSET.rms, NO_OFFSET.length) == (0, 0)


def bent_plane():
    """A plane, facing the sensor, as a sensor with the offset shows it."""
    depth = (0.8 / (1 - WAVY.share(CAMERA))).astype(np.float32)
    return TargetFrame(7, CAMERA, depth, *fit_normals(depth, CAMERA, NormalSettings()))


def test_a_freed_frame_is_flat_again_and_keeps_what_was_measured():
    frame = bent_plane()
    freed = WAVY.freed(frame, NormalSettings())
    np.testing.assert_allclose(freed.depth, 0.8, atol=1e-6)
    inner = freed.normals[8:-8, 8:-8]
    np.testing.assert_allclose(inner, np.broadcast_to((0, 0, -1), inner.shape), atol=1e-3)
    assert np.abs(frame.normals[8:-8, 8:-8] - inner).max() > 0.01
    np.testing.assert_array_equal(freed.measured, frame.depth)
    # it is not taken off twice, and another replaces it
    np.testing.assert_array_equal(WAVY.freed(freed, NormalSettings()).depth, freed.depth)
    np.testing.assert_array_equal(NO_OFFSET.freed(freed, NormalSettings()).depth, frame.depth)


def test_without_an_offset_nothing_is_done():
    frame = bent_plane()
    assert NO_OFFSET.freed(frame, NormalSettings()) is frame
