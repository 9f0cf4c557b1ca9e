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

"""A tracked frame fitted to the model alone, on the recorded spin with a model of true poses."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import compose, exp_se3, inverse, rotation_angle
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import View
from debris_scanner.tracking import model_tracker
from debris_scanner.tracking.model_tracker import ModelTracker
from debris_scanner.tracking.motion_filter import ATTITUDE, CENTRE, MotionFilter, MotionSettings

FRAME, NEAR = 21, 18
ASTRAY = np.array([0.02, -0.015, 0.02, 0.002, -0.001, 0.003])  # rad, m


@pytest.fixture(scope='module')
def tracker(true_model):
    return ModelTracker(true_model, NormalSettings())


@pytest.fixture
def near(recording):
    return [(recording.views[NEAR], recording.pose(NEAR))]


def predicted(recording, astray):
    """A filter near the true pose, which knows that it may be astray."""
    T = compose(inverse(recording.pose(FRAME)), exp_se3(astray))
    motion = MotionFilter(T[:3, 3], MotionSettings(), recording.views[FRAME].footprint)
    motion.R = T[:3, :3].copy()
    motion.P[ATTITUDE, ATTITUDE] = np.eye(3) * 0.03**2
    motion.P[CENTRE, CENTRE] = np.eye(3) * 0.005**2
    return motion


def unfitted(frame):
    """A view of which nothing is prepared."""
    return View(TargetFrame(frame.stamp_ns, frame.camera, frame.depth, frame.depth_fit, frame.normals))


def test_a_frame_is_led_from_its_prediction_to_the_truth(recording, tracker, near):
    prior, view = predicted(recording, ASTRAY), unfitted(recording.targets[FRAME])
    before = prior.T_sensor_target
    fit = tracker.fit(prior, view, near)
    error = compose(recording.pose(FRAME), fit.filter.T_sensor_target)
    assert np.degrees(rotation_angle(error[:3, :3])) < 0.3
    assert np.linalg.norm(error[:3, 3]) < 5e-4
    assert fit.stats.matched > 100 and fit.loss < 0.5
    np.testing.assert_array_equal(prior.T_sensor_target, before)
    assert 'points' not in view.__dict__  # nothing of the view was prepared


def test_a_frame_of_something_else_loses_more(recording, tracker, near):
    fit = tracker.fit(predicted(recording, np.zeros(6)), unfitted(recording.targets[FRAME]), near)
    shifted = recording.targets[FRAME + 30]
    other = tracker.fit(predicted(recording, np.zeros(6)), unfitted(shifted), near)
    assert other is None or other.loss > fit.loss + 0.5


def test_key_frames_help_where_a_picture_is_needed_or_the_model_lacks_much(
    recording, true_model, near, monkeypatch
):
    frame, prior = recording.targets[FRAME], predicted(recording, np.zeros(6))
    tracker = ModelTracker(true_model, NormalSettings())
    assert tracker.fit(prior, unfitted(frame), []) is None
    rgb = np.zeros((*frame.depth.shape, 3), np.uint8)
    coloured = View(dataclasses.replace(frame, rgb=rgb))
    assert tracker.fit(prior, coloured, near) is not None  # the shape shows how it turns
    with monkeypatch.context() as nothing_shows:
        nothing_shows.setattr(model_tracker, 'OBSERVABLE', np.inf)
        assert tracker.fit(prior, coloured, near) is None
        assert tracker.fit(prior, unfitted(frame), near) is not None
    assert tracker.fit(prior, unfitted(frame), near) is not None
    # beside the target there is as much again, which the model has not
    twice = np.concatenate([frame.depth, frame.depth], axis=1)
    camera = dataclasses.replace(frame.camera, width=2 * frame.camera.width)
    normals = np.concatenate([frame.normals, frame.normals], axis=1)
    doubled = View(TargetFrame(frame.stamp_ns, camera, twice, twice, normals))
    assert tracker.fit(prior, doubled, near) is None
