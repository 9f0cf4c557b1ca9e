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

"""Fusion of exactly posed views of exactly known surfaces."""

import numpy as np
import pytest
from scipy import ndimage
from synthetic import rays, sphere_depth, target_frame

from debris_scanner.core.geometry import exp_so3, inverse, transform
from debris_scanner.modelling.fusion import (
    FusionSettings,
    Volume,
    blurred,
    bounds,
    eroded,
    gaussian,
    zero_level,
)

RADIUS = 0.08
FOOTPRINT = 0.002  # m, of a pixel: the sensor is coarse, and near
SETTINGS = FusionSettings()
DISTANCE = 0.5


def ring(count=8, axis=(0.0, 1.0, 0.0), depth=None):
    """Poses T_target_sensor of sensors around the origin, and what each sees of the sphere there."""
    frame = target_frame(sphere_depth((0, 0, DISTANCE), RADIUS) if depth is None else depth)
    T_sensor_target = [
        transform(exp_so3(2 * np.pi * k / count * np.asarray(axis)), np.array([0, 0, DISTANCE]))
        for k in range(count)
    ]
    return [(frame, inverse(T)) for T in T_sensor_target]


def all_around():
    return ring(8) + ring(8, (1.0, 0.0, 0.0))


def fused(posed, settings=SETTINGS):
    volume = Volume(*bounds(posed), settings, FOOTPRINT)
    for frame, T in posed:
        volume.integrate(frame, T)
    volume.integrate_thin(posed)
    return volume.surface()


def boom_depth(radius, half_length=0.05):
    """Depth (h, w) float32 of an upright boom at the origin, 0 beside it."""
    d = rays()
    a = d[..., 0] ** 2 + 1
    root = DISTANCE**2 - a * (DISTANCE**2 - radius**2)
    t = (DISTANCE - np.sqrt(np.maximum(root, 0))) / a
    return np.where((root > 0) & (np.abs(t * d[..., 1]) < half_length), t, 0).astype(np.float32)


@pytest.fixture(scope='module')
def sphere():
    return fused(all_around())


def test_sphere_comes_out_round_and_in_place(sphere):
    r = np.linalg.norm(sphere.vertices, axis=1)
    assert np.abs(r - RADIUS).mean() < 2e-4
    assert np.abs(r - RADIUS).max() < 1.5e-3
    assert np.abs(sphere.vertices.mean(axis=0)).max() < 1e-3
    # seen from everywhere, it has no hole worth the name
    directions = sphere.vertices / r[:, None]
    grid = np.random.default_rng(0).normal(size=(500, 3))
    grid /= np.linalg.norm(grid, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.clip((grid @ directions.T).max(axis=1), -1, 1))).max() < 8


