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

"""Normals and smoothed depth against exactly known surfaces, also of porous images.

Porous images are detected, planes are fitted through the pores, and missing pixels are no evidence.
"""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import CAMERA, plane_depth, rays, sphere_depth, target_frame

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import exp_se3, rotation_angle
from debris_scanner.registration.projective import linearise, register
from debris_scanner.sensing.normals import (
    FILL_REACH_PX,
    LEAST_NEIGHBOURS,
    NormalSettings,
    filled,
    fit_normals,
    is_porous,
    outline,
)
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
    assert linearise(whole, aside, whole, np.eye(4), 14.0).stats.silhouette_violation_ratio > 0.04
    beside = linearise(whole, aside, view, np.eye(4), 14.0).stats
    assert beside.silhouette_violation_ratio == 0
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
    met = linearise(whole, recording.pose(0), view, recording.pose(0), 8.0).stats
    assert met.overlap > 0.9
    little = dataclasses.replace(
        met, matched=0.1 * met.points, visible=0.1 * met.points, hidden=0.0, occluded=0.0
    )
    assert little.where_measured().overlap == pytest.approx(0.1)
    more = dataclasses.replace(little, matched=0.3 * met.points, visible=0.3 * met.points)
    assert more.where_measured().overlap == pytest.approx(1)


SETTINGS = NormalSettings()


def angles(normals, true):
    return np.degrees(np.arccos(np.clip((normals * true).sum(-1), -1, 1)))


@settings(max_examples=25, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(0.4, 1.0))
def test_planes_are_fitted_exactly(x, y, distance):
    normal = np.array([x, y, -1.0]) / np.linalg.norm([x, y, -1.0])
    camera = Camera(262.5, 262.5, 19.5, 19.5, 40, 40)
    depth = plane_depth(normal, distance, camera)
    # neighbours a jump away count as another surface, so steeper planes have no fit
    fitted, normals = fit_normals(depth, camera, NormalSettings())
    inner = slice(6, -6)
    assert angles(normals, normal)[inner, inner].max() < 0.05
    np.testing.assert_allclose(fitted[inner, inner], depth[inner, inner], rtol=1e-5)


def test_sphere():
    centre, radius = np.array([0.02, -0.01, 0.6]), 0.1
    depth = sphere_depth(centre, radius)
    fitted, normals = fit_normals(depth, CAMERA, SETTINGS)
    points = rays() * depth[..., None]
    true = (points - centre) / radius
    facing = -(true * rays()).sum(-1) / np.linalg.norm(rays(), axis=-1)
    inner = (depth > 0) & (facing > 0.6)
    assert inner.sum() > 1500
    assert angles(normals, true)[inner].max() < 1.5
    assert np.abs(fitted - depth)[inner].max() < 3e-4


def test_normals_are_of_unit_length_and_face_the_sensor(recording):
    for target in recording.targets[::30]:
        fit = target.depth_fit > 0
        assert fit.sum() > 5000
        np.testing.assert_allclose(np.linalg.norm(target.normals[fit], axis=-1), 1, atol=1e-5)
        assert ((target.normals * rays(target.camera)).sum(-1)[fit] < 0).all()
        assert np.all(target.normals[~fit] == 0)


def test_noise_is_averaged_over_the_window():
    rng = np.random.default_rng(2)
    camera = Camera(525.0, 525.0, 79.5, 59.5, 160, 120)
    normal = np.array([0.3, 0.2, -1.0]) / np.linalg.norm([0.3, 0.2, -1.0])
    depth = plane_depth(normal, 0.7, camera)
    # a Kinect's disparity: 1/8 px at 75 mm base line
    noisy = 1 / (1 / depth + rng.normal(scale=0.125 / (525 * 0.075), size=depth.shape))
    fitted, normals = fit_normals(noisy.astype(np.float32), camera, SETTINGS)
    inner = (slice(8, -8), slice(8, -8))
    assert np.median(angles(normals, normal)[inner]) < 4
    error = np.abs(fitted - depth)[inner]
    assert np.median(error) < 0.35 * np.median(np.abs(noisy - depth)[inner])


def test_a_step_in_depth_is_not_bridged():
    depth = np.full((60, 80), 0.6, np.float32)
    camera = Camera(262.5, 262.5, 39.5, 29.5, 80, 60)
    jump = SETTINGS.max_jump * 0.6 / camera.focal
    depth[:, 40:] = 0.6 + 2 * jump
    fitted, normals = fit_normals(depth, camera, SETTINGS)
    np.testing.assert_allclose(fitted[depth > 0], depth[depth > 0], atol=1e-6)
    assert angles(normals, np.array([0, 0, -1.0])).max() < 0.05
    # below the jump the two sides are one slanted surface
    depth[:, 40:] = 0.6 + 0.5 * jump
    assert angles(fit_normals(depth, camera, SETTINGS)[1], np.array([0, 0, -1.0])).max() > 10


@pytest.mark.parametrize('shape', ['pixel', 'line', 'nothing'])
def test_too_little_surface_has_no_fit(shape):
    depth = np.zeros((40, 40), np.float32)
    if shape == 'pixel':
        depth[20, 20] = 0.7
    elif shape == 'line':
        depth[20] = 0.7
    fitted, normals = fit_normals(depth, Camera(100, 100, 20, 20, 40, 40), SETTINGS)
    assert not fitted.any()
    assert not normals.any()


def test_input_is_left_as_it_was():
    depth = sphere_depth()
    before = depth.copy()
    fit_normals(depth, CAMERA, SETTINGS)
    np.testing.assert_array_equal(depth, before)
