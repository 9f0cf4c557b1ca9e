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

"""Searching an attitude in doubt: starts, what a turn changes besides, and who is a rival."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from debris_scanner.core.geometry import compose, exp_so3, inverse, rotation_angle
from debris_scanner.registration.projective import Agreement
from debris_scanner.sensing.views import View
from debris_scanner.tracking.gating import FrameFit
from debris_scanner.tracking.motion_filter import ATTITUDE, MotionFilter, MotionSettings
from debris_scanner.tracking.pose_search import (
    DISTINCT,
    FURTHEST_START,
    STEP,
    attitude_sigma,
    mahalanobis,
    nearby,
    rivals,
    search,
)


def unsure(sigma_deg=20.0):
    """A filter whose attitude is so uncertain about every axis."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings())
    motion.P[ATTITUDE, ATTITUDE] = np.eye(3) * np.radians(sigma_deg) ** 2
    return motion


@pytest.mark.parametrize('sigma_deg', [0.5, 5.0, 12.0, 25.0, 80.0])
def test_starts_surround_the_prediction_within_reach(sigma_deg):
    angles = np.linalg.norm(nearby(unsure(sigma_deg)), axis=1)
    assert angles[0] == 0
    assert angles.max() <= min(np.radians(2 * sigma_deg), FURTHEST_START) + STEP
    if sigma_deg > 9:
        assert len(angles) >= 7
        assert np.diff(np.unique(angles.round(9))).max() <= STEP + 1e-9


def test_distance_from_the_prediction_is_in_its_own_sigma():
    predicted, other = unsure(10.0), unsure()
    other.R = exp_so3(np.radians([0.0, 30.0, 0.0])) @ predicted.R
    assert_allclose(mahalanobis(other, predicted), 3.0, rtol=1e-6)
    assert_allclose(attitude_sigma(predicted), np.radians(10.0), rtol=1e-9)


def fit(degrees, overlap, free=0.0):
    motion = unsure()
    motion.R = exp_so3(np.radians([0.0, 0.0, degrees]))
    agreement = Agreement(points=1000, matched=900, visible=1000, in_free_space=1000 * free)
    return FrameFit(motion, agreement, 0.1, overlap, overlap, 0.0)


def test_rivals_contradict_the_best_and_each_other_and_are_hardly_worse():
    near = np.degrees(DISTINCT) / 2
    fits = [fit(0, 0.95), fit(near, 0.94), fit(30, 0.93), fit(30 + near, 0.92), fit(60, 0.80)]
    found = rivals(fits, lambda f: f.score)
    assert [round(np.degrees(rotation_angle(f.filter.R))) for f in found] == [30]
    assert rivals(fits[:2], lambda f: f.score) == []
    assert rivals([], lambda f: f.score) == []


@pytest.mark.parametrize('off_deg', [0.0, 15.0, 25.0])
def test_search_finds_the_attitude_and_the_rate_that_led_there(recording, off_deg):
    """The prediction of a gap of 1 s is off, because the rate was."""
    first, later = recording.targets[0], recording.targets[3]
    motion = MotionFilter(np.array([0.0, 0.0, 0.83]), MotionSettings())
    reference = View(first)
    T_first = motion.T_sensor_target
    motion.predict(1.0)
    truth = compose(
        recording.truth[later.stamp_ns], compose(inverse(recording.truth[first.stamp_ns]), T_first)
    )
    motion.R = exp_so3(np.radians([0.0, off_deg, 0.0])) @ truth[:3, :3]
    motion.centre = truth[:3, 3] + motion.R @ motion.pivot
    motion.P[ATTITUDE, ATTITUDE] = np.eye(3) * np.radians(12.0) ** 2

    def references(_motion):
        return [(reference, inverse(T_first))]

    found = search(motion, View(later), nearby(motion), references, 0.4)
    error = np.degrees(rotation_angle(found[0].filter.R @ truth[:3, :3].T))
    assert error < 2.0
    assert [f.score for f in found] == sorted((f.score for f in found), reverse=True)
    assert search(motion, View(later), nearby(motion), lambda _: [], 0.4) == []
