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

"""Porous images: told from whole ones, planes fitted through the pores, no evidence of what is not there."""

import dataclasses

import numpy as np
import pytest
from synthetic import plane_depth, sphere_depth, target_frame

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import exp_se3, rotation_angle
from debris_scanner.registration.projective import linearise, register
from debris_scanner.sensing.normals import FILL_REACH_PX, LEAST_NEIGHBOURS, filled, is_porous, outline
from debris_scanner.sensing.views import SAMPLE_STRIDE, View

FINE = Camera(525.0, 525.0, 159.5, 119.5, 320, 240)


def riddled(depth, share, seed=0):
    """The same, a share of its pixels gone."""
    return np.where(np.random.default_rng(seed).random(depth.shape) < share, 0, depth).astype(np.float32)


@pytest.mark.parametrize(('share', 'porous'), [(0.0, False), (0.3, False), (0.6, True), (0.8, True)])
def test_most_of_what_the_outline_holds_must_be_missing(share, porous):
    depth = riddled(sphere_depth(), share)
    assert is_porous(depth, outline(depth)) == porous


def test_pores_take_the_depth_around_them():
    plane = plane_depth((0.3, 0.2, -1.0), 0.6)
    holed = riddled(plane, 0.7)
    full = filled(holed, 0.02)
    np.testing.assert_array_equal(full[holed > 0], holed[holed > 0])
    inner = (slice(FILL_REACH_PX, -FILL_REACH_PX),) * 2
    assert (full[inner] > 0).mean() > 0.99
    assert np.abs(full - plane)[inner][full[inner] > 0].max() < 0.004  # of up to 0.8 mm a pixel, three away


def test_a_pore_between_two_surfaces_belongs_to_the_nearer_one():
    depth = np.full((9, 9), 0.9, np.float32)
    depth[:, :4] = 0.6
    depth[4, 4] = 0
    assert filled(depth, 0.02)[4, 4] == pytest.approx(0.6)


def test_a_few_specks_fill_nothing():
    depth = np.zeros((9, 9), np.float32)
    depth[3, 3 : 2 + LEAST_NEIGHBOURS] = 0.6
    np.testing.assert_array_equal(filled(depth, 0.02), depth)


def test_planes_are_fitted_through_the_pores():
    depth = riddled(sphere_depth((0, 0, 0.6), 0.1, FINE), 0.65)
    frame = target_frame(depth, camera=FINE)
    fitted = frame.depth_fit > 0
    assert fitted.sum() > 2 * (depth > 0).sum()
    v, u = np.nonzero(fitted)
    points = FINE.back_project(frame.depth_fit)[v, u]
    outwards = (points - [0, 0, 0.6]) / np.linalg.norm(points - [0, 0, 0.6], axis=1)[:, None]
    facing = outwards[:, 2] < -0.5
    off = np.degrees(np.arccos(np.clip((frame.normals[v, u] * outwards).sum(1), -1, 1)))[facing]
    assert np.median(off) < 4
    assert np.abs(np.linalg.norm(points - [0, 0, 0.6], axis=1) - 0.1)[facing].max() < 0.004


def test_a_porous_view_lends_all_its_points_and_no_outline():
    whole = View(target_frame(sphere_depth()))
    view = View(target_frame(riddled(sphere_depth(), 0.65)))
    assert view.porous
    assert not whole.porous
    assert len(view.points) > len(whole.points) * 0.2 * SAMPLE_STRIDE**2
    aside = exp_se3(np.array([0, 0, 0, 0.05, 0, 0]))
    assert linearise(whole, aside, whole, np.eye(4), 0.03).agreement.outside > 0.1
    beside = linearise(whole, aside, view, np.eye(4), 0.03).agreement
    assert beside.outside == 0
    assert beside.points == beside.visible - beside.hidden + beside.occluded


def test_riddled_views_register_as_whole_ones_do(recording):
    def error(share):
        frames = [
            target_frame(riddled(recording.targets[k].depth, share, k), k, recording.targets[k].camera)
            for k in (0, 4)
        ]
        a, b = (View(f) for f in frames)
        assert a.porous == (share > 0.5)
        T, _ = register(b, exp_se3(np.full(6, 0.01)) @ recording.pose(4), a, recording.pose(0))
        E = np.linalg.inv(recording.pose(4)) @ T
        return np.degrees(rotation_angle(E[:3, :3]))

    assert error(0.0) < 0.3
    assert error(0.65) < 1.0


def test_of_a_porous_view_a_fifth_must_be_met(recording):
    whole, view = (
        View(recording.targets[0]),
        View(target_frame(riddled(recording.targets[0].depth, 0.65), 0, recording.targets[0].camera)),
    )
    met = linearise(whole, recording.pose(0), view, recording.pose(0), 0.012).agreement
    assert met.overlap > 0.9
    little = dataclasses.replace(
        met, matched=0.1 * met.points, visible=0.1 * met.points, hidden=0.0, occluded=0.0
    )
    assert little.where_measured().overlap == pytest.approx(0.1)
    more = dataclasses.replace(little, matched=0.3 * met.points, visible=0.3 * met.points)
    assert more.where_measured().overlap == pytest.approx(1)
