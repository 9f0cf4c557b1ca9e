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

"""Each record's errors, measured on rendered frames of plates."""

import dataclasses

import numpy as np
import pytest

from debris_scanner.core.camera import virtual_camera
from debris_scanner.core.geometry import exp_so3, transform
from debris_scanner.sim.modelled_sensor import ModelledSensor, edges
from debris_scanner.sim.sensors import KINECT1, SENSOR_NAMES, SENSORS, find_sensor
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.sim.shapes import box
from debris_scanner.sim.targets import Target, make_target

MODELLED = [name for name in SENSOR_NAMES if name != KINECT1]
FRAMES = 12


def plate(width, height, z=0.0):
    """A thin plate whose near face stands at z of the target, square to the sensor."""
    vertices, triangles = box((width, height, 0.001), (0, 0, z + 0.0005))
    return Target('plate', vertices.astype(np.float32), triangles)


def ahead(distance, degrees=0.0):
    return transform(exp_so3(np.array([0.0, np.radians(degrees), 0.0])), np.array([0.0, 0.0, distance]))


def middle(image, half=30):
    """A square part in the middle of images (..., h, w)."""
    v, u = image.shape[-2] // 2, image.shape[-1] // 2
    return image[..., v - half : v + half, u - half : u + half]


def wall_frames(model, degrees=10.0, count=FRAMES, half=30):
    """Frames (n, 2 half, 2 half) of the middle of a plate that fills it, tilted across the steps of depth."""
    size = 4 * half / model.rays.focal_px * model.range_m
    sensor = ModelledSensor(model, plate(size, size), seed=1)
    return np.array([middle(sensor.render(ahead(model.range_m, degrees), k), half) for k in range(count)])


def temporal(frames):
    """Standard deviation over the frames of the pixels that were always measured, RMS."""
    always = (frames > 0).all(axis=0)
    assert always.mean() > 0.7
    return float(np.sqrt(frames.astype(float).var(axis=0, ddof=1)[always].mean()))


def expected_sigma(model, cosine=1.0):
    """The law's, and the rounding's, at the sensor's typical distance."""
    z = model.range_m
    law = float(model.sigma(np.float32(z), np.float32(cosine)))
    disparity = 0.0
    if model.disparity_step_px > 0:
        disparity = z**2 / (model.rays.focal_px * model.baseline_m) * model.disparity_step_px
    return np.sqrt(law**2 + (disparity**2 + model.step_m**2) / 12)


def test_there_is_a_record_for_every_name():
    assert set(SENSOR_NAMES) >= {
        'kinect1', 'kinect2', 'd435', 'd405', 'azure', 'flexx', 'tof_space', 'lidar',
    }  # fmt: skip
    assert all(find_sensor(name).name == name for name in SENSOR_NAMES)
    with pytest.raises(ValueError, match=r"'sonar'.*kinect1.*lidar"):
        find_sensor('sonar')


def test_the_default_is_what_it_was():
    """A frame of the simulator before it had other sensors; processors round a few pixels to another mm."""
    frame = simulate(SimulationSettings(seconds=0.1, rate_hz=10)).frame(0)
    assert frame.stamp_ns == 10**9
    depth = frame.depth_mm.astype(float)
    assert np.count_nonzero(depth) == pytest.approx(15958, abs=3)
    bands = depth.reshape(10, 48, -1).sum(axis=(1, 2))
    was = [0, 0, 1602327, 2722355, 2754233, 3062920, 2106398, 7644, 0, 0]
    np.testing.assert_allclose(bands, was, atol=2500)  # three pixels


@pytest.mark.parametrize('name', MODELLED)
def test_noise_has_the_size_of_its_law(name):
    model = SENSORS[name]
    assert temporal(wall_frames(model)) == pytest.approx(expected_sigma(model), rel=0.15)


@pytest.mark.parametrize('name', ['kinect1_real', 'kinect2', 'd435', 'flexx'])
def test_slopes_are_noisier_by_the_law(name):
    model = dataclasses.replace(SENSORS[name], offset_share=0.0)
    cosine = np.cos(np.radians(55))
    measured = temporal(wall_frames(model, 55.0, half=15))
    assert measured == pytest.approx(expected_sigma(model, cosine), rel=0.15)
    assert expected_sigma(model, cosine) > 1.02 * expected_sigma(model)


@pytest.mark.parametrize('name', MODELLED)
def test_noise_is_correlated_over_its_length(name):
    model = dataclasses.replace(SENSORS[name], disparity_step_px=0.0, step_m=1e-5, edge_dropout=0.0)
    frames = wall_frames(model)
    noise = frames - frames.mean(axis=0)
    lag = max(1, round(model.correlation_px))
    share = (noise[:, :, lag:] * noise[:, :, :-lag]).mean() / noise.var()
    expected = np.exp(-((lag / model.correlation_px) ** 2)) if model.correlation_px else 0.0
    assert share == pytest.approx(expected, abs=0.1)


