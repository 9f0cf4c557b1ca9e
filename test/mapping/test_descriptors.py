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

"""Descriptors against PCL, their bits, and the similarity of two views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from debris_scanner.core.geometry import apply, exp_se3
from debris_scanner.core.parameters import ParameterError, updated
from debris_scanner.mapping.descriptors import (
    BINS,
    SIZE,
    DescriptorSettings,
    PerBinThreshold,
    SimilarityWindow,
    binarise,
    binary_similarity,
    counts,
    efpfh,
    float_similarity,
    hamming,
    mean_threshold,
    median_threshold,
    normalised_similarity,
    pair_features,
)

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


BITS = hnp.arrays(bool, SIZE)


def pack(bits):
    return binarise(np.asarray(bits, float), np.array(0.5))


def frames(count, seed=0):
    """Histograms with bins of very different sizes that vary a little from frame to frame."""
    rng = np.random.default_rng(seed)
    level = rng.exponential(size=SIZE)
    h = level * rng.uniform(0.5, 1.5, (count, SIZE))
    return (h / h.sum(axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize('k', [0, 1, 63, 64, 127, 128, 179])
def test_bin_k_is_bit_k_of_the_words(k):
    words = pack(np.arange(SIZE) == k)
    assert words.dtype == np.uint64
    assert [int(w) for w in words] == [1 << (k % 64) if k // 64 == w else 0 for w in range(3)]


@settings(derandomize=True, max_examples=60)
@given(BITS, BITS, BITS)
def test_hamming_is_a_metric_that_counts_differing_bits(u, v, w):
    distance = {(a, b): int(hamming(pack(x), pack(y))) for a, x in zip('uvw', (u, v, w), strict=True)
                for b, y in zip('uvw', (u, v, w), strict=True)}  # fmt: skip
    assert distance['u', 'v'] == (u != v).sum()
    assert distance['u', 'u'] == 0
    assert distance['u', 'v'] == distance['v', 'u']
    assert distance['u', 'w'] <= distance['u', 'v'] + distance['v', 'w']
    assert int(hamming(pack(u), pack(~u))) == SIZE


def test_difference_is_exclusive_or_and_not_the_printed_equation():
    # Eq. 2.69 as printed, u and not v, would find no difference when v only adds bits.
    u, v = np.zeros(SIZE, bool), np.ones(SIZE, bool)
    assert int(hamming(pack(u), pack(v))) == SIZE


def test_one_against_many():
    h = frames(20)
    words = binarise(h, median_threshold(h))
    distances = hamming(words[3], words)
    assert distances.shape == (20,)
    assert distances[3] == 0
    assert distances[7] == hamming(words[3], words[7])


def test_own_median_sets_half_of_the_bits():
    h = frames(5)
    set_bits = hamming(np.zeros(3, np.uint64), binarise(h, median_threshold(h)))
    np.testing.assert_array_equal(set_bits, SIZE // 2)


def test_own_mean_sets_fewer_bits_of_a_peaked_histogram():
    h = frames(5)
    set_bits = hamming(np.zeros(3, np.uint64), binarise(h, mean_threshold(h)))
    assert (set_bits < SIZE // 2).all()
    assert (set_bits > 0).all()


def test_empty_bins_stay_zero():
    h = np.zeros(SIZE)
    h[:10] = 0.1
    assert int(hamming(np.zeros(3, np.uint64), binarise(h, median_threshold(h)))) == 10


def test_threshold_is_the_median_of_each_bin_over_the_frames():
    h = frames(10)
    running = PerBinThreshold()
    for k, row in enumerate(h):
        assert running.add(row) == k
        # Up to the tenth frame the medians are refreshed by every one.
        np.testing.assert_array_equal(running.threshold, np.median(h[: k + 1], axis=0))
        np.testing.assert_array_equal(running.words, binarise(h[: k + 1], running.threshold))


def test_words_of_all_frames_share_the_threshold_in_force():
    h = frames(300)
    running = PerBinThreshold()
    refreshed = set()
    for row in h:
        running.add(row)
        refreshed.add(running.threshold.tobytes())
        np.testing.assert_array_equal(running.words[0], binarise(h[0], running.threshold))
    np.testing.assert_array_equal(running.histograms, h)
    np.testing.assert_array_equal(running.words, binarise(h, running.threshold))
    assert len(refreshed) < 60  # ever more rarely
    # Never based on fewer than nine tenths of the frames, so close to the exact median.
    shift = np.abs(running.threshold - np.median(h, axis=0)) / h.std(axis=0)
    assert shift.max() < 0.3


def test_separates_two_faces_better_than_the_thesis():
    # Two faces differ by a tenth in every bin: their own medians hardly move, the bins' medians do.
    rng = np.random.default_rng(1)
    level = rng.exponential(size=SIZE)
    face = np.where(rng.random(SIZE) < 0.5, 1.1, 1 / 1.1)
    a, b = level * face, level / face
    h = np.array([(a if k % 2 else b) * rng.normal(1, 0.01, SIZE) for k in range(40)])
    h /= h.sum(axis=1, keepdims=True)
    running = PerBinThreshold()
    for row in h:
        running.add(row)
    ours = running.hamming_to_earlier(39)
    thesis_words = binarise(h, median_threshold(h))
    thesis = hamming(thesis_words[39], thesis_words[:39])
    same = np.arange(39) % 2 == 1
    assert ours[~same].min() - ours[same].max() > 90
    assert thesis[~same].min() - thesis[same].max() < 30


def test_ten_thousand_frames_stay_cheap():
    h = frames(2000)
    running = PerBinThreshold()
    refreshes, last = 0, b''
    for row in np.tile(h, (5, 1)):
        running.add(row)
        if running.threshold.tobytes() != last:
            refreshes, last = refreshes + 1, running.threshold.tobytes()
    assert len(running) == 10_000
    assert refreshes < 100


HISTOGRAM = hnp.arrays(float, SIZE, elements=st.floats(0, 1, width=32)).filter(lambda h: h.sum() > 0)


@settings(derandomize=True, max_examples=60)
@given(HISTOGRAM, HISTOGRAM)
def test_float_similarity_is_bounded_symmetric_and_one_for_equals(u, v):
    u, v = u / u.sum(), v / v.sum()
    p = float_similarity(u, np.array([u, v]))
    assert p[0] == pytest.approx(1.0, abs=1e-12)
    assert 0.0 <= p[1] <= 1.0 + 1e-12
    assert p[1] == pytest.approx(float_similarity(v, u[None])[0], abs=1e-12)


def test_float_similarity_by_hand():
    u, v = np.zeros(SIZE), np.zeros(SIZE)
    u[:2] = 0.5
    v[1:3] = 0.5
    # Half of each is shared: 0.5 / (1 + 1 - 0.5).
    assert float_similarity(u, v[None])[0] == pytest.approx(1 / 3)
    assert float_similarity(u, np.roll(u, 90)[None])[0] == 0.0


def test_float_similarity_of_empty_histograms_is_zero():
    assert float_similarity(np.zeros(SIZE), np.zeros((2, SIZE))).tolist() == [0.0, 0.0]


def test_float_similarity_of_single_precision_rows():
    h = np.random.default_rng(0).random((50, SIZE)).astype(np.float32)
    h /= h.sum(axis=1, keepdims=True)
    single = float_similarity(h[0], h)
    np.testing.assert_allclose(single, float_similarity(h[0].astype(float), h.astype(float)), atol=1e-6)


def test_binary_similarity_values():
    np.testing.assert_allclose(binary_similarity(np.array([0, 60, 180])), [1.0, 0.5, 0.0])


def test_binary_similarity_falls_with_every_bit():
    p = binary_similarity(np.arange(SIZE + 1))
    assert (np.diff(p) < 0).all()


def test_six_sigma_window_spans_zero_to_one():
    p = np.array([0.9 - 0.15, 0.9, 0.9 + 0.15, 0.5, 1.2])
    np.testing.assert_allclose(normalised_similarity(p, 0.9, 0.05), [0.0, 0.5, 1.0, 0.0, 1.0], atol=1e-12)


def test_without_spread_nothing_is_told_apart():
    assert normalised_similarity(np.array([0.2, 0.9]), 0.9, 0.0).tolist() == [0.5, 0.5]


def test_window_equals_moments_of_all_batches():
    rng = np.random.default_rng(5)
    batches = [rng.normal(0.95, 0.001, n) for n in (0, 1, 7, 500, 2)]
    window = SimilarityWindow()
    assert window.sigma == 0.0
    for batch in batches:
        window.add(batch)
    everything = np.concatenate(batches)
    assert window.count == len(everything)
    assert window.mean == pytest.approx(everything.mean(), rel=1e-12)
    assert window.sigma == pytest.approx(everything.std(), rel=1e-9)
    np.testing.assert_allclose(
        window.normalise(everything), normalised_similarity(everything, everything.mean(), everything.std())
    )


def test_normalisation_keeps_the_ranking_within_the_window():
    p = binary_similarity(np.array([3, 30, 9, 12]))
    assert np.argsort(normalised_similarity(p, p.mean(), p.std())).tolist() == np.argsort(p).tolist()
