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

"""Edges of the target are distinguished from rounded sides, and constrain a flat face sideways."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import apply
from debris_scanner.registration.projective import linearise, register
from debris_scanner.sensing.normals import NormalSettings, fit_normals
from debris_scanner.sensing.views import View

CAMERA = Camera(525.0, 525.0, 80.0, 80.0, 160, 160)
V, U = np.indices((160, 160))
RAY = np.stack([(U - 80) / 525, (V - 80) / 525, np.ones((160, 160))], axis=-1)


def view(depth):
    depth = depth.astype(np.float32)
    fitted, normals = fit_normals(depth, CAMERA, NormalSettings())
    return View(TargetFrame(1, CAMERA, depth, fitted, normals, None))


def plate(x=0.0, y=0.0, half=0.08, tilt=0.0):
    """A square plate 0.8 m away, tilted about the vertical."""
    z = 0.8 / (1 + np.tan(tilt) * RAY[..., 0])
    inside = (np.abs(RAY[..., 0] * z - x) < half) & (np.abs(RAY[..., 1] * z - y) < half)
    return np.where(inside, z, 0)


def ball(radius=0.09):
    b = (RAY * [0, 0, 0.85]).sum(-1) / (RAY**2).sum(-1)
    c = b**2 - (0.85**2 - radius**2) / (RAY**2).sum(-1)
    return np.where(c > 0, b - np.sqrt(np.maximum(c, 0)), 0)


def test_a_plates_rim_is_its_edge_and_a_balls_is_not():
    flat, round_ = view(plate()), view(ball())
    assert flat.rim.edge.mean() > 0.9
    assert round_.rim.edge.mean() < 0.05
    assert len(round_.rim.points) > 50


def test_where_the_image_ends_the_target_does_not():
    cut = view(plate(x=-0.1))  # a quarter of it lies beyond the left edge
    np.testing.assert_array_equal(cut.open_sides, [True, False, False, False])
    column = 525 * cut.rim.points[:, 0] / cut.rim.points[:, 2] + 80
    assert (column < 2).sum() <= 2  # of the upper and of the lower edge
    assert not cut.edges.index[:, 0].any()
    assert not view(plate()).open_sides.any()


def test_what_projects_out_of_the_image_contradicts_no_view():
    whole, cut, beside = view(plate()), view(plate(x=-0.1)), view(plate(x=-0.04))
    T = np.eye(4)
    T[0, 3] = -0.1
    assert linearise(whole, T, cut, np.eye(4), 5.5).stats.outside_mask == 0
    T[0, 3] = 0.02
    assert linearise(whole, T, beside, np.eye(4), 5.5).stats.outside_mask > 50


@pytest.mark.parametrize('tilt', [0.0, 0.6])
def test_rim_points_lie_on_the_true_outline(tilt):
    """Wherever between two pixels it runs, and however oblique the plate."""
    right = []
    for half in np.arange(0.06, 0.0615, 0.0001):  # over one pixel
        v = view(plate(half=half, tilt=tilt))
        points = v.rim.points[(v.rim.edge == 1) & (np.abs(v.rim.points[:, 1]) < 0.04)]
        right.append(np.abs(points[:, 0]).mean() - half)
    pixel = 0.8 / 525
    # the simulated sensor's outermost pixels return by half, so they lie further in than these do
    assert -0.1 * pixel < np.mean(right) < 0.5 * pixel


@pytest.mark.parametrize('shift', [(0.004, 0.0), (0.0, -0.003), (0.002, 0.002)])
def test_a_shifted_plate_is_pulled_back_by_its_edges(shift):
    a, b = view(plate()), view(plate(*shift))
    T, _ = register(b, np.eye(4), a, np.eye(4))
    found = apply(T, np.array([*shift, 0.8]))
    np.testing.assert_allclose(found[:2], 0, atol=0.5 * 0.8 / 525)  # half a pixel: these have no noise


@pytest.mark.parametrize('shift', [0.002, -0.003])
def test_edges_hold_a_plate_of_which_a_part_is_hidden(shift):
    """Its left part is covered: that outline pulls nowhere, the right edge does."""
    shown = plate(x=shift)
    columns = np.nonzero(shown.any(axis=0))[0]
    shown[:, : columns[len(columns) // 3]] = 0
    hidden, whole = view(shown), view(plate())
    hidden.unoccluded = False
    T, _ = register(hidden, np.eye(4), whole, np.eye(4))
    assert abs(apply(T, np.array([shift, 0.0, 0.8]))[0]) < 0.5 * 0.8 / 525
