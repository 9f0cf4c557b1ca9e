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

"""ELCH against PCL."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.research.thesis.elch import close_loop, distribute, even_shares, travelled_shares


@pytest.mark.parametrize('name', ['given', 'icp'])
def test_equals_pcl(golden, name):
    z = np.load(golden / 'lum_elch.npz')
    mine = distribute(z[f'elch_{name}_loop'].astype(float), even_shares(46))
    assert np.abs(np.array(mine) - z[f'elch_{name}_transforms']).max() < 2.5e-7


def test_given_loop_within_single_precision(golden):
    z = np.load(golden / 'lum_elch.npz')
    mine = distribute(z['elch_given_loop'].astype(float), even_shares(46))
    assert np.abs(np.array(mine) - z['elch_given_transforms']).max() < 1.5e-7


def test_first_frame_stays_and_last_takes_all():
    loop = transform(exp_so3(np.array([0.1, 0.4, -0.2])), np.array([0.01, -0.02, 0.03]))
    poses = [transform(exp_so3(np.array([0, 0.1 * k, 0])), np.zeros(3)) for k in range(9)]
    closed = close_loop(poses, loop)
    assert np.array_equal(closed[0], poses[0])
    assert np.allclose(closed[-1], loop @ poses[-1])
    half = transform(exp_so3(np.array([0.05, 0.2, -0.1])), np.array([0.005, -0.01, 0.015]))
    assert np.allclose(closed[4], half @ poses[4])


def test_shares_follow_the_way_travelled():
    assert np.allclose(travelled_shares(np.array([0.1, 0.3, -0.4, 0.0])), [0, 0.125, 0.5, 1, 1])
    assert np.allclose(travelled_shares(np.zeros(4)), even_shares(5))
    with pytest.raises(ValueError, match='two frames'):
        even_shares(1)
