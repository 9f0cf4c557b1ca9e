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

"""All pairs of key frames by every measure, and their file."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.mapping.closure_matrices import (
    MEASURES,
    MOST_KEYFRAMES,
    ClosureMatrices,
    ClosureMatricesError,
    Descriptions,
)


def turning(n, seed=3):
    """Key frames a twelfth of a turn apart whose histograms repeat every turn, but for a little noise."""
    rng = np.random.default_rng(seed)
    faces = rng.random((12, 180)) ** 4
    histograms = faces[np.arange(n) % 12] * (1 + 0.01 * rng.random((n, 180)))
    attitudes = np.array([exp_so3(np.array([0.0, k * np.pi / 6, 0.0])) for k in range(n)])
    return Descriptions(np.arange(n, dtype=np.int64) * 10, histograms.astype(np.float32), attitudes)


@pytest.fixture(scope='module')
def matrices():
    return ClosureMatrices.of(turning(30))


def test_every_measure_is_a_symmetric_probability(matrices):
    assert list(matrices.by_measure) == list(MEASURES)
    for name, m in matrices.by_measure.items():
        assert m.shape == (30, 30), name
        assert m.dtype == np.float32
        np.testing.assert_array_equal(m, m.T)
        assert m.min() >= 0 and m.max() <= 1
        if name != 'normalised':
            np.testing.assert_allclose(np.diag(m), 1.0)


def test_same_face_stands_out_in_every_measure(matrices):
    apart = np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    same = apart[..., None] == [12, 24]
    for name, m in matrices.by_measure.items():
        assert m[same.any(axis=-1)].min() > m[(apart % 12 > 2) & (apart % 12 < 10)].max(), name


def test_joint_is_what_the_detector_ranks_by(matrices):
    m = matrices.by_measure
    np.testing.assert_allclose(m['joint'], np.sqrt(m['per_bin'] * m['attitude']), rtol=1e-6)
    assert m['attitude'][0, 6] == pytest.approx(0.0, abs=1e-6)  # half a turn
    assert m['attitude'][0, 3] == pytest.approx(0.5, abs=1e-6)


def test_normalised_is_the_binary_one_stretched_over_six_sigma(matrices):
    binary, normalised = (matrices.by_measure[k].astype(float) for k in ('binary', 'normalised'))
    pairs = binary[np.tril_indices(30, -1)]
    inside = (normalised > 0) & (normalised < 1)
    expected = (binary - pairs.mean()) / (6 * pairs.std()) + 0.5
    np.testing.assert_allclose(normalised[inside], expected[inside], atol=1e-6)


def test_of_a_long_scan_the_last_key_frames_remain():
    long = ClosureMatrices.of(turning(MOST_KEYFRAMES + 20))
    assert len(long.stamps_ns) == MOST_KEYFRAMES
    assert long.stamps_ns[0] == 200
    assert len(long.encode()) < 6 * 4 * MOST_KEYFRAMES**2


@pytest.mark.parametrize('n', [0, 1, 2])
def test_few_key_frames(n, tmp_path):
    (tmp_path / 'few.npz').write_bytes(ClosureMatrices.of(turning(n)).encode())
    few = ClosureMatrices.read(tmp_path / 'few.npz')
    assert {m.shape for m in few.by_measure.values()} == {(n, n)}
    assert all(np.isfinite(m).all() for m in few.by_measure.values())


def test_file_holds_the_same_and_is_the_same(matrices, tmp_path):
    (tmp_path / 'p.npz').write_bytes(matrices.encode())
    read = ClosureMatrices.read(tmp_path / 'p.npz')
    np.testing.assert_array_equal(read.stamps_ns, matrices.stamps_ns)
    for name in MEASURES:
        np.testing.assert_array_equal(read.by_measure[name], matrices.by_measure[name])
    assert ClosureMatrices.of(turning(30)).encode() == matrices.encode()


def test_broken_files_are_named(matrices, tmp_path):
    path = tmp_path / 'p.npz'
    with pytest.raises(ClosureMatricesError, match=r'p\.npz'):
        ClosureMatrices.read(path)
    for content in (b'', b'garbage', matrices.encode()[:2000]):
        path.write_bytes(content)
        with pytest.raises(ClosureMatricesError, match=r'p\.npz'):
            ClosureMatrices.read(path)
    np.savez(path, stamp_ns=np.arange(3))
    with pytest.raises(ClosureMatricesError, match='float'):
        ClosureMatrices.read(path)
    np.savez(path, stamp_ns=np.arange(3), **{name: np.zeros((2, 2)) for name in MEASURES})
    with pytest.raises(ClosureMatricesError, match='3 x 3'):
        ClosureMatrices.read(path)
