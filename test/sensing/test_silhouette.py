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

from debris_scanner.sensing.silhouette import blurred, closed, distance_field, eroded

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
def test_distances_are_exact_and_point_to_the_nearest(seed):
    mask = blobs(seed)
    distance, away = distance_field(mask)
    expected = ndimage.distance_transform_edt(~mask)
    np.testing.assert_allclose(distance, expected, atol=1e-5)
    rows, columns = np.nonzero(~mask)
    step = distance[rows, columns, None] * away[rows, columns]
    nearest = np.rint(np.stack([rows - step[:, 1], columns - step[:, 0]])).astype(int)
    assert mask[tuple(nearest)].all()
    assert not away[mask].any()


def test_without_a_mask_all_is_far():
    distance, away = distance_field(np.zeros((4, 5), bool))
    assert np.isinf(distance).all()
    assert not away.any()


def test_a_mask_that_fills_the_image_is_near_everywhere():
    assert not distance_field(np.ones((4, 5), bool))[0].any()
