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

"""Lu-Milios relaxation against PCL, and what it refuses."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import apply, exp_so3, inverse, rotation_angle, transform
from debris_scanner.research.thesis import lum
from debris_scanner.research.thesis.frame_registration import prealign
from debris_scanner.research.thesis.lum import linearised, pose_matrix, spring

FIXED = {1: (2e-7, 1e-5), 2: (1e-8, 1e-6), 5: (1e-8, 1e-6), 40: (1e-8, 1e-6)}  # m and rad off PCL's floats


@pytest.fixture(scope='module')
def network(golden):
    z = np.load(golden / 'lum_elch.npz')
    points, offset = z['lum_points'], z['lum_offset']
    clouds = [points[offset[k] : offset[k + 1]] for k in range(46)]
    return z, clouds, [(int(a), int(b)) for a, b in z['lum_edges']]


@pytest.fixture(scope='module')
def springs(network):
    z, clouds, links = network
    pairs = np.split(z['lum_corr'], z['lum_corr_offset'][1:-1])
    return [
        spring(s, t, clouds[s][c[:, 0]], clouds[t][c[:, 1]]) for (s, t), c in zip(links, pairs, strict=True)
    ]


def test_pairs_are_those_of_pcl(network, springs):
    _, clouds, links = network
    trees = [cKDTree(c) for c in clouds]
    mine = lum.find_springs(clouds, trees, links, np.zeros((46, 6)), 0.01)
    for a, b in zip(mine, springs, strict=True):
        assert a.pairs == b.pairs
        assert np.allclose(a.moments, b.moments, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(('row', 'iterations'), [(0, 1), (1, 2), (2, 5), (3, 40)])
def test_fixed_pairs_give_pcls_poses(network, springs, row, iterations):
    poses = lum.relax_fixed(springs, np.zeros((46, 6)), iterations, 0.0)
    off = np.abs(poses - network[0]['lum_fixed_poses'][row])
    metres, radians = FIXED[iterations]
    assert off[:, :3].max() < metres
    assert off[:, 3:].max() < radians
    assert not poses[0].any()


@pytest.mark.parametrize(('row', 'outer'), [(0, 1), (2, 5), (4, 40)])
def test_nested_loop_gives_pcls_poses(network, row, outer):
    z, clouds, links = network
    result = lum.relax(clouds, links, 0.01, outer, 40, 1e-9)
    off = np.abs(result.poses - z['lum_nested_poses'][row])
    assert off[:, :3].max() < 1e-8
    assert off[:, 3:].max() < 1e-7
    assert result.residuals[-1] <= result.residuals[0]
    assert len(result.residuals) <= outer


def test_relaxation_takes_out_most_of_the_drift(network):
    z, clouds, links = network
    drift = z['lum_drift_gt'].astype(float)
    result = lum.relax(clouds, links, 0.01, 40, 40)
    before = rotation_angle(drift[0, :3, :3].T @ drift[-1, :3, :3])
    left = [pose_matrix(p) @ T for p, T in zip(result.poses, drift, strict=True)]
    after = rotation_angle(left[0][:3, :3].T @ left[-1][:3, :3])
    assert after < 0.25 * before


def test_moments_say_what_the_points_say():
    rng = np.random.default_rng(3)
    s, t = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    A, B = (transform(exp_so3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
    M, z, square = linearised(spring(0, 1, s, t), A, B)
    mean, d = (apply(A, s) + apply(B, t)) / 2, apply(A, s) - apply(B, t)
    x, y, w = mean.T
    o, i = np.zeros(40), np.ones(40)
    J = np.stack([
        np.stack([i, o, o, o, -y, w], 1), np.stack([o, i, o, -w, x, o], 1), np.stack([o, o, i, y, o, -x], 1)
    ], 1)  # fmt: skip
    assert np.allclose(M, np.einsum('kri,krj->ij', J, J))
    assert np.allclose(z, np.einsum('kri,kr->i', J, d))
    assert square == pytest.approx((d**2).sum())


def test_pose_order_is_roll_pitch_yaw():
    R = pose_matrix(np.array([1, 2, 3, 0.1, 0.2, 0.3]))[:3, :3]
    about = [exp_so3(v) for v in np.diag([0.1, 0.2, 0.3])]
    assert np.allclose(R, about[2] @ about[1] @ about[0])


def test_a_noise_free_ring_moves_into_place():
    """PCL drops such edges and moves nothing."""
    rng = np.random.default_rng(7)
    body = rng.uniform(-0.1, 0.1, (60, 3))
    drift = [np.zeros(6)] + [0.01 * rng.normal(size=6) for _ in range(5)]
    clouds = [apply(inverse(pose_matrix(p)), body) for p in drift]
    links = [(k, (k + 1) % 6) for k in range(6)]
    ring = [spring(a, b, clouds[a], clouds[b]) for a, b in links]
    poses = lum.relax_fixed(ring, np.zeros((6, 6)), 60, 1e-12)
    for p, q in zip(poses, drift, strict=True):
        assert np.allclose(pose_matrix(p), pose_matrix(q), atol=1e-8)


def test_error_is_shared_evenly_by_equal_springs():
    rng = np.random.default_rng(1)
    body = rng.uniform(-0.1, 0.1, (200, 3))
    n, loop = 8, np.array([0.0, 0.008, 0.0])
    ring = [spring(k, k + 1, body + 1e-4 * rng.normal(size=body.shape), body) for k in range(n - 1)]
    ring.append(spring(n - 1, 0, body + 1e-4 * rng.normal(size=body.shape), body + loop))
    poses = lum.relax_fixed(ring, np.zeros((n, 6)), 60, 1e-12)
    # the closure's spring weighs as much as the others once its residual is theirs
    assert np.allclose(poses[:, 1], np.arange(n) * 0.008 / n, atol=2e-4)


def test_a_network_that_falls_apart_is_refused():
    rng = np.random.default_rng(2)
    clouds = [rng.uniform(-0.1, 0.1, (50, 3)) + [k > 1, 0, 0] for k in range(4)]
    with pytest.raises(lum.RelaxationError, match='2 parts'):
        lum.relax(clouds, [(0, 1), (1, 2), (2, 3)], 0.1)


def test_points_on_one_spot_fix_no_pose():
    spot = np.zeros((10, 3))
    with pytest.raises(lum.RelaxationError, match='fix no pose'):
        lum.relax_fixed([spring(0, 1, spot, spot)], np.zeros((2, 6)))


def test_prealignment_is_blind_to_the_observers_translation():
    rng = np.random.default_rng(5)
    body = rng.uniform(-0.1, 0.1, (500, 3))
    R = exp_so3(np.array([0.3, -1.0, 0.2]))
    near = apply(transform(R, np.array([0, 0, 0.7])), body)
    far = apply(transform(R, np.array([0.2, -0.1, 1.1])), body)
    (a, T), (b, _) = prealign(near, R), prealign(far, R)
    assert np.allclose(a, b, atol=1e-12)
    assert np.allclose(a, body - body.mean(axis=0), atol=1e-12)
    assert np.allclose(apply(T, near), a)
