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
"""Spheres seen in colour by small cameras all around them: the texture shows what the views show."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from synthetic import CAMERA, rays, sphere_depth, target_frame

from debris_scanner.core.frames import ClosedMesh
from debris_scanner.core.geometry import apply, exp_so3, inverse, transform
from debris_scanner.modelling.texture import textured

RADIUS, RANGE = 0.1, 0.6
AROUND = [2 * np.pi * k / 12 for k in range(12)]


def paint(points):
    """Colours (n, 3) of points of the target."""
    return 128 + 80 * np.sin(np.asarray(points) * [40, 50, 60] + [0, 1, 2])


def ball(centre=(0.0, 0.0, 0.0), radius=RADIUS, observed=lambda p: np.ones(len(p), bool)):
    mesh = trimesh.creation.icosphere(5, radius)
    vertices = mesh.vertices + centre
    middle = vertices[mesh.faces].mean(axis=1)
    return ClosedMesh(vertices.astype(np.float32), mesh.faces.astype(np.int32), observed(middle))


def seen_from(angle, gain=1.0, bodies=(((0.0, 0.0, 0.0), RADIUS),), painted=paint):
    """A frame and its pose, the sensor turned about the target's y axis."""
    T_sensor_target = transform(exp_so3(np.array([0, angle, 0])), np.array([0, 0, RANGE]))
    depths = [sphere_depth(apply(T_sensor_target, np.array([c]))[0], r) for c, r in bodies]
    depth = np.min([np.where(d > 0, d, np.float32(np.inf)) for d in depths], axis=0)
    depth = np.where(np.isfinite(depth), depth, np.float32(0))
    points = apply(inverse(T_sensor_target), (rays() * depth[..., None]).reshape(-1, 3))
    rgb = np.where(depth[..., None] > 0, painted(points).reshape(*depth.shape, 3) * gain, 0)
    frame = target_frame(depth, rgb=np.clip(np.rint(rgb), 0, 255).astype(np.uint8))
    return frame, inverse(T_sensor_target)


def surface(mesh):
    """Points (n, 3) of the texels on the surface, their triangles (n,) and colours (n, 3): at the middles."""
    t = mesh.texture
    height, width = t.image.shape[:2]
    middle = t.uv[t.triangles].mean(axis=1) * [width, height] - 0.5
    columns, rows = np.rint(middle).astype(int).T
    return mesh.vertices[mesh.triangles].mean(axis=1), t.image[rows, columns].astype(float)


def around_y(points):
    """Which points all the views of AROUND see from above."""
    return np.abs(points[:, 1]) < 0.7 * RADIUS


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_texture_shows_the_paint():
    mesh = textured(ball(), [seen_from(a) for a in AROUND])
    points, found = surface(mesh)
    seen = around_y(points)
    assert rms(found[seen] - paint(points[seen])) < 2  # middles of triangles are half a texel off
    assert mesh.texture.observed.all()
    # two texels a pixel along an edge, where the surface faces the direction it is seen along
    pixel = np.median([frame.footprint for frame, _ in [seen_from(0)]])
    texels = np.count_nonzero(mesh.texture.image.any(axis=2))
    assert texels > 0.6 * 4 * 4 * np.pi * RADIUS**2 / pixel**2


def test_the_same_views_give_the_same_bytes():
    frames = [seen_from(a) for a in AROUND[:4]]
    one, other = textured(ball(), frames).texture, textured(ball(), frames).texture
    for field in dataclasses.fields(one):
        assert getattr(one, field.name).tobytes() == getattr(other, field.name).tobytes()


def test_without_colour_there_is_no_texture():
    mesh = ball()
    frames = [(dataclasses.replace(f, rgb=None), T) for f, T in (seen_from(a) for a in AROUND[:3])]
    assert textured(mesh, frames) is mesh


def test_exposures_are_evened():
    rng = np.random.default_rng(2)
    gains = rng.uniform(0.7, 1.1, (len(AROUND), 3))
    frames = [seen_from(a, g) for a, g in zip(AROUND, gains, strict=True)]
    points, found = surface(textured(ball(), frames))
    seen = around_y(points)
    true = paint(points[seen])
    one_gain = (found[seen] * true).sum(axis=0) / (true**2).sum(axis=0)
    assert one_gain == pytest.approx(np.exp(np.log(gains).mean(axis=0)), rel=0.02)
    assert rms(found[seen] / one_gain - true) < 3


