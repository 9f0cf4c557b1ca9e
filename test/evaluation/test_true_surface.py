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

""""""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.evaluation.true_surface import TrueSurface
from debris_scanner.io.mesh_files import read_cloud, write_mesh_ply
from debris_scanner.sim.shapes import box, place, sphere
from debris_scanner.sim.surface import sample_mesh
from debris_scanner.sim.targets import make_target

CAMERA = Camera(262.5, 262.5, 159.5, 119.5, 320, 240)
AHEAD = transform(np.eye(3), np.array([0.0, 0.0, 0.8]))


def surface_of(name):
    target = make_target(name)
    return TrueSurface((target.vertices.astype(float), target.triangles))


def cube_frame(depth=0.7, half=True):
    """What a sensor sees of a 0.2 m cube at 0.8 m: its near face, or the left half of it."""
    image = np.zeros((240, 320), np.float32)
    size = round(0.1 / 0.7 * 262.5)
    image[120 - size : 120 + size, 160 - size : 160 if half else 160 + size] = depth
    return DepthFrame(0, image, CAMERA)


@pytest.fixture
def cube():
    return TrueSurface(box((0.2, 0.2, 0.2)))


def test_samples_spread_evenly_over_the_area():
    points = sample_mesh(*box((1, 2, 3)), 22_000)
    for axis, extent, share in ((0, 1, 6 / 22), (1, 2, 3 / 22), (2, 3, 2 / 22)):
        on_face = points[np.isclose(points[:, axis], extent / 2)][:, [i for i in range(3) if i != axis]]
        assert len(on_face) == pytest.approx(share * 22_000, abs=2)
        np.testing.assert_allclose(on_face.mean(axis=0), 0, atol=0.01)
        assert len(np.unique(np.floor(on_face * 5 + 0.5), axis=0)) >= 25 * 6 / extent
    np.testing.assert_array_equal(points, sample_mesh(*box((1, 2, 3)), 22_000))


def test_distances_to_mesh_and_cloud(cube):
    points = np.array([[0.0, 0.0, 0.15], [0.0, 0.0, 0.09]])
    np.testing.assert_allclose(cube.distance(points), [0.05, 0.01], atol=1e-7)
    cloud = TrueSurface(None, np.array([[0.0, 0.0, 0.1], [0.0, 0.03, 0.1]]))
    np.testing.assert_allclose(cloud.distance(points), [0.05, 0.01], atol=1e-12)
    assert np.isinf(TrueSurface(None).distance(points)).all()


def test_three_pixels_make_a_part_seen(cube):
    for _ in range(2):
        assert cube.observe(cube_frame(), AHEAD)
    assert len(cube.seen()) == 0
    cube.observe(cube_frame(), AHEAD)
    # pixels stand 2.7 mm apart, parts are 2 mm across: not every one has met a pixel yet
    face = 40_000 / 12
    assert 0.3 < len(cube.seen()) / face < 0.8
    for dx in (0, 0.0009, 0.0018):
        for dy in (0, 0.0009, 0.0018):
            cube.observe(cube_frame(), transform(np.eye(3), np.array([dx, dy, 0.8])))
    assert 0.9 < len(cube.seen()) / face < 1.1
    # the left half of the near face, whose z is -0.1, and nothing hidden behind it
    seen = cube.seen()
    assert np.median(seen[:, 2]) == pytest.approx(-0.1) and seen[:, 2].max() < -0.095
    assert seen[:, 0].max() < 0.005


def test_pixels_at_another_depth_see_something_else(cube):
    for depth in (0.6, 0.72):
        for _ in range(3):
            assert not cube.observe(cube_frame(depth), AHEAD)
    assert len(cube.seen()) == 0


def test_what_the_target_itself_hides_is_not_seen():
    # two plates 5 mm apart: both agree with the pixels, but the near one hides the far one
    near, far = box((0.3, 0.3, 0.001)), place(box((0.3, 0.3, 0.001)), (0, 0, 0.006))
    plates = TrueSurface(
        (np.concatenate([near[0], far[0]]), np.concatenate([near[1], far[1] + len(near[0])]))
    )
    for _ in range(10):
        plates.observe(cube_frame(0.8), AHEAD)
    assert len(plates.seen()) > 1000 and plates.seen()[:, 2].max() < 0.002


def test_a_cloud_can_be_seen_too():
    near = sample_mesh(*box((0.2, 0.2, 0.2)), 200_000)
    cloud = TrueSurface(None, near[near[:, 2] < -0.0999])
    assert 8_000 < len(cloud.samples) < 13_000  # thinned to 2 mm
    for dx in (0, 0.0009, 0.0018) * 3:
        for dy in (0, 0.0009, 0.0018):
            assert cloud.observe(cube_frame(half=False), transform(np.eye(3), np.array([dx, dy, 0.8])))
    assert len(cloud.seen()) > 0.9 * len(cloud.samples)


def test_nothing_is_seen_of_an_empty_scene():
    empty = TrueSurface((np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    assert empty.empty and not empty.observe(cube_frame(), AHEAD) and len(empty.seen()) == 0
    assert empty.size == 0


def test_bodies_of_revolution_are_recognised_about_any_axis():
    assert surface_of('cylinder').is_body_of_revolution()
    target = make_target('cylinder')
    R = exp_so3(np.array([0.5, 1.0, -0.3]))
    tilted = target.vertices.astype(float) @ R.T + [0.1, 0.2, 0.3]
    assert TrueSurface((tilted, target.triangles)).is_body_of_revolution()
    assert TrueSurface(sphere(5)).is_body_of_revolution() is False  # of one metre: facets 1 mm deep show
    small, faces = sphere(5)
    assert TrueSurface((small * 0.15, faces)).is_body_of_revolution()


@pytest.mark.parametrize('name', ['prism', 'tank_boosters', 'upper_stage', 'asteroid'])
def test_other_bodies_are_not(name):
    assert not surface_of(name).is_body_of_revolution()


def test_looking_the_same_turned():
    prism = surface_of('prism')
    half, quarter = exp_so3(np.array([0, 0, np.pi])), exp_so3(np.array([0, 0, np.pi / 2]))
    assert prism.looks_the_same(np.array([np.eye(3), half]))
    assert not prism.looks_the_same(np.array([np.eye(3), half, quarter]))


def test_reading_prefers_the_mesh_and_names_what_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match=r'truth_mesh\.ply nor truth_cloud\.ply'):
        TrueSurface.read(tmp_path)
    (tmp_path / 'truth_cloud.ply').write_text(
        'ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n'
        'end_header\n0 0 0\n1 2 3\n'
    )
    cloud = TrueSurface.read(tmp_path)
    np.testing.assert_allclose(cloud.samples, [[0, 0, 0], [1, 2, 3]])
    assert cloud.size == 3.0
    write_mesh_ply(tmp_path / 'truth_mesh.ply', *box((1, 1, 1)))
    mesh = TrueSurface.read(tmp_path)
    assert len(mesh.samples) == 40_000 and mesh.size == pytest.approx(1.0)
    with pytest.raises(FileNotFoundError, match='none'):
        read_cloud(tmp_path / 'none.ply')
