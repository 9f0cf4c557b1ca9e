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

"""The silhouette's compiled operations against scipy.ndimage's."""

import numpy as np
import pytest
from scipy import ndimage

from debris_scanner.sensing.silhouette import FAR, blurred, closed, eroded, steps_beside

SQUARE = np.ones((3, 3), bool)


def blobs(seed, shape=(60, 45)):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 3)
    return noise > 0.03


@pytest.mark.parametrize('seed', range(5))
def test_closing_and_erosion_are_scipys(seed):
    mask = blobs(seed)
    np.testing.assert_array_equal(closed(mask, 2), ndimage.binary_closing(mask, SQUARE, 2))
    np.testing.assert_array_equal(eroded(mask, 1), ndimage.binary_erosion(mask, SQUARE))


@pytest.mark.parametrize('shape', [(60, 45), (7, 4), (1, 9)])  # narrower than the Gaussian is wide, too
def test_blurring_is_scipys_to_the_bit(shape):
    mask = blobs(1, shape)
    mask[0, 0] = True
    np.testing.assert_array_equal(blurred(mask, 1.5), ndimage.gaussian_filter(mask.astype(np.float32), 1.5))


@pytest.mark.parametrize('seed', range(5))
def test_steps_lead_back_to_the_nearest_pixel(seed):
    mask = blobs(seed)
    steps = steps_beside(mask).astype(int)
    np.testing.assert_allclose(np.hypot(*steps.T).T, ndimage.distance_transform_edt(~mask), atol=1e-9)
    rows, columns = np.indices(mask.shape)
    assert mask[rows - steps[..., 1], columns - steps[..., 0]].all()


def test_without_a_mask_all_is_far():
    assert (steps_beside(np.zeros((4, 5), bool)) == FAR).all()


def test_a_mask_that_fills_the_image_is_near_everywhere():
    assert not steps_beside(np.ones((4, 5), bool)).any()