def test_normals_and_triangles_look_outward(sphere):
    outward = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(sphere.normals, axis=1), 1, atol=1e-5)
    assert np.median((sphere.normals * outward).sum(1)) > 0.99
    corners = sphere.vertices[sphere.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((face * corners.mean(axis=1)).sum(1) > 0).mean() > 0.999
    assert sphere.triangles.dtype == np.int32
    assert set(np.unique(sphere.triangles)) == set(range(len(sphere.vertices)))


def test_only_what_was_seen_is_surface():
    front = fused(ring(1) * 3)
    # the sensor stands at z = -DISTANCE of the target frame: the far half was never seen
    assert front.vertices[:, 2].max() < 0.01
    assert front.vertices[:, 2].min() == pytest.approx(-RADIUS, abs=1e-3)


def test_a_boom_two_pixels_thick_is_surface_of_its_thickness():
    posed = ring(24, depth=boom_depth(FOOTPRINT))
    assert not (posed[0][0].depth_fit > 0).any()  # no plane fits
    vertices = fused(posed).vertices
    assert np.abs(np.hypot(vertices[:, 0], vertices[:, 2]) - FOOTPRINT).max() < FOOTPRINT / 2
    covered = np.unique(np.floor(vertices[:, 1] / FOOTPRINT))
    assert len(covered) >= 43  # of 50 px: within three voxels of the ends the field is not known all around


def test_what_other_views_look_past_is_no_boom():
    """Each view has pixels that fly beside the sphere, at another place than those of the others."""
    depth = sphere_depth((0, 0, DISTANCE), RADIUS)
    depth[40:80, 139:141] = DISTANCE
    posed = ring(16, depth=depth)
    assert ((posed[0][0].depth > 0) & (posed[0][0].depth_fit == 0)).sum() >= 80
    assert np.linalg.norm(fused(posed).vertices, axis=1).max() < RADIUS + FOOTPRINT


def test_a_single_glance_is_not_enough_where_more_are_asked_for():
    demanding = FusionSettings(min_weight=3.0)
    assert fused(ring(1), demanding) is None
    assert fused(ring(1) * 5, demanding) is not None


def test_observations_are_averaged():
    """Two sensors that disagree by 2 mm put the surface half way."""

    def front(posed):
        """Depth of the surface's middle."""
        vertices = fused(posed).vertices
        return vertices[np.linalg.norm(vertices[:, :2], axis=1) < 0.02, 2].mean()

    ((frame, T),) = ring(1)
    nearer = transform(np.eye(3), np.array([0, 0, -0.002])) @ T
    assert front([(frame, nearer)] * 4) - front([(frame, T)] * 4) == pytest.approx(-0.002, abs=1e-4)
    both = front([(frame, T), (frame, nearer)] * 2)
    assert both - front([(frame, T)] * 4) == pytest.approx(-0.001, abs=2e-4)


def test_large_targets_get_larger_voxels():
    low, high = np.full(3, -1.0), np.full(3, 1.0)
    few = FusionSettings(max_voxels=64)
    volume = Volume(low, high, few, 0.001)
    assert volume.voxel > 0.001
    assert max(volume.weight.shape) <= 64
    assert Volume(low / 100, high / 100, few, 0.001).voxel == 0.001


def test_nothing_integrated_is_no_surface():
    assert Volume(np.full(3, -0.05), np.full(3, 0.05), SETTINGS, FOOTPRINT).surface() is None


def test_bounds_hold_the_surface():
    low, high = bounds(all_around())
    assert (low < -RADIUS + 0.002).all() and (high > RADIUS - 0.002).all()
    assert (low > -RADIUS - 0.02).all() and (high < RADIUS + 0.02).all()


def test_fusion_repeats_itself(sphere):
    again = fused(all_around())
    np.testing.assert_array_equal(again.vertices, sphere.vertices)
    np.testing.assert_array_equal(again.triangles, sphere.triangles)


@pytest.mark.parametrize('value', [0.0, 1e-9, -1e-9])
def test_a_surface_through_voxels_has_no_empty_triangle(value):
    x, y, z = np.ogrid[-280:20, -2:3, -2:3]
    field = np.where(x + y + z == 0, value, np.clip(0.003 * (x + y + z), -0.012, 0.012)).astype(np.float32)
    vertices, triangles, _ = zero_level(field)
    corners = vertices[triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert len(area) and area.min() > 1e-9  # of a voxel's face: what single precision keeps apart
    assert np.abs((vertices - [280, 2, 2]).sum(axis=1)).max() < 0.1


@pytest.mark.parametrize(('sigma', 'truncate'), [(0.0, 3), (0.5, 3), (1.5, 2)])
@pytest.mark.parametrize('flags', [False, True])
def test_a_volume_is_blurred_where_it_is_asked_for(sigma, truncate, flags):
    rng = np.random.default_rng(1)
    values = rng.normal(size=(9, 6, 11)).astype(np.float32)
    values = values > 0 if flags else values
    places = np.flatnonzero(rng.random(values.shape) < 0.6)
    whole = ndimage.gaussian_filter(values.astype(np.float32), sigma, truncate=truncate)
    found = blurred(values, places, gaussian(sigma, truncate))
    np.testing.assert_allclose(found, whole.flat[places], atol=1e-6)


def test_erosion_takes_what_is_beside_nothing():
    flags = np.random.default_rng(2).random((8, 9, 10)) < 0.9
    np.testing.assert_array_equal(eroded(flags), ndimage.binary_erosion(flags))


def test_a_field_is_of_all_frames_so_far():
    posed = all_around()
    volume = Volume(*bounds(posed), SETTINGS, FOOTPRINT)
    volume.integrate(*posed[0])
    first = volume.field()[1].sum()
    assert volume.field() is volume.field()
    for frame, T in posed:
        volume.integrate(frame, T)
    assert volume.field()[1].sum() > first
