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

"""Moving least squares against PCL."""

import numpy as np
import pytest

from debris_scanner.research.thesis.moving_least_squares import moving_least_squares


@pytest.mark.parametrize('order', [2, 5])
def test_equals_pcl(golden, order):
    z = np.load(golden / 'refine.npz')
    smoothed = moving_least_squares(z['merged_voxel'][z['sor_keep']], 0.01, order)
    reference = z[f'mls{order}'].astype(float)
    assert np.array_equal(smoothed.index, z[f'mls{order}_index'])
    assert np.linalg.norm(smoothed.points - reference[:, :3], axis=1).max() < 1e-7  # asked for: 2e-4
    cosine = np.abs((smoothed.normals * reference[:, 3:6]).sum(axis=1))
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.1


def test_a_polynomial_surface_is_left_as_it_is():
    x, y = np.meshgrid(np.linspace(-0.03, 0.03, 41), np.linspace(-0.03, 0.03, 41))
    points = np.stack([x, y, 2 * x**2 - 1.5 * x * y], axis=-1).reshape(-1, 3)
    inner = (np.abs(points[:, :2]) < 0.018).all(axis=1)
    fine = moving_least_squares(points, 0.01, 5)
    plane = moving_least_squares(points, 0.01, 1)

    def off(p):
        return np.abs(p[:, 2] - 2 * p[:, 0] ** 2 + 1.5 * p[:, 0] * p[:, 1])[inner].max()

    assert off(fine.points) < 1e-7
    assert off(plane.points) > 1e-5
    gradient = np.stack(
        [4 * points[:, 0] - 1.5 * points[:, 1], -1.5 * points[:, 0], -np.ones(len(points))], 1
    )
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    assert np.abs((gradient * fine.normals).sum(axis=1))[inner].min() > 1 - 1e-6


def test_noise_is_smoothed():
    rng = np.random.default_rng(1)
    points = np.c_[rng.uniform(-0.05, 0.05, (6000, 2)), 0.001 * rng.normal(size=6000)]
    inner = (np.abs(points[:, :2]) < 0.035).all(axis=1)
    left = {order: moving_least_squares(points, 0.01, order).points[inner, 2].std() for order in (1, 2, 5)}
    assert left[1] < left[2] < left[5] < 0.0006  # the higher the order the more noise it follows


def test_lonely_points_are_left_out_and_few_neighbours_take_the_plane():
    rng = np.random.default_rng(2)
    patch = rng.uniform(-0.004, 0.004, (10, 3)) * [1, 1, 0.01]  # too few for 21 coefficients
    smoothed = moving_least_squares(np.vstack([patch, [[1.0, 0, 0], [1.001, 0, 0]]]), 0.01, 5)
    assert smoothed.index.tolist() == list(range(10))
    plane = moving_least_squares(patch, 0.01, 0)
    assert np.allclose(smoothed.points, plane.points)


def test_points_on_a_line_stay_on_it():
    line = np.outer(np.linspace(0, 0.02, 60), [0.6, 0.0, 0.8])
    smoothed = moving_least_squares(line, 0.01, 5)
    assert np.allclose(smoothed.points, line, atol=1e-9)
    assert np.isfinite(smoothed.normals).all()


def test_nonsense_is_refused_and_nothing_stays_nothing():
    assert moving_least_squares(np.empty((0, 3))).points.shape == (0, 3)
    with pytest.raises(ValueError, match='radius'):
        moving_least_squares(np.zeros((5, 3)), 0.0)