@pytest.mark.parametrize('name', ['d435', 'd405', 'kinect2', 'azure', 'flexx', 'tof_space', 'lidar'])
def test_fixed_patterns_stay_in_the_image(name):
    """Random noise off: what is left is the same in all frames, and of the stated size over the image."""
    model = dataclasses.replace(
        SENSORS[name],
        axial=(0.0, 0.0, 0.0),
        oblique_px=0.0,
        disparity_step_px=0.0,
        step_m=1e-6,
        jagged_px=0.0,
    )
    z = model.range_m
    sensor = ModelledSensor(model, plate(40, 40), seed=1)
    first, second = (sensor.render(ahead(z), k).astype(float) for k in (0, 1))
    both = (first > 0) & (second > 0) & ~edges(first.astype(np.float32))
    if model.sends_cloud:  # a range: back to the distance of the plate
        v, u = np.indices(first.shape, np.float32)
        cosine = model.rays.directions(u, v)[..., 2]
        first, second = first * cosine, second * cosine
    inner = both & (np.abs(first - z) < 0.1 * z)
    np.testing.assert_allclose(first[inner], second[inner], atol=1e-4 * z)
    bump = z**2 / (model.rays.focal_px * model.baseline_m) * model.bump_px if model.bump_px else 0.0
    assert np.sqrt(((first[inner] - z) ** 2).mean()) == pytest.approx(
        np.hypot(bump, model.offset_share * z), rel=0.15
    )


@pytest.mark.parametrize('name', ['kinect1_real', 'd435', 'd405'])
def test_the_second_eye_casts_a_shadow_to_the_left(name):
    """A near plate hides from the eye on the right a strip of the far one, left of itself alone."""
    model = dataclasses.replace(SENSORS[name], edge_dropout=0.0, jagged_px=0.0, axial=(0.0, 0.0, 0.0))
    near, far = model.range_m, 1.4 * model.range_m
    front, back = plate(0.3 * near, 0.3 * near), plate(1.2 * near, 0.6 * near, far - near)
    both = Target('both', np.concatenate([front.vertices, back.vertices]),
                  np.concatenate([front.triangles, back.triangles + len(front.vertices)]))  # fmt: skip
    image = ModelledSensor(model, both, seed=1).render(ahead(near), 0)
    row = image[image.shape[0] // 2]
    nearer = np.flatnonzero((row > 0) & (row < (near + far) / 2))
    left, right = nearer[0], nearer[-1]
    width = model.rays.focal_px * model.baseline_m * (1 / near - 1 / far)
    empty_left = left - 1 - np.flatnonzero(row[:left])[-1]
    empty_right = np.flatnonzero(row[right + 1 :])[0]
    assert empty_left == pytest.approx(width, abs=1.5) and empty_left >= 2
    assert empty_right <= 1


def test_a_stereo_camera_sees_nothing_beyond_its_second_image():
    model = SENSORS['d435']
    image = ModelledSensor(model, plate(3, 2), seed=1).render(ahead(0.5), 0)
    band = model.rays.focal_px * model.baseline_m / 0.5
    seen = (image[100:380] > 0).mean(axis=0)
    assert not seen[: int(band) - 4].any() and seen[int(band) + 4 :].min() > 0.9


@pytest.mark.parametrize('name', ['kinect2', 'azure', 'flexx', 'tof_space', 'lidar'])
def test_flying_pixels_are_at_edges_alone_and_lie_between(name):
    model = dataclasses.replace(SENSORS[name], offset_share=0.0)
    near = model.range_m
    front, back = plate(0.3 * near, 0.3 * near), plate(0.8 * near, 0.6 * near, 0.3 * near)
    both = Target('both', np.concatenate([front.vertices, back.vertices]),
                  np.concatenate([front.triangles, back.triangles + len(front.vertices)]))  # fmt: skip
    exact = ModelledSensor(model, both, seed=1, noise=False).render(ahead(near), 0)
    sensor = ModelledSensor(model, both, seed=1)
    frames = np.array([sensor.render(ahead(near), k) for k in range(4)])
    flies = (frames > near * 1.1) & (frames < near * 1.2)
    rim = edges(np.where(exact > 0, exact, np.inf).astype(np.float32))
    for _ in range(2):  # edges are jagged by a pixel or two
        rim = rim | np.roll(rim, 1, 0) | np.roll(rim, -1, 0) | np.roll(rim, 1, 1) | np.roll(rim, -1, 1)
    assert flies.sum() > 10 and not flies[:, ~rim].any()
    assert frames.max() < 1.5 * near


def test_edges_are_jagged_by_half_a_pixel():
    model = dataclasses.replace(SENSORS['kinect1_real'], edge_dropout=0.0)
    sensor = ModelledSensor(model, plate(0.4, 0.4), seed=1)
    left = np.concatenate([(sensor.render(ahead(0.8), k)[140:340] > 0).argmax(axis=1) for k in range(8)])
    # the edge's place and the pixel's own width
    assert left.std() == pytest.approx(np.hypot(0.5, 1 / np.sqrt(12)), rel=0.2)


def test_quantisation_leaves_steps():
    step = 525 * 0.075 / 0.125
    depth = np.unique(wall_frames(SENSORS['kinect1_real'], count=1))
    depth = depth[depth > 0].astype(float)
    assert np.abs(step / depth - np.rint(step / depth)).max() < 0.27  # of millimetres
    assert not np.allclose(wall_frames(SENSORS['d405'], count=1) * 1000 % 1, 0, atol=0.01)


@pytest.mark.parametrize('name', MODELLED)
def test_returns_end_at_grazing_incidence_and_beyond_the_limits(name):
    model = SENSORS[name]
    size = 0.5 * model.range_m
    sensor = ModelledSensor(model, plate(size, size), seed=1)
    facing = (sensor.render(ahead(model.range_m), 0) > 0).sum()
    steep = (sensor.render(ahead(model.range_m, 88.5), 0) > 0).sum()
    assert facing > 1000 and steep < 0.02 * facing
    near, far = model.limits_m
    assert not sensor.render(ahead(far * 1.2), 0).any()
    assert near < model.range_m < far


def test_a_lidar_looks_along_a_regular_grid_of_angles():
    simulation = simulate(SimulationSettings('prism', sensor='lidar', seconds=0.1, clutter='wall'))
    frame = simulation.frame(0)
    x, y, z = frame.points.astype(float).T
    assert len(x) > 30_000 and frame.points.dtype == np.float32
    step = np.radians(0.18)
    for angle in (np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))):
        pixel = angle / step - 0.5
        np.testing.assert_allclose(pixel, np.rint(pixel), atol=1e-3)
    # the scanner's camera for such a cloud is as fine as the grid: half a Kinect's, to half an octave
    assert frame.camera == virtual_camera(frame.points)
    assert frame.depth.shape == (240, 320) and (frame.depth > 0).sum() > 0.5 * len(x)


