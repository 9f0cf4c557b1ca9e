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

"""The model is found in a view from nothing."""

import numpy as np
import pytest

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import exp_so3, rotation_angle
from debris_scanner.tracking.pose_search import (
    TRACKED_POINTS,
    attitude_grid,
    find_pose,
    known_share,
    tracking_surface,
)


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
def test_pose_is_found_from_nothing(true_model, recording, k):
    poses = find_pose(tracking_surface(true_model), recording.views[k])
    truth = recording.truth[recording.frames[k].stamp_ns]
    assert 1 <= len(poses) <= 5
    angles = [np.degrees(rotation_angle(T[:3, :3].T @ truth[:3, :3])) for T in poses]
    # the refinement leaves at most a few degrees to the tracker that starts from here
    assert min(angles[:2]) < 4
    best = poses[int(np.argmin(angles))]
    assert np.linalg.norm(best[:3, 3] - truth[:3, 3]) < 0.008


def test_poses_are_distinct(true_model, recording):
    poses = find_pose(tracking_surface(true_model), recording.views[10], best=4)
    assert len(poses) <= 4
    for i, a in enumerate(poses):
        for b in poses[:i]:
            assert rotation_angle(a[:3, :3] @ b[:3, :3].T) > np.radians(8) - 1e-9


def test_share_of_a_view_that_is_known(true_model, recording):
    """The model's own view is known, of one from behind of a model's front next to nothing."""
    view, T = recording.views[10], recording.truth[recording.frames[10].stamp_ns]
    surface = tracking_surface(true_model)
    # what is seen obliquely counts as if it were seen face-on
    assert 0.6 < known_share([(surface, np.eye(4))], view, T) < 1.8
    seen_from = T[:3, :3].T @ [0.0, 0.0, -1.0]  # the sensor's side, target frame
    behind = true_model.normals @ seen_from < -0.5
    back = Model(
        true_model.points[behind], true_model.normals[behind], np.zeros((0, 3)), np.zeros((0, 3), int)
    )
    assert known_share([(tracking_surface(back), np.eye(4))], view, T) < 0.05
    keyframe = (recording.views[8], recording.pose(8))
    assert known_share([(tracking_surface(back), np.eye(4)), keyframe], view, T) > 0.8
    assert known_share([], view, T) == 0.0
