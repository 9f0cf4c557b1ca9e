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

"""Outliers, mesh and normals of the thesis's model, against PCL."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.research.thesis.refiner import (
    RefinerSettings,
    merge,
    outward,
    refine,
    triangulate,
    without_outliers,
)


def sphere(n=9000, radius=0.08, noise=3e-4, seed=3):
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return d * (radius + noise * rng.normal(size=(n, 1))), d


def mesh_area(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_outliers_are_those_of_pcl(golden):
    z = np.load(golden / 'refine.npz')
    assert np.array_equal(without_outliers(z['merged_voxel']), z['sor_keep'])


@pytest.mark.parametrize('order', [2, 5])
def test_mesh_has_the_area_of_greedy_projection(golden, order):
    z = np.load(golden / 'refine.npz')
    points, normals = z[f'mls{order}'][:, :3].astype(float), z[f'mls{order}'][:, 3:6].astype(float)
    triangles = triangulate(points, outward(points, normals, None), RefinerSettings())
    area = mesh_area(points, z[f'gp3_mls{order}'].astype(int))
    assert area == pytest.approx(float(z['refine_meta'][5 if order == 2 else 8]), rel=1e-4)
    assert mesh_area(points, triangles) == pytest.approx(area, rel=0.05)


def test_a_noisy_sphere_becomes_a_smooth_one_with_outward_normals():
    points, directions = sphere()
    stray = np.array([[0.2, 0, 0], [0, 0.15, 0], [0.0, 0, 0.0]])
    settings = RefinerSettings(greedy_gaps=False, order=2, ball_radii=(0.003, 0.006))
    surface = refine(np.vstack([points, stray]), np.vstack([directions, stray * 0 + 1]), settings)
    radius = np.linalg.norm(surface.points, axis=1)
    assert abs(radius.mean() - 0.08) < 1e-4
    assert radius.std() < 2.5e-4
    assert radius.max() < 0.09  # the strays are gone
    assert radius.min() > 0.07
    assert ((surface.normals * surface.points).sum(axis=1) > 0).all()
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    assert ((np.cross(b - a, c - a) * a).sum(axis=1) > 0).mean() > 0.999  # counter-clockwise from outside
    assert mesh_area(surface.points, surface.triangles) == pytest.approx(4 * np.pi * 0.08**2, rel=0.05)


def test_greedy_gaps_leave_surface_out():
    points, directions = sphere(4000)
    full = refine(points, directions, RefinerSettings(greedy_gaps=False, ball_radii=(0.003, 0.006)))
    gaps = refine(points, directions, RefinerSettings(greedy_gaps=True, ball_radii=(0.003, 0.006)))
    assert np.array_equal(full.points, gaps.points)
    area = [mesh_area(s.points, s.triangles) for s in (full, gaps)]
    assert area[1] < 0.95 * area[0]


def test_normals_agree_without_knowing_the_sensor():
    points, directions = sphere(2000, noise=0)
    rng = np.random.default_rng(0)
    mixed = directions * rng.choice([-1.0, 1.0], (len(directions), 1))
    assert ((outward(points, mixed, None) * directions).sum(axis=1) > 0).all()


def test_too_few_points_make_no_surface():
    assert refine(np.zeros((30, 3))) is None


def test_merged_points_look_at_their_sensor():
    T = transform(exp_so3(np.array([0, 1.0, 0])), np.array([0.0, 0, -0.8]))
    points, towards = merge([np.array([[0.0, 0, 0.8]])], [T])
    assert np.allclose(points[0], T[:3, :3] @ [0, 0, 0.8] + T[:3, 3])
    assert np.allclose(towards[0], -T[:3, :3] @ [0, 0, 1.0])


def test_defaults_are_those_of_section_3_2():
    s = dataclasses.asdict(RefinerSettings())
    assert (s['voxel'], s['outlier_neighbours'], s['outlier_sigma'], s['order']) == (0.002, 50, 3.0, 5)
