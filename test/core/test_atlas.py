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
"""Surfaces laid flat: every place has its own texel, at its size."""

import numpy as np
import pytest
import trimesh

from debris_scanner.core.atlas import MARGIN, make_atlas, rasterise

TEXEL = 0.01


def atlas_of(mesh: trimesh.Trimesh, texel=TEXEL):
    return make_atlas(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), texel)


def flat_areas(atlas):
    """Areas (t,) of the triangles, texels."""
    a, b, c = (atlas.xy[atlas.triangles[:, k]].astype(float) for k in range(3))
    u, v = b - a, c - a
    return 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def spring():
    """Two turns of a flat band, a closed body: from above its windings lie behind each other."""
    s = np.linspace(0, 4 * np.pi, 200)
    rows = [
        np.column_stack([r * np.cos(s), r * np.sin(s), 0.1 * s + z])
        for r, z in ((0.5, 0.0), (1.0, 0.0), (1.0, 0.05), (0.5, 0.05))
    ]
    vertices = np.stack(rows, axis=1).reshape(-1, 3)
    k, side = np.meshgrid(np.arange(len(s) - 1), np.arange(4), indexing='ij')
    a, b = 4 * k + side, 4 * k + (side + 1) % 4
    sides = np.concatenate([np.stack(x, axis=-1).reshape(-1, 3) for x in ((a, a + 4, b), (b, a + 4, b + 4))])
    n = len(vertices) - 4
    ends = [[0, 1, 2], [0, 2, 3], [n, n + 2, n + 1], [n, n + 3, n + 2]]
    return trimesh.Trimesh(vertices, np.concatenate([sides, ends]), process=False)


BODIES = {
    'box': trimesh.creation.box((0.613, 1.037, 0.325)),
    'sphere': trimesh.creation.icosphere(4, 0.5),
    'torus': trimesh.creation.torus(0.5, 0.2),
    'spring': spring(),
}


@pytest.mark.parametrize('name', BODIES)
def test_every_triangle_keeps_its_corners_and_gets_texels_of_its_own(name):
    mesh = BODIES[name]
    atlas = atlas_of(mesh)
    assert (atlas.vertices[atlas.triangles] == mesh.faces).all()
    faces = atlas.faces()
    got, wanted = np.bincount(faces[faces >= 0], minlength=len(mesh.faces)), flat_areas(atlas)
    assert got.sum() == pytest.approx(wanted.sum(), rel=0.03)
    # what is large on the image is not hidden by another part
    assert (got[wanted > 4] > 0).all()
    assert (atlas.xy >= MARGIN - 1e-3).all()
    assert (atlas.xy <= np.array([atlas.width, atlas.height]) - MARGIN).all()


def test_flat_sides_are_not_distorted():
    turned = BODIES['box'].copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1, 2, 3]))
    for mesh in (BODIES['box'], turned):
        atlas = atlas_of(mesh)
        assert len(atlas.vertices) == 24  # six charts of four corners
        ends = atlas.xy[atlas.triangles].astype(float)
        lengths = np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=2) * TEXEL
        corners = mesh.triangles
        assert lengths == pytest.approx(
            np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), rel=1e-4
        )


def test_charts_keep_apart():
    """Interpolation in one chart never asks a texel of another one."""
    atlas = atlas_of(BODIES['torus'])
    charts = trimesh.graph.connected_component_labels(
        np.concatenate([atlas.triangles[:, :2], atlas.triangles[:, 1:]]), node_count=len(atlas.vertices)
    )
    faces = atlas.faces()
    of = np.where(faces >= 0, charts[atlas.triangles[faces, 0]], -1)
    for axis in (0, 1):
        for step in range(1, 2 * MARGIN + 1):
            a, b = of.take(range(step, of.shape[axis]), axis), of.take(range(of.shape[axis] - step), axis)
            assert ((a == b) | (a < 0) | (b < 0)).all()


def test_the_image_is_not_wasted():
    faces = atlas_of(BODIES['sphere']).faces()
    assert (faces >= 0).mean() > 0.4


def test_the_same_mesh_gives_the_same_atlas():
    one, other = atlas_of(BODIES['torus']), atlas_of(BODIES['torus'])
    assert one.xy.tobytes() == other.xy.tobytes()
    assert (one.width, one.height) == (other.width, other.height)


def test_the_largest_value_is_on_top():
    points = np.array(
        [[0, 0, 1], [8, 0, 1], [0, 8, 1], [0, 0, 2], [4, 0, 2], [0, 4, 2], [0, 0, 9], [9, 0, 0], [0, 9, 9]],
        np.float32,
    )
    face, top = rasterise(points, np.arange(9, dtype=np.int32).reshape(3, 3), 6, 12)
    v, u = np.mgrid[:6, :12]
    assert (face == np.where(u + v <= 4, 1, np.where(u + v <= 8, 0, -1))).all()  # the third reaches behind
    assert (top == face + 1).all()


def test_values_are_linear_on_a_triangle_that_is_partly_outside():
    points = np.array([[-50, -50, 1], [150, -50, 3], [-50, 150, 5]], np.float32)
    face, top = rasterise(points, np.array([[0, 1, 2]], np.int32), 40, 40)
    v, u = np.mgrid[:40, :40]
    assert (face == 0).all()
    assert top == pytest.approx(1 + (u + 50) * 0.01 + (v + 50) * 0.02, rel=1e-5)
