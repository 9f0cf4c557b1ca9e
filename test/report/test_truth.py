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

"""The truth in the scan's own target frame."""

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.core.results import StampedPose
from debris_scanner.report.truth import Truth

OMEGA = np.array([0.1, -0.4, 0.2])  # rad/s, true target frame
TURN = transform(exp_so3(np.array([0.5, 0.2, -0.7])), np.array([0.02, -0.01, 0.03]))  # T_truth_target


def spin(k, extra=0.0):
    start = transform(exp_so3([0.3, 0.0, 0.1]), np.array([0.0, 0.1, 0.8]))
    return start @ transform(exp_so3(OMEGA * (0.1 * k + extra)), np.zeros(3))


@pytest.fixture
def true_poses():
    return [StampedPose(k * 10**8, spin(k)) for k in range(40) if not 20 <= k < 30]


def test_rates_are_those_of_the_spin_in_the_estimates_frame(true_poses):
    truth = Truth.of(true_poses, [StampedPose(p.stamp_ns, p.T_sensor_target @ TURN) for p in true_poses])
    np.testing.assert_allclose(truth.T_truth_target, TURN, atol=1e-9)
    stamps, omega = truth.rates()
    # a point of the estimate's frame is TURN^-1 of the true one's, and so is the rate
    np.testing.assert_allclose(omega, np.tile(TURN[:3, :3].T @ OMEGA, (len(omega), 1)), atol=1e-9)
    assert len(stamps) == 28  # none before the first frame, none across the gap
    assert 30 * 10**8 not in stamps


def test_errors_tied_by_the_constant_and_tied_at_the_first(true_poses):
    late = [StampedPose(p.stamp_ns, spin(k, 0.05) @ TURN) for k, p in enumerate(true_poses[:20])]
    truth = Truth.of(true_poses, [StampedPose(p.stamp_ns, p.T_sensor_target @ TURN) for p in true_poses])
    errors = truth.errors(late)
    np.testing.assert_allclose(errors.attitude_rad, 0.05 * np.linalg.norm(OMEGA), atol=1e-9)
    tied = truth.errors(late, from_first=True)
    np.testing.assert_allclose(tied.attitude_rad, 0.0, atol=1e-7)
    assert tied.stamps_ns.tolist() == [p.stamp_ns for p in late]
    np.testing.assert_allclose(truth.errors(late[:0], True).position_m, np.zeros(0))


def test_nothing_in_common_is_no_truth(true_poses):
    assert Truth.of(true_poses, [StampedPose(7, np.eye(4))]) is None
    assert Truth.of([], true_poses) is None