@pytest.mark.parametrize('name', ['kinect1_real', 'lidar'])
def test_frames_are_lost_and_stamps_jitter(name):
    settings = SimulationSettings('empty', seed=2, seconds=1000.0, sensor=name)
    session = simulate(settings)
    assert len(session) / 10_000 == pytest.approx(0.99, abs=0.003)
    stamps = np.array([session.stamp_ns(k) for k in range(len(session))])
    assert (np.diff(stamps) > 0).all()
    taken = np.rint((stamps - 10**9) / 1e8) * 1e8 + 1e9
    assert (stamps - taken).std() == pytest.approx(1.5e6, rel=0.05)
    exact = simulate(dataclasses.replace(settings, noise=False))
    assert len(exact) == 10_000 and exact.stamp_ns(77) == 10**9 + 77 * 10**8


def test_a_jittered_frame_shows_the_target_when_it_was_taken():
    session = simulate(SimulationSettings('prism', sensor='d435', seconds=30.0))
    exact = simulate(SimulationSettings('prism', range_m=0.8, seconds=30.0))
    numbers = [round((session.stamp_ns(k) - 10**9) / 1e8) for k in range(len(session))]
    assert len(session) < 300 and len(set(numbers)) == len(numbers)
    np.testing.assert_array_equal(session.pose(len(session) - 1), exact.pose(numbers[-1]))


@pytest.mark.parametrize('name', MODELLED)
def test_frames_depend_on_seed_and_index_alone(name):
    def depth(index, seed=4):
        return simulate(SimulationSettings('cubesat', sensor=name, seed=seed, seconds=1.0)).frame(index).depth

    session = simulate(SimulationSettings('cubesat', sensor=name, seed=4, seconds=1.0))
    later = [session.frame(k).depth for k in (3, 0)]
    np.testing.assert_array_equal(later[0], depth(3))
    np.testing.assert_array_equal(later[1], depth(0))
    assert np.any(depth(0, seed=5) != later[1])


@pytest.mark.parametrize('name', MODELLED)
def test_without_noise_depths_are_true_to_the_step(name):
    model = SENSORS[name]
    size = 0.4 * model.range_m
    image = ModelledSensor(model, plate(size, size), noise=False).render(ahead(model.range_m), 0)
    z = image if not model.sends_cloud else ModelledSensor(model, plate(1, 1)).points(image)[:, 2]
    np.testing.assert_allclose(z[z > 0], model.range_m, atol=0.51 * model.step_m)


def test_clutter_shades_and_insulation_work_with_every_kind():
    for name in ('d435', 'lidar', 'tof_space'):
        plain = simulate(SimulationSettings(sensor=name, seconds=0.1)).frame(0).depth
        shiny = simulate(SimulationSettings(sensor=name, seconds=0.1, mli=True)).frame(0).depth
        walled = simulate(SimulationSettings(sensor=name, seconds=0.1, clutter='wall')).frame(0).depth
        assert (shiny > 0).sum() < 0.7 * (plain > 0).sum()
        assert (walled > 1.3 * SENSORS[name].range_m).sum() > 5 * (plain > 0).sum()
        sensor = ModelledSensor(SENSORS[name], make_target('prism', SENSORS[name].size_m), seed=1)
        T = ahead(SENSORS[name].range_m, 20.0)
        whole, part = ((sensor.render(T, 0, v) > 0).sum() for v in (1.0, 0.3))
        assert part == pytest.approx(0.3 * whole, rel=0.15)
        assert not sensor.render(T, 0, 0.0).any()
