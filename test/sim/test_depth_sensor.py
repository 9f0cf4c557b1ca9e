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

import numpy as np
import pytest

from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.sim.clutter import CLUTTER_NAMES, make_clutter
from debris_scanner.sim.depth_sensor import (
    BASELINE_M,
    DISPARITY_STEP_PX,
    KINECT,
    DepthSensor,
    SensorSettings,
    axial_sigma,
)
from debris_scanner.sim.shapes import box
from debris_scanner.sim.surface import Surface
from debris_scanner.sim.targets import Target, make_target

AHEAD = transform(np.eye(3), np.array([0.0, 0.0, 0.8]))
QUIET = SensorSettings(noise=False)


def plate(width=0.5, height=0.4):
    """A plate whose near face stands at the target's origin, square to the sensor."""
    vertices, triangles = box((width, height, 0.02), (0, 0, 0.01))
    return Target('plate', vertices.astype(np.float32), triangles)


@pytest.fixture(scope='module')
def flat_frames():
    sensor = DepthSensor(plate(), seed=1)
    return [sensor.render(AHEAD, k) for k in range(20)]


def middle(image):
    return image[180:300, 220:420].astype(float) / 1000


def test_without_noise_the_depth_is_the_true_one():
    image = DepthSensor(plate(), QUIET).render(AHEAD, 0)
    assert image.shape == (480, 640) and image.dtype == np.uint16
    v, u = np.nonzero(image)
    assert np.all(image[v, u] == 800)
    # 0.5 m at 0.8 m through f = 525 is 328 pixels wide, about the principal point
    assert (u.min(), u.max()) == (156, 483) and (v.min(), v.max()) == (109, 370)


def test_a_sphere_is_seen_where_geometry_puts_it():
    target = make_target('asteroid')
    T = transform(exp_so3(np.array([0.4, 0.2, -0.3])), np.array([0.1, -0.05, 0.7]))
    image = DepthSensor(target, QUIET).render(T, 0)
    points = KINECT.back_project((image / 1000).astype(np.float32))
    seen = points[image > 0].astype(float)
    own = (seen - T[:3, 3]) @ T[:3, :3]
    assert (
        Surface(target.vertices, target.triangles).distance(own).max() < 0.0006
    )  # half a millimetre of rounding


def test_axial_noise_has_the_stated_size():
    sensor = DepthSensor(plate(), seed=1)
    # at many ranges, so that the steps of disparity and of millimetres fall everywhere
    errors = []
    for k, z in enumerate(np.linspace(0.78, 0.82, 41)):
        measured = middle(sensor.render(transform(np.eye(3), np.array([0, 0, z])), k))
        assert (measured > 0).mean() > 0.999
        errors.append(measured[measured > 0] - z)
    error = np.concatenate(errors)
    step = 0.8**2 / (KINECT.fx * BASELINE_M) * DISPARITY_STEP_PX
    expected = np.sqrt(axial_sigma(np.float32(0.8)) ** 2 + step**2 / 12 + 0.001**2 / 12)
    assert error.std() == pytest.approx(float(expected), rel=0.02)
    assert abs(error.mean()) < 5e-5


def test_noise_grows_with_range():
    sensor = DepthSensor(plate(1.5, 1.0))
    spread = [middle(sensor.render(transform(np.eye(3), np.array([0, 0, z])), 0)).std() for z in (0.5, 1.1)]
    assert spread[1] > 1.4 * spread[0]


def test_disparity_comes_in_eighths_of_a_pixel(flat_frames):
    z = np.unique(middle(flat_frames[0]))
    disparity = KINECT.fx * BASELINE_M / z
    step = disparity / DISPARITY_STEP_PX
    # a millimetre of rounding moves the disparity by up to 0.03 pixels, a quarter of a step
    assert np.abs(step - np.rint(step)).max() < 0.27
    assert 3 < len(z) < 15


def test_noise_of_neighbours_hangs_together_only_where_asked(flat_frames):
    def correlation(images, lag):
        z = np.array([middle(i) for i in images])
        z = z - z.mean()
        return (z[:, :, lag:] * z[:, :, :-lag]).mean() / z.var()

    sensor = DepthSensor(plate(), SensorSettings(correlated=True), seed=1)
    together = [sensor.render(AHEAD, k) for k in range(20)]
    assert abs(correlation(flat_frames, 1)) < 0.03
    assert 0.5 < correlation(together, 1) < 0.95
    assert correlation(together, 4) < 0.4 and abs(correlation(together, 12)) < 0.1
    assert np.std([middle(i) for i in together]) == pytest.approx(
        np.std([middle(i) for i in flat_frames]), rel=0.1
    )


