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

"""Noise measured between registered views is the noise that was put in, however it is correlated."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from synthetic import CAMERA, sphere_depth, target_frame

from debris_scanner.sensing.sensor_model import measure_sensor
from debris_scanner.sensing.views import View

SIGMA = 0.0012


def noisy(seed, blur=0.0):
    depth = sphere_depth()
    noise = np.random.default_rng(seed).standard_normal(depth.shape)
    if blur:
        noise = gaussian_filter(noise, blur)
        noise /= noise.std()
    return View(target_frame(np.where(depth > 0, depth + SIGMA * noise, 0).astype(np.float32)))


def measured(blur=0.0):
    return measure_sensor([(noisy(2 * k, blur), np.eye(4), noisy(2 * k + 1, blur)) for k in range(6)])


@pytest.mark.parametrize('blur', [0.0, 2.0])
def test_the_noise_is_the_one_put_in(blur):
    model = measured(blur)
    assert model.sigma_m == pytest.approx(SIGMA, rel=0.1)
    assert model.pairs == 6
    depth = sphere_depth()
    assert model.range_m == pytest.approx(float(np.median(depth[depth > 0])), rel=0.01)
    assert model.footprint_m == pytest.approx(model.range_m / CAMERA.focal, rel=0.01)


def test_the_length_of_its_correlation_too():
    assert measured().correlation_px < 1
    # a Gaussian blur of sigma s correlates as exp(-lag² / 4 s²): 1/e at 2 s
    assert measured(2.0).correlation_px == pytest.approx(4.0, rel=0.15)


def test_views_without_common_surface_tell_nothing():
    apart = np.eye(4)
    apart[0, 3] = 5.0
    assert measure_sensor([(noisy(0), apart, noisy(1))]) is None
    assert measure_sensor([]) is None
