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

"""Residuals of views at their true poses show what the sensor does to its images."""

import numpy as np
import pytest

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import compose, exp_se3, inverse
from debris_scanner.registration.offset_terms import OffsetEquations
from debris_scanner.registration.projective import linearise_pair
from debris_scanner.sensing.depth_offset import DepthOffset
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

LATTICE = DepthOffset.none_over(np.array([-0.2, -0.15]), np.array([0.2, 0.15]), 0.05)


@pytest.fixture(scope='module')
def bent():
    """Views of an asteroid before a sensor without noise that has an offset, their true poses, the offset."""
    rng, preprocessor = np.random.default_rng(1), make_preprocessor(Settings())
    offset = DepthOffset(0.05, LATTICE.first, 3e-3 * rng.normal(size=LATTICE.coefficients.shape))
    views, poses = [], []
    settings = SimulationSettings(target='asteroid', rate_hz=2.5, seconds=12.0, noise=False)
    for f in Simulation(settings):
        depth = (f.depth * (1 + offset.share(f.camera))).astype(np.float32)
        views.append(View(preprocessor.process(DepthFrame(f.stamp_ns, depth, f.camera))))
        poses.append(inverse(f.T_sensor_target))
    return views, poses, offset


def pairs(count):
    return [(i, j) for i in range(count) for j in (i - 1, i - 2) if j >= 0]


def test_the_offset_that_views_have_is_found_at_the_true_poses(bent):
    views, poses, offset = bent
    equations = OffsetEquations(views, poses, LATTICE)
    for i, j in pairs(len(views)):
        equations.add_pair(i, j, 8.0, 1.0)
    m = len(equations.g)
    H = equations.H + 1e-4 * np.trace(equations.H) / m * np.eye(m)
    found = -np.linalg.solve(H, equations.g)
    seen, true = equations.seen > 0.2 * equations.seen.max(), offset.coefficients.ravel()
    assert np.count_nonzero(seen) > 10
    # an equal share everywhere does not show
    found, true = found[seen] - found[seen].mean(), true[seen] - true[seen].mean()
    assert np.corrcoef(found, true)[0, 1] > 0.9
    assert np.linalg.norm(found - true) < 0.5 * np.linalg.norm(true)


def test_a_turned_view_looks_like_the_gradient_says(bent):
    """The product with a twist is how the offset's gradient changes as a view is turned."""
    views, poses, _ = bent
    step = 1e-5

    def gradient(twist):
        equations = OffsetEquations(views, [compose(exp_se3(twist), poses[1]), poses[0]], LATTICE)
        equations.add_pair(0, 1, 8.0, 1.0)
        return equations

    views = [views[1], views[0]]
    at = gradient(np.zeros(6))
    for k in range(6):
        twist = np.zeros(6)
        twist[k] = step
        change = (gradient(twist).g - gradient(-twist).g) / (2 * step)
        expected = at.twist[0, k]
        assert (
            np.linalg.norm(change - expected)
            < 0.35 * np.linalg.norm(expected) + 1e-3 * np.abs(at.twist).max()
        )
    np.testing.assert_allclose(at.twist[1], -at.twist[0])


def test_weights_count_and_views_that_do_not_meet_do_not(bent):
    views, poses, _ = bent
    once, twice = OffsetEquations(views, poses, LATTICE), OffsetEquations(views, poses, LATTICE)
    once.add_pair(1, 0, 8.0, 1.0)
    once.add_pair(1, 0, 8.0, 1.0)
    twice.add_pair(1, 0, 8.0, 2.0)
    np.testing.assert_allclose(once.H, twice.H)
    np.testing.assert_allclose(once.g, twice.g)
    np.testing.assert_allclose(once.H, once.H.T)
    away = [poses[0], compose(exp_se3(np.array([0, 0, 0, 0, 0, 5.0])), poses[1])]
    apart = OffsetEquations(views[:2], away, LATTICE)
    apart.add_pair(1, 0, 8.0, 1.0)
    assert not apart.seen.any()
    assert linearise_pair(views[1], away[1], views[0], away[0], 8.0).stats.matched == 0
