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

import dataclasses

import numpy as np
import pytest
from geometry_msgs.msg import Point
from processor_time import processor_seconds
from rclpy.serialization import serialize_message

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import Model
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from msg_adapters.clouds import cloud_message, read_fields
from msg_adapters.errors import MalformedMessage
from msg_adapters.models import (
    depth_offset_message,
    mesh_marker,
    model_message,
    read_depth_offset,
    read_mesh,
    read_model,
)
from msg_adapters.raw_messages import jazzy_types
from msg_adapters.stamps import read_stamp


def sphere(rings: int = 20, radius: float = 0.1) -> Model:
    """A ball: its points are the vertices of its mesh."""
    polar, azimuth = np.meshgrid(
        np.linspace(0.01, np.pi - 0.01, rings),
        np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False),
        indexing='ij',
    )
    normals = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1
    ).reshape(-1, 3)
    index = np.arange(2 * rings * rings).reshape(rings, 2 * rings)
    a, b, c, d = index[:-1], np.roll(index, -1, 1)[:-1], index[1:], np.roll(index, -1, 1)[1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    points = (radius * normals).astype(np.float32)
    rgb = np.random.default_rng(0).integers(0, 256, points.shape, dtype=np.uint8)
    return Model(points, normals.astype(np.float32), points, triangles.astype(np.int32), rgb)


def corners(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return vertices[triangles]


def through_bag(message, name):
    return jazzy_types().deserialize_cdr(serialize_message(message), name)


@pytest.mark.parametrize('bagged', [False, True])
def test_a_model_comes_back(bagged):
    model = sphere()
    cloud, mesh = model_message(model, 5, 'target'), mesh_marker(model, 5, 'target')
    if bagged:
        cloud = through_bag(cloud, 'sensor_msgs/msg/PointCloud2')
        mesh = through_bag(mesh, 'visualization_msgs/msg/Marker')
    back = read_model(cloud, mesh)
    for name in ('points', 'normals', 'rgb'):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
    np.testing.assert_array_equal(
        corners(back.vertices, back.triangles), corners(model.vertices, model.triangles)
    )
    assert len(back.vertices) == len(model.vertices)  # joined again, so neighbours share their corners


def test_without_a_mesh_the_model_is_its_cloud():
    model = sphere()
    back = read_model(model_message(model, 5, 'target'))
    assert back.vertices.shape == back.triangles.shape == (0, 3)


def test_a_model_without_colour_stays_without():
    model = sphere()
    plain = Model(model.points, model.normals, model.vertices, model.triangles)
    assert read_model(model_message(plain, 5, 'target')).rgb is None


@pytest.mark.parametrize('limit', [5000, 800, 100])
def test_a_mesh_too_large_is_coarsened_without_losing_its_shape(limit):
    model = sphere(60)
    assert len(model.triangles) > 5000
    vertices, triangles = read_mesh(mesh_marker(model, 5, 'target', max_triangles=limit))
    assert limit / 5 < len(triangles) <= limit
    corner = corners(vertices.astype(np.float64), triangles)
    volume = np.einsum('ij,ij->', corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6
    # merged vertices lie inside the ball, so it shrinks, but no hole opens and no side is lost
    assert 0.7 < volume / (4 / 3 * np.pi * 0.1**3) < 1
    assert len(mesh_marker(model, 5, 'target', max_triangles=10**6).points) == 3 * len(model.triangles)


@pytest.mark.parametrize('limit', [None, 1000])
def test_the_mesh_has_the_colours_of_its_vertices(limit):
    model = sphere(60)
    rgb = np.zeros((len(model.vertices), 3), np.uint8)
    rgb[model.vertices[:, 2] > 0] = 255, 51, 0
    assert not mesh_marker(model, 5, 'target', limit).colors
    marker = mesh_marker(dataclasses.replace(model, vertex_rgb=rgb), 5, 'target', limit)
    assert len(marker.colors) == len(marker.points)
    high = [(c.r, c.g, c.b, c.a) for p, c in zip(marker.points, marker.colors, strict=True) if p.z > 0.02]
    low = {(c.r, c.g, c.b) for p, c in zip(marker.points, marker.colors, strict=True) if p.z < -0.02}
    np.testing.assert_allclose(high, np.broadcast_to([1.0, 0.2, 0.0, 1.0], (len(high), 4)), atol=1e-6)
    assert low == {(0.0, 0.0, 0.0)}


@pytest.mark.timing
def test_the_corners_of_a_large_mesh_share_their_vertices():
    model = sphere(160)
    assert len(model.triangles) > 100_000
    marker = mesh_marker(model, 5, 'target')

    def a_point_a_corner():
        corners = model.vertices[model.triangles.ravel()].astype(float)
        return [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]

    naive = processor_seconds(a_point_a_corner)
    # a sixth of the points are made, and a list of references: 0.23 when measured
    assert processor_seconds(lambda: mesh_marker(model, 5, 'target')) < naive / 2
    # rclpy takes them one by one, in C: 0.33
    assert processor_seconds(lambda: serialize_message(marker)) < 2 * naive


def test_what_is_no_mesh_is_refused():
    marker = mesh_marker(sphere(5), 5, 'target')
    marker.points = marker.points[:-1]
    with pytest.raises(MalformedMessage, match='is no mesh'):
        read_mesh(marker)
    marker = mesh_marker(sphere(5), 5, 'target')
    marker.type = marker.SPHERE_LIST
    with pytest.raises(MalformedMessage, match='is no mesh'):
        read_mesh(marker)
    marker = mesh_marker(sphere(5), 5, 'target')
    marker.points[4].x = float('nan')
    with pytest.raises(MalformedMessage, match='not finite'):
        read_mesh(marker)


def test_what_is_no_model_is_refused():
    model = sphere(5)
    with pytest.raises(MalformedMessage, match='normal_x'):
        read_model(cloud_message(0, 'f', {axis: np.ones(3, np.float32) for axis in 'xyz'}))
    empty = np.zeros((0, 3), np.float32)
    with pytest.raises(MalformedMessage, match='0 points'):
        read_model(model_message(Model(empty, empty, empty, empty.astype(np.int32)), 0, 'f'))
    model.points[3, 1] = np.inf
    with pytest.raises(MalformedMessage, match='not finite'):
        read_model(model_message(model, 0, 'f'))


OFFSET = DepthOffset(0.037, (-5, 3), 1e-3 * np.random.default_rng(0).normal(size=(9, 6)))


def test_an_offset_comes_back():
    message = depth_offset_message(OFFSET, 123, 'target')
    assert read_stamp(message.header.stamp) == 123
    assert (message.height, message.width) == (6, 9)
    back = read_depth_offset(message)
    assert back.first == OFFSET.first
    assert back.step == pytest.approx(OFFSET.step)
    np.testing.assert_allclose(back.coefficients, OFFSET.coefficients)


def test_each_coefficient_lies_where_it_counts_most():
    single = DepthOffset(0.037, (-5, 3), np.eye(9, 6) * 0)
    single.coefficients[4, 2] = 1e-3
    fields = read_fields(depth_offset_message(single, 0, 'target'), ('x', 'y', 'share'))
    at = np.unravel_index(np.argmax(fields['share']), fields['share'].shape)
    camera = Camera(1000.0, 1000.0, 500.0, 0.0, 1000, 400)
    v, u = np.unravel_index(np.argmax(single.share(camera)), (400, 1000))
    assert (u - 500) / 1000 == pytest.approx(fields['x'][at], abs=1e-3)
    assert v / 1000 == pytest.approx(fields['y'][at], abs=1e-3)


def test_no_offset_is_an_empty_cloud():
    message = depth_offset_message(NO_OFFSET, 5, 'target')
    assert message.width * message.height == 0
    assert read_depth_offset(message) is NO_OFFSET


@pytest.mark.parametrize(
    'offset',
    [
        DepthOffset(0.037, (0, 0), np.full((9, 6), np.nan)),
        DepthOffset(0.037, (0, 0), np.full((9, 6), 0.5)),
        DepthOffset(0.037, (0, 0), np.full((9, 3), 1e-3)),
        DepthOffset(0.037, (0, 0), np.full((300, 6), 1e-3)),
        DepthOffset(-0.037, (0, 0), np.full((9, 6), 1e-3)),
    ],
)
def test_what_is_no_offset_is_refused(offset):
    with pytest.raises(MalformedMessage):
        read_depth_offset(depth_offset_message(offset, 0, 'target'))


@pytest.mark.parametrize('name', ['x', 'share'])
def test_several_coefficients_at_one_place_are_refused(name):
    message = depth_offset_message(OFFSET, 123, 'target')
    next(field for field in message.fields if field.name == name).count = 2
    with pytest.raises(MalformedMessage, match=name):
        read_depth_offset(message)
