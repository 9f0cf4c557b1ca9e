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

""""""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from debris_scanner.core.voxel_grid import group, voxel_grid, voxel_grid_with_normals

LEAF = 0.002

CLOUDS = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 60), st.just(3)), elements=st.floats(-0.0625, 0.0625, width=32)
)


@pytest.fixture(scope='module')
def cases(golden):
    with np.load(golden / 'cases.npz') as archive:
        return dict(archive)


@pytest.mark.parametrize('case', range(12))
def test_equals_pcl_in_the_same_order(cases, case):
    ours = voxel_grid(cases[f'c{case:02d}_raw'], LEAF)
    reference = cases[f'c{case:02d}_voxel']
    assert ours.shape == reference.shape
    np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-6)


def test_merged_model_equals_pcl(golden):
    with np.load(golden / 'refine.npz') as archive:
        reference = archive['merged_voxel']
    # Already one point a leaf, so the grid must leave it as it is, in the order it has.
    np.testing.assert_allclose(voxel_grid(reference, 0.003), reference, rtol=0, atol=1e-6)


def test_order_is_x_fastest():
    corners = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 0]], np.float32) + 0.5
    np.testing.assert_array_equal(
        voxel_grid(corners, 1.0) - 0.5, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    )


@settings(derandomize=True, max_examples=80)
@given(CLOUDS, st.sampled_from([0.002, 0.01, 0.2]))
def test_each_leaf_holds_the_mean_of_its_points(cloud, leaf):
    cells = np.floor(cloud * (np.float32(1) / np.float32(leaf))).astype(int)
    expected = {}
    for key in map(tuple, cells):
        expected[key] = cloud[(cells == key).all(axis=1)].astype(float).mean(axis=0)
    keys = sorted(expected, key=lambda c: c[::-1])  # z slowest
    ours = voxel_grid(cloud, leaf)
    np.testing.assert_allclose(ours, [expected[k] for k in keys], atol=1e-8)
    assert group(cloud, leaf).counts.sum() == len(cloud)


@settings(derandomize=True, max_examples=40)
@given(CLOUDS, st.randoms(use_true_random=False))
def test_order_of_the_input_does_not_matter(cloud, random):
    shuffled = list(cloud)
    random.shuffle(shuffled)
    np.testing.assert_allclose(voxel_grid(np.array(shuffled), 0.01), voxel_grid(cloud, 0.01), atol=1e-8)


def test_invalid_points_are_left_out():
    cloud = np.array([[0.1, 0.1, 0.1], [np.nan, 0, 0], [0, np.inf, 0], [0.3, 0.1, 0.1]], np.float32)
    np.testing.assert_allclose(voxel_grid(cloud, 1.0), [[0.2, 0.1, 0.1]], atol=1e-7)


@pytest.mark.parametrize('cloud', [np.zeros((0, 3), np.float32), np.full((4, 3), np.nan, np.float32)])
def test_nothing_in_nothing_out(cloud):
    assert voxel_grid(cloud, LEAF).shape == (0, 3)
    points, normals = voxel_grid_with_normals(cloud, cloud, LEAF)
    assert points.shape == normals.shape == (0, 3)


def test_normals_are_averaged_to_unit_length():
    cloud = np.array([[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [5.1, 0, 0], [5.2, 0, 0]], np.float32)
    normals = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1]], np.float32)
    points, mean = voxel_grid_with_normals(cloud, normals, 1.0)
    np.testing.assert_allclose(points, voxel_grid(cloud, 1.0))
    np.testing.assert_allclose(mean, [[0.5**0.5, 0.5**0.5, 0], [0, 0, 0]], atol=1e-7)


@pytest.mark.parametrize('leaf', [0.0, -1.0, float('nan')])
def test_refuses_a_leaf_without_size(leaf):
    with pytest.raises(ValueError, match='must be positive'):
        voxel_grid(np.ones((3, 3), np.float32), leaf)


def test_refuses_more_leaves_than_can_be_numbered():
    with pytest.raises(ValueError, match='too small'):
        voxel_grid(np.array([[0, 0, 0], [1, 1, 1]], np.float32), 1e-7)
