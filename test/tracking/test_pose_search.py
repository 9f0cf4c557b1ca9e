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

"""Pose search: starts around a prediction, what a rotation changes besides, competing fits, global search."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from posed_frames import simulated

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import compose, exp_so3, inverse, rotation_angle
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.sensing.views import View
from debris_scanner.sim.session import SimulationSettings
from debris_scanner.tracking.gating import FrameFit
from debris_scanner.tracking.motion_filter import ATTITUDE, MotionFilter, MotionSettings
from debris_scanner.tracking.pose_search import (
    DISTINCT,
    FURTHEST_START,
    STEP,
    TRACKED_POINTS,
    attitude_grid,
    attitude_sigma,
    competing_fits,
    global_pose_search,
    mahalanobis,
    mapped_fraction,
    nearby,
    search,
    tracking_surface,
)


def unsure(sigma_deg=20.0):
    """A filter whose attitude is so uncertain about every axis."""
    motion = MotionFilter(np.array([0.0, 0.0, 0.8]), MotionSettings(), footprint=0.0015)
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
    stats = RegistrationStats(points=1000, matched=900, visible=1000, in_free_space=1000 * free)
    return FrameFit(motion, stats, 0.1, overlap, overlap, 0.0)


def test_competing_fits_contradict_the_best_and_each_other_and_are_hardly_worse():
    near = np.degrees(DISTINCT) / 2
    fits = [fit(0, 0.95), fit(near, 0.94), fit(30, 0.93), fit(30 + near, 0.92), fit(60, 0.80)]
    found = competing_fits(fits, lambda f: f.score)
    assert [round(np.degrees(rotation_angle(f.filter.R))) for f in found] == [30]
    assert competing_fits(fits[:2], lambda f: f.score) == []
    assert competing_fits([], lambda f: f.score) == []


@pytest.mark.parametrize('off_deg', [0.0, 15.0, 25.0])
def test_search_finds_the_attitude_and_the_rate_that_led_there(recording, off_deg):
    """The prediction of a gap of 1 s is off, because the rate was."""
    first, later = recording.targets[0], recording.targets[3]
    motion = MotionFilter(np.array([0.0, 0.0, 0.83]), MotionSettings(), footprint=0.0015)
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


def test_grid_reaches_every_attitude():
    grid = np.array(attitude_grid())
    np.testing.assert_allclose(
        grid @ grid.transpose(0, 2, 1), np.broadcast_to(np.eye(3), grid.shape), atol=1e-12
    )
    rng = np.random.default_rng(3)
    for _ in range(200):
        axis = rng.normal(size=3)
        R = exp_so3(axis / np.linalg.norm(axis) * rng.uniform(0, np.pi))
        trace = np.einsum('nij,ij->n', grid, R).max()
        assert np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))) < 26


def test_surface_is_an_even_draw_of_the_model(true_model):
    surface = tracking_surface(true_model)
    assert surface.points.shape == surface.normals.shape == (TRACKED_POINTS, 3)
    assert surface.points.flags.c_contiguous and surface.points.dtype == np.float32
    assert np.linalg.norm(surface.points.mean(0) - true_model.points.mean(0)) < 0.005
    # each point keeps its own normal
    lookup = {p.tobytes(): n for p, n in zip(true_model.points, true_model.normals, strict=True)}
    assert all(
        np.array_equal(lookup[p.tobytes()], n) for p, n in zip(surface.points, surface.normals, strict=True)
    )
    again = tracking_surface(true_model)
    np.testing.assert_array_equal(again.points, surface.points)
    assert len(tracking_surface(true_model, 100).points) == 100


@pytest.mark.parametrize('k', [0, 31, 63, 94])
def test_pose_is_found_without_a_prediction(true_model, recording, k):
    poses = global_pose_search(tracking_surface(true_model), recording.views[k])
    truth = recording.truth[recording.frames[k].stamp_ns]
    assert 1 <= len(poses) <= 5
    angles = [np.degrees(rotation_angle(T[:3, :3].T @ truth[:3, :3])) for T in poses]
    # the refinement leaves at most a few degrees to the tracker that starts from here
    assert min(angles[:2]) < 4
    best = poses[int(np.argmin(angles))]
    assert np.linalg.norm(best[:3, 3] - truth[:3, 3]) < 0.008


def test_poses_are_distinct(true_model, recording):
    poses = global_pose_search(tracking_surface(true_model), recording.views[10], best=4)
    assert len(poses) <= 4
    for i, a in enumerate(poses):
        for b in poses[:i]:
            assert rotation_angle(a[:3, :3] @ b[:3, :3].T) > np.radians(8) - 1e-9


def test_share_of_a_view_that_is_known(true_model, recording):
    """The model's own view is known, of one from behind of a model's front next to nothing."""
    view, T = recording.views[10], recording.truth[recording.frames[10].stamp_ns]
    surface = tracking_surface(true_model)
    # what is seen obliquely counts as if it were seen face-on
    assert 0.6 < mapped_fraction([(surface, np.eye(4))], view, T) < 1.8
    seen_from = T[:3, :3].T @ [0.0, 0.0, -1.0]  # the sensor's side, target frame
    behind = true_model.normals @ seen_from < -0.5
    back = Model(
        true_model.points[behind], true_model.normals[behind], np.zeros((0, 3)), np.zeros((0, 3), int)
    )
    assert mapped_fraction([(tracking_surface(back), np.eye(4))], view, T) < 0.05
    keyframe = (recording.views[8], recording.pose(8))
    assert mapped_fraction([(tracking_surface(back), np.eye(4)), keyframe], view, T) > 0.8
    assert mapped_fraction([], view, T) == 0.0


def test_paint_tells_where_a_body_of_revolution_is_found_again():
    """The prediction after a gap is 27 degrees off about the axis, along which the shape shows nothing."""
    settings = SimulationSettings(target='cylinder', colour=True, rate_hz=2.5, seconds=13.0)
    frames = simulated(settings)
    views = [View(frame) for frame, _ in frames]
    seen, T_target_seen = views.pop(15), frames.pop(15)[1]
    truth, axis = inverse(T_target_seen), np.array([0.0, 0.0, 1.0])
    motion = unsure()
    motion.R = truth[:3, :3] @ exp_so3(np.radians(27) * axis)
    motion.centre = truth[:3, 3] + motion.R @ motion.pivot
    along = motion.R @ axis
    motion.P[ATTITUDE, ATTITUDE] = np.radians(1.0) ** 2 * np.eye(3)
    motion.P[ATTITUDE, ATTITUDE] += np.radians(20.0) ** 2 * np.outer(along, along)

    def references(near):
        apart = [rotation_angle(near.R @ T[:3, :3]) for _, T in frames]
        return [(views[k], frames[k][1]) for k in np.argsort(apart)[:2]]

    found = search(motion, seen, nearby(motion), references, 0.4)
    assert np.degrees(rotation_angle(found[0].filter.R @ truth[:3, :3].T)) < 0.5
    assert found[0].picture > 0.5
    assert not competing_fits(found, lambda f: f.score)
