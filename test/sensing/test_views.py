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

"""Depth with ridges: measured where the surface bends, fitted elsewhere; and what a view resolves."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from synthetic import plane_depth, sphere_depth, target_frame

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import NO_FOOTPRINT
from debris_scanner.sensing.views import (
    USUAL_NOISE,
    View,
    depth_with_ridges,
    noise_about_planes,
    noise_correlation,
)


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


FINE = Camera(525.0, 525.0, 79.5, 59.5, 160, 120)


@pytest.mark.parametrize('scale', [0.25, 1.0, 8.0])
def test_a_view_resolves_a_pixel_where_it_is_not_noisy(scale):
    view = View(target_frame(sphere_depth((0, 0, 0.8 * scale), 0.1 * scale, FINE), camera=FINE))
    assert view.noise < 0.2 * view.footprint
    assert view.resolution == view.footprint == pytest.approx(0.72 * scale / 525, rel=0.03)


def test_depths_in_millimetres_resolve_no_less():
    depth = sphere_depth((0, 0, 0.2), 0.025, FINE)
    assert View(target_frame(depth, camera=FINE)).depth_step < 1e-4
    view = View(target_frame((np.rint(depth * 1000) / 1000).astype(np.float32), camera=FINE))
    assert view.resolution == pytest.approx(0.001, rel=0.01)


@pytest.mark.parametrize('sigma_px', [2.0, 3.0])
def test_noise_is_measured_and_makes_it_coarser(sigma_px):
    depth = plane_depth((0.2, 0.1, -1.0), 0.8, FINE)
    footprint = float(np.median(depth)) / 525
    noise = np.random.default_rng(0).normal(0, sigma_px * footprint, depth.shape)
    view = View(target_frame((depth + noise).astype(np.float32), camera=FINE))
    assert view.noise == pytest.approx(sigma_px * footprint, rel=0.25)
    assert view.resolution == pytest.approx(view.noise / USUAL_NOISE)


@pytest.mark.parametrize(('blur_px', 'low', 'high'), [(0.0, -0.1, 0.1), (0.7, 0.3, 0.7), (3.0, 0.5, 0.95)])
def test_correlation_of_the_noise_shows_in_one_view(blur_px, low, high):
    """As measured: simulated Kinect 0.0, a real PrimeSense 0.1, time of flight 0.5, stereo 0.6."""
    noise = gaussian_filter(np.random.default_rng(0).normal(size=(120, 160)), blur_px)
    depth = plane_depth((0.0, 0.0, -1.0), 0.8) + (0.002 * noise / noise.std()).astype(np.float32)
    view = View(target_frame(depth))
    found = noise_correlation(view.frame, 3, view.noise)
    assert low < found < high
    assert view.shared_noise == pytest.approx(min(1.0, max(0.0, 2 * found)))


def test_too_few_pixels_tell_nothing_of_noise():
    assert noise_about_planes(np.ones(20), np.ones(20)) == 0
    assert noise_about_planes(np.ones(100), np.full(100, 0.3)) == 0
    assert noise_about_planes(np.zeros(0), np.zeros(0)) == 0


def test_an_empty_view_has_a_resolution_that_divides():
    view = View(target_frame(np.zeros((40, 50), np.float32)))
    assert view.resolution == view.footprint == NO_FOOTPRINT
    assert len(view.points) == 0


def test_a_small_target_is_sampled_densely_and_weighs_no_more():
    """A sphere of a third the diameter has a ninth of the pixels, and as many samples."""
    near, far = (View(target_frame(sphere_depth((0, 0, z), 0.12))) for z in (0.6, 1.8))
    assert near.density == 1.0
    assert far.density > 1.0
    n_near, n_far = len(near.points), len(far.points)
    assert n_far > 0.5 * n_near
    area_ratio = (n_far / far.density) / n_near
    assert area_ratio == pytest.approx((0.6 / 1.8) ** 2, rel=0.15)  # weight goes by pixels