def test_edges_wander_and_drop_out(flat_frames):
    clean = DepthSensor(plate(), QUIET).render(AHEAD, 0) > 0
    rim = np.zeros_like(clean)
    rim[110:370, 156] = True
    share = np.mean([(f > 0)[rim].mean() for f in flat_frames])
    assert 0.2 < share < 0.7
    inner = np.zeros_like(clean)
    inner[115:365, 162] = True
    assert np.mean([(f > 0)[inner].mean() for f in flat_frames]) > 0.99
    outlines = {tuple(np.flatnonzero(f[240])[[0, -1]]) for f in flat_frames}
    assert len(outlines) > 1


def test_returns_thin_out_at_grazing_incidence():
    def share(degrees):
        T = transform(exp_so3(np.array([0.0, np.radians(degrees), 0.0])), np.array([0, 0, 0.8]))
        clean, noisy = DepthSensor(plate(), QUIET).render(T, 0), DepthSensor(plate()).render(T, 0)
        # rows and columns well inside: no edges
        part = np.zeros(clean.shape, bool)
        part[180:300, 315:324] = True
        part &= clean > 0
        return (noisy[part] > 0).mean()

    assert share(60) > 0.98
    assert 0.1 < share(80) < 0.8
    assert share(87) < 0.1


def test_shiny_insulation_returns_as_measured():
    sensor = DepthSensor(plate(), SensorSettings(mli=True))

    def share(degrees):
        T = transform(exp_so3(np.array([0.0, np.radians(degrees), 0.0])), np.array([0, 0, 0.8]))
        return (middle(sensor.render(T, 0)) > 0).mean()

    # gold 0.35 and silver 0.53 at 20 degrees; the crinkles smear it a little
    assert 0.3 < share(20) < 0.6
    assert share(0) > 0.6
    assert share(60) < 0.01


def test_frames_depend_on_seed_and_index_alone():
    target = make_target('cubesat')
    one, two = DepthSensor(target, seed=4), DepthSensor(target, seed=4)
    forwards = [one.render(AHEAD, k) for k in range(3)]
    backwards = [two.render(AHEAD, k) for k in (2, 1, 0)][::-1]
    for a, b in zip(forwards, backwards, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.any(forwards[0] != forwards[1])
    assert np.any(DepthSensor(target, seed=5).render(AHEAD, 0) != forwards[0])


def test_a_shadow_leaves_its_share_of_the_target():
    sensor = DepthSensor(plate(), QUIET)
    whole = (sensor.render(AHEAD, 0) > 0).sum()
    assert (sensor.render(AHEAD, 0, visibility=0.3) > 0).sum() == pytest.approx(0.3 * whole, rel=0.02)
    assert not sensor.render(AHEAD, 0, visibility=0.0).any()


def test_out_of_view_and_behind_the_sensor_nothing_is_seen():
    sensor = DepthSensor(plate())
    for position in ([5.0, 0.0, 0.8], [0.0, -3.0, 0.8], [0.0, 0.0, -0.8]):
        assert not sensor.render(transform(np.eye(3), np.array(position)), 0).any()
    partly = sensor.render(transform(np.eye(3), np.array([0.5, 0.0, 0.8])), 0)
    assert partly.any() and not partly[:, :400].any()


def test_an_empty_scene_is_empty():
    assert not DepthSensor(make_target('empty')).render(AHEAD, 0).any()


@pytest.mark.parametrize('name', CLUTTER_NAMES)
def test_clutter_stands_in_the_box_beside_or_behind_the_target(name):
    target = make_target('asteroid')
    alone = DepthSensor(target, QUIET).render(AHEAD, 0)
    image = DepthSensor(target, QUIET, clutter=make_clutter(name)).render(AHEAD, 0)
    np.testing.assert_array_equal(image[alone > 0], alone[alone > 0])
    points = KINECT.back_project(image / np.float32(1000))[(image > 0) & (alone == 0)]
    inside = (np.abs(points[:, :2]) <= 0.4).all(axis=1) & (points[:, 2] >= 0.3) & (points[:, 2] <= 1.2)
    assert inside.sum() > 300


def test_clutter_in_front_hides_the_target():
    small = plate(0.05, 0.05)
    near = Target('near', small.vertices + np.array([0, 0, 0.5], np.float32), small.triangles)
    image = DepthSensor(plate(), QUIET, clutter=near).render(AHEAD, 0)
    assert image[240, 320] == 500 and image[240, 200] == 800


def test_static_clutter_moves_with_the_observer_and_keeps_still_otherwise():
    sensor = DepthSensor(make_target('empty'), QUIET, clutter=make_clutter('object'))
    still = sensor.render(AHEAD, 0)
    np.testing.assert_array_equal(still, sensor.render(AHEAD, 7, T_sensor_world=np.eye(4)))
    moved = sensor.render(AHEAD, 0, T_sensor_world=transform(np.eye(3), np.array([-0.1, 0, 0])))
    shift = np.nonzero(moved)[1].mean() - np.nonzero(still)[1].mean()
    assert shift == pytest.approx(-0.1 / 0.88 * KINECT.fx, abs=4)


def test_unknown_clutter_names_the_choices():
    with pytest.raises(ValueError, match=r"'fog'.*wall, table, object"):
        make_clutter('fog')
