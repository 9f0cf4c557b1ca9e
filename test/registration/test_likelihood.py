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

"""The likelihood of a pair of views: highest where they truly are; its gradient leads there."""

import numpy as np
import pytest

from debris_scanner.core.geometry import compose, exp_se3, inverse, transform
from debris_scanner.registration.likelihood import HIT, BeamModel, pair_likelihood
from debris_scanner.sensing.sensor_model import measure_sensor

PAIR = 40, 44
CENTRE = np.zeros(3)


@pytest.fixture(scope='module')
def beam(recording):
    pairs = [
        (
            recording.views[k],
            compose(inverse(recording.pose(k - 2)), recording.pose(k)),
            recording.views[k - 2],
        )
        for k in (20, 40, 60, 80)
    ]
    return BeamModel.of(measure_sensor(pairs), [view for view, _, _ in pairs])


def likelihood(recording, beam, twist=np.zeros(6), widen=1.0):
    i, j = PAIR
    T = compose(exp_se3(twist), recording.pose(i))
    return pair_likelihood(recording.views[i], T, recording.views[j], recording.pose(j), beam, CENTRE, widen)


@pytest.mark.parametrize('k', range(6))
def test_the_true_pose_is_the_likeliest(recording, beam, k):
    here = likelihood(recording, beam)
    step = np.zeros(6)
    step[k] = np.radians(1.0) if k < 3 else 0.004
    for side in (step, -step):
        there = likelihood(recording, beam, side)
        assert there.log_likelihood / there.points < here.log_likelihood / here.points - 0.01


def test_the_gradient_leads_back(recording, beam):
    """From a degree off; the widened noise sees further."""
    off = np.concatenate([np.radians([0.6, -0.6, 0.4]), [0.002, -0.002, 0.002]])
    at = off
    for widen in (4.0, 2.0, 1.0, 1.0, 1.0):
        here = likelihood(recording, beam, at, widen)
        at = at - np.linalg.solve(here.H, here.g)
    assert np.linalg.norm(at[:3]) < 0.25 * np.linalg.norm(off[:3])


def test_the_other_view_moves_the_other_way(recording, beam):
    i, j = PAIR
    a, b = (recording.views[i], recording.pose(i)), (recording.views[j], recording.pose(j))
    ab = pair_likelihood(*a, *b, beam, CENTRE)
    ba = pair_likelihood(*b, *a, beam, CENTRE)
    assert ba.log_likelihood == pytest.approx(ab.log_likelihood)
    np.testing.assert_allclose(ba.H, ab.H, rtol=1e-6, atol=1e-6 * ab.H.max())
    np.testing.assert_allclose(ba.g, -ab.g, rtol=1e-6, atol=1e-6 * np.abs(ab.g).max())


def test_it_does_not_depend_on_the_target_frame(recording, beam):
    i, j = PAIR
    move = exp_se3(np.array([0.3, -0.4, 1.0, 0.5, -0.2, 0.4]))
    here = likelihood(recording, beam)
    there = pair_likelihood(
        recording.views[i], compose(move, recording.pose(i)), recording.views[j],
        compose(move, recording.pose(j)), beam, move[:3, 3],
    )  # fmt: skip
    assert there.log_likelihood == pytest.approx(here.log_likelihood, rel=1e-6)
    twist = compose(transform(move[:3, :3], np.zeros(3)))[:3, :3]
    np.testing.assert_allclose(twist.T @ there.g[:3], here.g[:3], rtol=1e-4, atol=1e-3 * np.abs(here.g).max())


def test_shares_are_those_that_neighbours_show(recording, beam):
    learnt = beam.with_shares_of([likelihood(recording, beam)])
    np.testing.assert_allclose(learnt.shares.sum(axis=1), 1.0)
    assert learnt.shares[0, HIT] > 0.85
    turned = likelihood(recording, beam, np.array([0.0, 0.0, np.pi, 0.0, 0.0, 0.0]))
    assert beam.with_shares_of([turned]).shares[0, HIT] < 0.5
