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

"""The thesis's odometry: kept frames, estimated rates."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.parameters import updated
from debris_scanner.research.thesis.odometry import estimate, keep_by_angle, thin_out


def about_y(angles):
    return [exp_so3(np.array([0, a, 0])) for a in np.radians(angles)]


def test_frames_are_kept_every_ten_degrees_whatever_the_rate():
    steady = keep_by_angle(about_y(np.arange(0, 361, 4.0)), 10.0)
    assert np.diff(steady).tolist() == [3] * (len(steady) - 1)  # 12 degrees: the first past ten
    slowing = np.cumsum(np.linspace(6, 0.1, 60))
    kept = keep_by_angle(about_y(slowing), 10.0)
    turns = np.diff(slowing[kept])
    assert (turns >= 10).all()
    assert (turns < 16).all()
    assert keep_by_angle(about_y([0, 0.1, 0.2]), 10.0) == [0]
    assert keep_by_angle(about_y([0, 0.1, 0.2]), 0.0) == [0, 1, 2]


def test_thinning_keeps_the_asked_rate_despite_jitter(turning):
    frames, _ = turning
    assert len(thin_out(frames, 5.0)) == len(frames)
    assert len(thin_out(frames, 2.5)) == (len(frames) + 1) // 2
    assert thin_out(frames, 1.0)[1].stamp_ns == frames[5].stamp_ns


def test_rate_is_found_but_too_small(turning_odometry, coarse):
    """Point-to-point ICP under-rotates: the thesis's rates, and the attitudes from them, fall short."""
    motion = turning_odometry
    rate = np.mean([o.omega for o in motion.observations if o.omega is not None], axis=0)
    assert -0.65 < rate[1] < -0.55
    assert np.abs(rate[[0, 2]]).max() < 0.03
    assert all(r.accepted for r in motion.rates[5:])
    assert 1e-7 < motion.observations[3].fitness < 1e-4
    turned = motion.path[-1]
    assert turned == pytest.approx(0.65 * 0.2 * (len(motion.clouds) - 1), rel=0.12)
    assert np.allclose(motion.attitudes[0], np.eye(3))


def test_batch_gives_one_rate_for_all_frames(turning, coarse):
    frames, _ = turning
    motion = estimate(frames[:12], updated(coarse, {'odometry.estimator': 'batch'}))
    assert motion.ekf is None
    omegas = {tuple(r.omega) for r in motion.rates}
    assert len(omegas) == 1
    (omega,) = omegas
    assert -0.7 < omega[1] < -0.5
    steps = [motion.attitudes[k].T @ motion.attitudes[k + 1] for k in range(5)]
    assert np.allclose(steps, [exp_so3(np.array(omega) * 0.2)] * 5)


def test_no_rate_is_observed_across_a_gap(turning, coarse):
    frames, _ = turning
    motion = estimate(frames[:6] + frames[9:14], coarse)
    missing = [k for k, o in enumerate(motion.observations) if o.omega is None]
    assert missing == [5]
    assert motion.alignments[5] is None
    assert not motion.rates[5].accepted
    sigma = [r.sigma[1] for r in motion.rates]
    assert sigma[5] > 2 * sigma[4]  # the gap widens it, the next frame narrows it again
    assert sigma[6] < sigma[5]
    # the filter's rate carries the attitude over it
    turn = motion.path[6] - motion.path[5]
    assert turn == pytest.approx(0.65 * 0.8, rel=0.15)


@pytest.mark.parametrize('axes', ['body', 'sensor'])
def test_attitude_of_the_prior_does_not_tilt_the_target_frame(turning, coarse, axes):
    def attitudes(beta):
        prior = {'ekf.prior_state': [*beta, 0.0, -0.6, 0.0], 'ekf.rate_axes': axes}
        return estimate(turning[0][:8], updated(coarse, prior)).attitudes

    plain, tilted = attitudes([1.0, 0.0, 0.0, 0.0]), attitudes([0.8, 0.6, 0.0, 0.0])
    assert np.allclose(tilted[0], np.eye(3))
    # eq. 2.65 treats the four parameters unlike, so the two agree but for that
    assert np.allclose(plain, tilted, atol=5e-3)


def test_one_frame_is_no_sequence(turning, coarse):
    with pytest.raises(ValueError, match='no sequence'):
        estimate(turning[0][:1], coarse)
