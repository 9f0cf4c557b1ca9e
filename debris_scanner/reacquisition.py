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

"""Find the model in a view from nothing: score a grid of attitudes, keep the most promising."""

from collections.abc import Sequence

import numpy as np

from debris_scanner.frame_fit import Reference
from debris_scanner.geometry import Array, compose, exp_se3, inverse, rotation_angle, transform
from debris_scanner.model import CLOUD_VOXEL, Model
from debris_scanner.registration import linearise, solve_step
from debris_scanner.rim import Rim
from debris_scanner.views import Surface, View

MATCH_GATE = 0.008  # m
TRACKED_POINTS = 3000
SCORED_POINTS = 400
DIRECTIONS = 65
ROLLS = 18
REFINED = 40
DISTINCT = np.radians(8.0)


def tracking_surface(model: Model, count: int = TRACKED_POINTS) -> Surface:
    """Evenly drawn points of the model that a view is registered to."""
    surface = Surface.sampled(model.points, model.normals, count)
    surface.point_area = len(model.points) * CLOUD_VOXEL**2 / max(1, len(surface.points))
    return surface


def known_share(references: Sequence[Reference], view: View, T_sensor_target: Array) -> float:
    """Share of what a view shows that matches a reference, the best of them: a key frame or a model."""
    T_target_view = inverse(T_sensor_target)
    pixels_per_m2 = view.intrinsics[0] * view.intrinsics[1] / view.centroid[2] ** 2
    shares = [0.0]
    for surface, pose in references:
        if isinstance(surface, View):
            shares.append(linearise(view, T_target_view, surface, pose, MATCH_GATE).agreement.overlap)
        else:
            matched = linearise(surface, pose, view, T_target_view, MATCH_GATE).agreement.matched
            area = matched * surface.point_area * pixels_per_m2
            shares.append(area / max(1, np.count_nonzero(view.depth_map)))
    return max(shares)


def find_pose(surface: Surface, view: View, best: int = 5) -> list[Array]:
    """Most promising T_sensor_target (4, 4), best first, that show the surface as the view does.

    Coarse scores over a sphere of view directions and rolls, then a few Gauss-Newton steps on the best.

    Args:
        surface: the model, target frame.
        view: the frame to be explained.
        best: how many distinct attitudes to return.
    """
    few = _first(surface, SCORED_POINTS)
    scored = []
    for R in attitude_grid():
        T = _centred(R, surface, view)
        scored.append((_score(few, T, view, 0.02), T))
    scored.sort(key=lambda s: -s[0])
    some = _first(surface, 2 * SCORED_POINTS)
    refined = []
    for _, T in scored[:REFINED]:
        for gate in (0.04, 0.03, 0.02, 0.02, 0.012, 0.012):
            lin = linearise(some, np.eye(4), view, inverse(T), gate)
            # the twist moves the model; seen from the sensor that is the pose on the right
            T = compose(T, exp_se3(solve_step(lin.H, lin.g)))
        refined.append((_score(some, T, view, 0.012), T))
    refined.sort(key=lambda s: -s[0])
    poses: list[Array] = []
    for _, T in refined:
        if all(rotation_angle(T[:3, :3] @ P[:3, :3].T) > DISTINCT for P in poses):
            poses.append(T)
    return poses[:best]


def _first(surface: Surface, n: int) -> Surface:
    rim = Rim(surface.rim.points[:n], surface.rim.normals[:n], surface.rim.edge[:n])
    return Surface(surface.points[:n], surface.normals[:n], surface.anchors[:n], rim)


def attitude_grid() -> list[Array]:
    """Rotations (3, 3) over all view directions (Fibonacci sphere) and rolls."""
    k = np.arange(DIRECTIONS) + 0.5
    z, azimuth = 1 - 2 * k / DIRECTIONS, np.pi * (1 + 5**0.5) * k
    rotations = []
    for c, a in zip(z, azimuth, strict=True):
        s = np.sqrt(1 - c * c)
        tilt = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        for roll in np.arange(ROLLS) * (2 * np.pi / ROLLS):
            r = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
            rotations.append(r @ (turn @ tilt).T)
    return rotations


def _centred(R: Array, surface: Surface, view: View) -> Array:
    """Pose with the rotation R whose visible points have the view's centroid."""
    facing = surface.normals @ R[2] < 0
    points = surface.points[facing] if facing.any() else surface.points
    return transform(R, view.centroid - R @ points.mean(axis=0))


def _score(surface: Surface, T_sensor_target: Array, view: View, gate: float) -> float:
    a = linearise(surface, np.eye(4), view, inverse(T_sensor_target), gate).agreement
    return a.explained - 2 * a.free_space - 0.5 * a.outside
