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

import numpy as np
import pytest

from debris_scanner.core.geometry import apply, exp_se3
from debris_scanner.core.parameters import ParameterError, updated
from debris_scanner.mapping.descriptors import BINS, SIZE, DescriptorSettings, counts, efpfh, pair_features

# Row of the golden vfh array: binning, size component, normalised distance.
ROWS = {
    0: ('pcl_1_13', False, False),
    1: ('pcl_1_13', True, False),
    2: ('pcl_1_13', True, True),
    3: ('pcl_1_13', True, False),
    5: ('pcl_1_7_1', False, False),
    6: ('pcl_1_7_1', True, False),
    7: ('pcl_1_7_1', True, True),
}


@pytest.fixture(scope='module')
def cases(golden):
    with np.load(golden / 'cases.npz') as archive:
        return dict(archive)


@pytest.fixture
def cloud():
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    axes = np.array([0.1, 0.2, 0.15])
    normals = direction / axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = direction * axes + [0.0, 0.0, 0.7]
    seen = normals[:, 2] < -0.1
    return points[seen], normals[seen]


def moved_points(ours, theirs):
    return np.abs(ours - theirs).sum() / 2


@pytest.mark.parametrize('row', ROWS)
@pytest.mark.parametrize('case', range(12))
def test_histogram_equals_pcl(cases, case, row):
    points, normals = cases[f'c{case:02d}_voxel'], cases[f'c{case:02d}_nk20'][:, :3]
    reference = cases[f'c{case:02d}_vfh'][row, :SIZE].astype(float)
    if row != 3:  # all others are per cent of the points
        reference *= (len(points) - 1) / 100
    ours = counts(points, normals, DescriptorSettings(*ROWS[row]))
    assert moved_points(ours, reference) <= 0.005 * len(points)


@pytest.mark.parametrize('case', [0, 2, 8, 10])
def test_histogram_of_radius_normals_equals_pcl(cases, case):
    points, normals = cases[f'c{case:02d}_voxel'], cases[f'c{case:02d}_nr10mm'][:, :3]
    reference = cases[f'c{case:02d}_vfh'][4, :SIZE].astype(float) * (len(points) - 1) / 100
    ours = counts(points, normals, DescriptorSettings('pcl_1_13', True, False))
    # PCL counts a point without a normal into an end bin of each feature; here it is left out.
    without_normal = np.isnan(normals).any(axis=1).sum()
    assert moved_points(ours, reference) <= 0.005 * len(points) + 4 * without_normal


@pytest.mark.parametrize('case', [0, 8])
def test_pair_features_equal_pcl(cases, case):
    points, normals = cases[f'c{case:02d}_voxel'], cases[f'c{case:02d}_nk20'][:, :3]
    centroid, mean_normal = cases[f'c{case:02d}_centroid'].astype(float)
    ours = pair_features(points, normals, centroid, mean_normal)
    reference = cases[f'c{case:02d}_pairf']
    f1_difference = (ours.f1 - reference[:, 0] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(f1_difference).max() < 1e-5
    for k, f in ((1, ours.f2), (2, ours.f3), (3, ours.f4)):
        np.testing.assert_allclose(f, reference[:, k], atol=1e-5)


def test_every_feature_counts_every_point(cloud):
    histogram = counts(*cloud)
    np.testing.assert_array_equal(histogram.reshape(4, BINS).sum(axis=1), len(cloud[0]))


def test_sums_to_one(cloud):
    assert efpfh(*cloud).sum() == pytest.approx(1.0, abs=1e-12)


def test_distance_bins_stay_empty_without_size_component(cloud):
    assert not counts(*cloud, DescriptorSettings(size_component=False))[3 * BINS :].any()


def test_does_not_depend_on_the_pose(cloud):
    points, normals = cloud
    T = exp_se3(np.array([0.4, -1.1, 2.0, 0.3, -0.2, 0.5]))
    turned = counts(apply(T, points), normals @ T[:3, :3].T)
    assert moved_points(counts(points, normals), turned) <= 2


def test_normalised_distance_ignores_scale_and_metres_do_not(cloud):
    points, normals = cloud
    assert moved_points(counts(points, normals), counts(2.0 * points, normals)) <= 2
    metres = DescriptorSettings(normalise_distance=False)
    assert moved_points(counts(points, normals, metres), counts(2.0 * points, normals, metres)) > 100


def test_cannot_tell_a_mirror_image_but_for_the_sign_of_f1(cloud):
    # Trowbridge 2014, eq. 2.91: reflection leaves f3 and f4, and negates what v and w enter.
    points, normals = cloud
    mirror = np.array([-1.0, 1.0, 1.0])
    own, mirrored = counts(points, normals), counts(points * mirror, normals * mirror)
    assert moved_points(own[2 * BINS :], mirrored[2 * BINS :]) <= 2


def test_points_without_normal_are_ignored(cloud):
    points, normals = cloud
    more = np.vstack([points, [[0.1, 0.1, 0.6], [np.nan, 0, 0], [0.1, 0.1, 0.6]]])
    more_normals = np.vstack([normals, [[0, 0, 0], [0, 0, -1], [np.nan, 0, 0]]])
    np.testing.assert_array_equal(counts(more, more_normals), counts(points, normals))


def test_nothing_to_describe_gives_zeros():
    assert not efpfh(np.zeros((0, 3)), np.zeros((0, 3))).any()
    assert not efpfh(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])).any()


def test_refuses_shapes_that_do_not_match(cloud):
    points, normals = cloud
    with pytest.raises(ValueError, match='must both be'):
        counts(points, normals[:-1])


def test_an_unknown_binning_is_a_parameter_error():
    with pytest.raises(ParameterError, match="'pcl_2' is none of pcl_1_7_1, pcl_1_13"):
        updated(DescriptorSettings(), {'binning': 'pcl_2'})