def test_one_strange_view_does_not_spoil_the_exposures():
    """A highlight on a part of a view is no exposure."""

    def glossy(points):
        return np.where((points[:, 0] > 0.02)[:, None], 250, paint(points))

    frames = [seen_from(a, painted=glossy if k == 0 else paint) for k, a in enumerate(AROUND)]
    points, found = surface(textured(ball(), frames))
    # the parts that this view shares with others without the highlight
    seen = around_y(points) & (points[:, 0] < 0)
    assert rms(found[seen] - paint(points[seen])) < 3


def test_what_nobody_saw_is_filled_smoothly():
    mesh = ball(observed=lambda p: p[:, 2] < 0)
    points, found = surface(textured(mesh, [seen_from(0)]))
    far = points[:, 2] > 0.05
    rim = (np.abs(points[:, 2] + 0.03) < 0.01) & ~far
    assert (found[far] >= found[rim].min(axis=0) - 1).all()
    assert (found[far] <= found[rim].max(axis=0) + 1).all()
    # harmonic: no steps between neighbours
    nearest = cKDTree(points[far]).query(points[far], k=2)[1][:, 1]
    assert np.abs(found[far] - found[far][nearest]).max() < 4


def test_what_fills_gaps_is_marked():
    texture = textured(ball(observed=lambda p: p[:, 2] < 0), [seen_from(0)]).texture
    assert texture.observed.mean() == pytest.approx(0.5, abs=0.1)


def test_what_is_hidden_takes_no_colour_of_what_hides_it():
    near = ((0.0, 0.0, -0.2), 0.03)
    front, behind = ball(*near), ball()
    mesh = ClosedMesh(
        np.concatenate([front.vertices, behind.vertices]),
        np.concatenate([front.triangles, behind.triangles + len(front.vertices)]),
        np.concatenate([front.observed, behind.observed]),
    )

    def painted(points):
        return np.where((points[:, 2] < -0.15)[:, None], [250.0, 20, 20], [20.0, 20, 250])

    frame = seen_from(0, bodies=(near, ((0.0, 0.0, 0.0), RADIUS)), painted=painted)
    points, found = surface(textured(mesh, [frame]))
    of_front = np.arange(len(points)) < len(front.triangles)
    facing = points[:, 2] < -0.21
    assert np.abs(found[of_front & facing] - [250, 20, 20]).max() < 2
    assert np.abs(found[~of_front] - [20, 20, 250]).max() < 2


def test_what_stands_in_front_and_is_no_target_leaves_no_colour():
    """A hand before the target has no depth in its frame, but colour."""
    frame, T = seen_from(0)
    depth, rgb = frame.depth.copy(), frame.rgb.copy()
    depth[:, : CAMERA.width // 2], rgb[:, : CAMERA.width // 2] = 0, 255
    frames = [(target_frame(depth, rgb=rgb), T)]
    points, found = surface(textured(ball(), frames))
    seen = (points[:, 2] < -0.05) & (points[:, 0] > 0.005)
    assert rms(found[seen] - paint(points[seen])) < 2
    assert found.max() < 215


def test_near_views_count_more_than_far_ones():
    """A view has pixels by the square of its nearness: three far ones do not outvote it."""

    def striped(points):
        return 120 + 40 * np.sign(np.sin(points[:, :1] * 300)) * np.ones(3)

    far = [seen_from(0, painted=lambda p: np.full((len(p), 3), 120.0)) for _ in range(3)]
    T_sensor_target = transform(np.eye(3), np.array([0, 0, RANGE / 2]))
    depth = sphere_depth((0.0, 0.0, RANGE / 2), RADIUS)
    places = apply(inverse(T_sensor_target), (rays() * depth[..., None]).reshape(-1, 3))
    near = target_frame(depth, rgb=np.rint(striped(places)).reshape(*depth.shape, 3).astype(np.uint8))
    points, found = surface(textured(ball(), [*far, (near, inverse(T_sensor_target))]))
    facing = points[:, 2] < -0.08
    on = striped(points)[:, 0] > 120
    share = (RANGE - RADIUS) ** 2 / (RANGE / 2 - RADIUS) ** 2
    contrast = np.median(found[facing & on]) - np.median(found[facing & ~on])
    assert contrast == pytest.approx(80 * share / (share + 3), rel=0.1)
