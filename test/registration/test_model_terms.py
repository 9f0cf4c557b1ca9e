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

"""Terms of a model in a raw depth image, against exactly known spheres and plates."""

import numpy as np
import pytest
from synthetic import CAMERA, rays, sphere_depth

from debris_scanner.core.geometry import compose, exp_se3, inverse, parts, transform
from debris_scanner.registration.model_terms import accumulate_edges, accumulate_model, points_on_rows
from debris_scanner.registration.projective import mirrored, solve_step

INTRINSICS = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
PIXEL = 0.6 / CAMERA.focal  # m, of what is 0.6 m away
HALF = 0.08  # m, of the plate's edge


def sphere(radius=0.1, count=4000):
    """Points and outward normals of a sphere about the origin."""
    directions = np.random.default_rng(1).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (radius * directions).astype(np.float32), directions.astype(np.float32)


def plate_depth():
    """A square plate that faces the camera from 0.6 m."""
    x, y = 0.6 * rays()[..., 0], 0.6 * rays()[..., 1]
    return np.where((np.abs(x) < HALF) & (np.abs(y) < HALF), 0.6, 0).astype(np.float32)


def plate_edges():
    """Points on the plate's four sides, its normals there, and the directions out of it."""
    along = np.linspace(-0.9 * HALF, 0.9 * HALF, 60)
    sides = [(np.array([sign * axis for axis in out]), out) for out in np.eye(3)[:2] for sign in (-1, 1)]
    points, outward = [], []
    for direction, axis in sides:
        points += [HALF * direction + a * (np.ones(3) - axis) * [1, 1, 0] for a in along]
        outward += [direction] * len(along)
    normals = np.tile([0.0, 0.0, -1.0], (len(points), 1))
    return tuple(np.array(a, np.float32) for a in (points, normals, outward))


def moved_by(terms, T_view_model, iterations=5):
    """The pose after Gauss-Newton steps over terms."""
    for _ in range(iterations):
        H, g = np.zeros((6, 6)), np.zeros(6)
        terms(*parts(T_view_model), H, g)
        T_view_model = inverse(compose(exp_se3(solve_step(mirrored(H), g)), inverse(T_view_model)))
    return T_view_model


def test_a_spheres_points_lead_it_to_where_it_was_measured():
    points, normals = sphere()
    depth, centre = sphere_depth((0.02, -0.01, 0.6)), np.array([0.02, -0.01, 0.6])

    def terms(R, t, H, g):
        accumulate_model(points, normals, R, t, depth, INTRINSICS, PIXEL, 8 * PIXEL, 1.0, 1, H, g)

    found = moved_by(terms, transform(np.eye(3), centre + [0.004, -0.003, 0.005]))
    np.testing.assert_allclose(found[:3, 3], centre, atol=0.05 * PIXEL)


def test_what_matches_covers_the_disc_that_is_seen():
    points, normals = sphere()
    R, t = np.eye(3), np.array([0, 0, 0.6])
    depth = sphere_depth()
    H, g = np.zeros((6, 6)), np.zeros(6)
    covered = accumulate_model(points, normals, R, t, depth, INTRINSICS, PIXEL, 8 * PIXEL, 1.0, 1, H, g)
    area_of_a_point = 4 * np.pi * 0.1**2 / len(points)
    # the outermost ring is too oblique to count
    assert covered * area_of_a_point == pytest.approx(np.count_nonzero(depth), rel=0.1)
    assert accumulate_model(points, normals, R, 2 * t, depth, INTRINSICS, PIXEL, 8 * PIXEL, 1.0, 1, H, g) == 0


def test_a_plates_edges_lead_it_sideways_and_its_surface_does_not():
    depth, (points, normals, outward) = plate_depth(), plate_edges()
    start = transform(np.eye(3), np.array([2 * PIXEL, -1.5 * PIXEL, 0.6]))

    def edges(R, t, H, g):
        accumulate_edges(points, normals, outward, R, t, depth, INTRINSICS, PIXEL, 1.0, H, g)

    found = moved_by(edges, start)
    np.testing.assert_allclose(found[:2, 3], 0, atol=0.5 * PIXEL)
    H, g = np.zeros((6, 6)), np.zeros(6)
    accumulate_model(points, normals, *parts(start), depth, INTRINSICS, PIXEL, 8 * PIXEL, 1.0, 1, H, g)
    assert H[5, 5] > 0 and not H[3, 3] and not H[4, 4]


def test_something_in_front_ends_no_face():
    depth, (points, normals, outward) = plate_depth(), plate_edges()
    depth[depth == 0] = 0.4
    H, g = np.zeros((6, 6)), np.zeros(6)
    pose = parts(transform(np.eye(3), np.array([0, 0, 0.6])))
    accumulate_edges(points, normals, outward, *pose, depth, INTRINSICS, PIXEL, 1.0, H, g)
    assert not H.any() and not g.any()


def test_points_on_every_third_row():
    points, _ = sphere()
    R, t = np.eye(3), np.array([0, 0, 0.6])
    chosen = points_on_rows(points, R, t, INTRINSICS, 3)
    rows = np.floor((points[:, 1] / (points[:, 2] + 0.6)) * CAMERA.fy + CAMERA.cy + 0.5)
    np.testing.assert_array_equal(chosen, np.flatnonzero(rows % 3 == 0))
