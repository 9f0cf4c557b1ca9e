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

"""Closing of exactly known fields, and of a real scan."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import ClosedMesh
from debris_scanner.core.geometry import exp_so3, inverse, transform
from debris_scanner.evaluation.true_surface import TrueSurface
from debris_scanner.modelling import closing
from debris_scanner.modelling.closing import close, open_mesh, split
from debris_scanner.modelling.fusion import FusionSettings, Volume
from debris_scanner.modelling.refinement import integrated
from debris_scanner.sensing.rendering import MeshImages
from debris_scanner.sim import shapes

VOXEL = 0.002
SETTINGS = FusionSettings(voxel=1.0, smoothing=0.0)


def field(distance, half, seen):
    """A volume around the origin whose field is a distance of points (n, 3), known near zero where seen."""
    volume = Volume(np.full(3, -half), np.full(3, half), SETTINGS, VOXEL)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in volume.distance.shape), indexing='ij'), axis=-1)
    points = grid * volume.voxel + volume.origin
    d = distance(points)
    known = (d < volume.truncation) & (d > -volume.inside) & seen(points)
    volume.weight[known] = 1.0
    volume.distance[known] = d[known]
    return volume


def as_trimesh(mesh: ClosedMesh):
    return trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)


def sphere(radius):
    return lambda p: np.linalg.norm(p, axis=-1) - radius


def box(*half):
    def distance(p):
        q = np.abs(p) - half
        return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)

    return distance


def everywhere(p):
    return np.ones(p.shape[:-1], bool)


def check_closed(mesh: ClosedMesh, bodies=1):
    solid = as_trimesh(mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.body_count == bodies
    # a vertex belongs to one fan of triangles
    around = trimesh.graph.connected_components(solid.face_adjacency, min_len=1)
    assert sum(map(len, around)) == len(mesh.triangles)


def test_a_surface_seen_from_all_sides_stays_as_it_is():
    mesh = close(field(sphere(0.05), 0.06, everywhere), [])
    check_closed(mesh)
    assert mesh.observed.all()
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.05).max() < 0.05 * VOXEL
    assert as_trimesh(mesh).volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.005)


def test_an_unseen_cap_is_closed_and_marked():
    mesh = close(field(sphere(0.05), 0.06, lambda p: p[..., 2] < 0.035), [])
    check_closed(mesh)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    assert not mesh.observed[middle[:, 2] > 0.037].any()
    assert mesh.observed[middle[:, 2] < 0.028].all()
    # flat, as a film of soap would: a little inside of the sphere's cap
    missing = np.pi * 0.015**2 * (0.05 - 0.005)
    volume = 4 / 3 * np.pi * 0.05**3
    assert volume - 1.3 * missing < as_trimesh(mesh).volume < volume


def test_the_two_sides_of_a_plate_stay_apart():
    thickness = 2.5 * VOXEL
    mesh = close(field(box(0.04, 0.03, thickness / 2), 0.05, everywhere), [])
    check_closed(mesh)
    inner = np.abs(mesh.vertices[:, :2]).max(axis=1) < 0.02
    assert np.abs(np.abs(mesh.vertices[inner, 2]) - thickness / 2).max() < 0.1 * VOXEL


def test_a_tube_without_its_ends_becomes_a_rod():
    def distance(p):
        return np.maximum(np.hypot(p[..., 0], p[..., 1]) - 0.02, np.abs(p[..., 2]) - 0.05)

    mesh = close(field(distance, 0.06, lambda p: np.abs(p[..., 2]) < 0.046), [])
    check_closed(mesh)
    # closed by a film at each end, where the tube was last seen
    assert 0.08 < as_trimesh(mesh).volume / (np.pi * 0.02**2) < 0.1


def test_specks_and_hollows_are_no_bodies():
    def distance(p):
        speck = np.linalg.norm(p - [0.05, 0.05, 0.05], axis=-1) - 0.003
        return np.minimum(sphere(0.04)(p), speck)

    mesh = close(field(distance, 0.065, everywhere), [])
    check_closed(mesh)
    assert np.linalg.norm(mesh.vertices, axis=1).max() < 0.041


def test_a_boom_whose_root_nobody_saw_is_a_body():
    def distance(p):
        return np.minimum(sphere(0.04)(p + [0.015, 0, 0]), box(0.0025, 0.0025, 0.04)(p - [0.045, 0, 0]))

    mesh = close(field(distance, 0.065, everywhere), [])
    check_closed(mesh, bodies=2)  # a hundredth of the sphere's volume it has not


def test_two_bodies_stay_two():
    def distance(p):
        return np.minimum(sphere(0.02)(p - [0.03, 0, 0]), sphere(0.02)(p + [0.03, 0, 0]))

    check_closed(close(field(distance, 0.06, everywhere), []), bodies=2)


def test_a_field_without_surface_is_not_closed():
    assert close(field(lambda p: np.ones(p.shape[:-1]), 0.05, everywhere), []) is None


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8))
@settings(max_examples=50, deadline=None)
def test_a_cut_mesh_is_the_same_surface(heights):
    cube = trimesh.creation.box()
    vertices, triangles, above = split(cube.vertices, cube.faces.astype(np.int32), np.array(heights))
    cut = trimesh.Trimesh(vertices, triangles, process=False)
    assert cut.is_watertight
    assert cut.volume == pytest.approx(1.0)
    assert cut.area == pytest.approx(6.0)
    assert len(above) == len(triangles)
    if min(heights) > 0 or max(heights) <= 0:
        assert len(triangles) == 12
        assert above.all() == (min(heights) > 0)


def test_what_was_seen_has_a_smooth_edge_and_no_specks():
    mesh = close(field(sphere(0.05), 0.06, lambda p: p[..., 2] < 0.03), [])
    used, triangles = open_mesh(mesh)
    vertices = mesh.vertices[used]
    ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    rim = vertices[np.unique(edges[count == 1])]
    assert rim[:, 2].std() < 0.2 * VOXEL  # a circle, not steps


def test_frames_tell_what_is_free(recording, session_bag):
    """The hulls of the scan's frames close the shuttle's ends about where they are."""
    posed = [(recording.targets[k], recording.pose(k)) for k in range(0, 126, 3)]
    mesh = close(integrated(posed, FusionSettings()), posed)
    check_closed(mesh)
    assert 0.65 < mesh.observed.mean() < 1  # 0.69 to 0.71, by how the voxels lie
    apart = TrueSurface.read(session_bag).distance(mesh.vertices[::50])
    assert np.sqrt(np.mean(apart**2)) < 0.002
    assert apart.max() < 0.02


@pytest.mark.parametrize('lost', [0, 6])
def test_masks_that_lose_their_rim_do_not_hollow_a_body(lost):
    """Real sensors lose pixels along outlines: then many frames look past what lies under the surface."""
    images = MeshImages(*shapes.box((0.1, 0.1, 0.1)))
    camera = Camera(150.0, 150.0, 39.5, 39.5, 80, 80)
    posed = []
    for azimuth in np.radians(np.arange(0, 360, 15)):
        R = exp_so3(np.array([-np.pi / 2 - 0.5, 0, 0])) @ exp_so3(np.array([0, 0, azimuth]))
        T = transform(R, np.array([0, 0, 0.4]))
        frame = images.frame(camera, T)
        kept = frame.depth > 0
        if lost:
            kept = ndimage.binary_erosion(kept, iterations=lost)
        depth, depth_fit = (np.where(kept, d, np.float32(0)) for d in (frame.depth, frame.depth_fit))
        posed.append((dataclasses.replace(frame, depth=depth, depth_fit=depth_fit), inverse(T)))
    distance = box(0.05, 0.05, 0.05)
    volume = field(distance, 0.075, lambda p: np.abs(distance(p)) < 2 * VOXEL)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in volume.distance.shape), indexing='ij'), axis=-1)
    d = distance(grid * volume.voxel + volume.origin)
    known = volume.weight > 0
    free = closing._free(volume, known, known & (d < 0), posed)
    assert free[d < -3 * VOXEL].mean() < 0.02
    assert free[d > 3 * VOXEL].mean() > 0.5


def test_gaps_are_filled_as_if_every_voxel_were_asked_every_time():
    """Threshold dynamics at one resolution, plainly."""
    grid = np.stack(np.meshgrid(*[np.arange(24) - 11.5] * 3, indexing='ij'), axis=-1)
    d = sphere(7)(grid)
    fixed = (np.abs(d) < 2) & (grid[..., 2] < 3) | (d > 6)
    inside = fixed & (d < 0)
    found = inside | ~fixed
    for _ in range(20):
        blurred = ndimage.gaussian_filter(found.astype(np.float32), closing.BLUR, truncate=2)
        found = np.where(fixed, inside, blurred > 0.5)
    assert (found != inside).any()
    ends = ndimage.binary_dilation(inside, iterations=3) & ~ndimage.binary_erosion(inside, iterations=3)
    near = closing._around(closing._interface(inside), fixed, 2, 2)
    np.testing.assert_array_equal(near, np.flatnonzero(ends & ~fixed))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(closing, 'COARSEST', 24)
        patch.setattr(closing, 'ROUNDS', 20)
        np.testing.assert_array_equal(closing._filled(inside, fixed), found)
