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

from debris_scanner.io.mesh_files import read_mesh
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sim.session import (
    FIRST_STAMP_NS,
    Simulation,
    SimulationSettings,
    frames_again,
    read_settings,
    simulate,
    write_settings,
    write_truth,
)


def test_defaults_are_the_documented_session():
    session = simulate(SimulationSettings())
    assert len(session) == 250
    assert session.settings.target == 'shuttle_stack' and session.settings.motion == 'spin'
    frame = session.frame(0)
    assert frame.stamp_ns == FIRST_STAMP_NS > 0
    assert frame.depth_mm.shape == (480, 640) and frame.depth_mm.dtype == np.uint16
    assert 8000 < (frame.depth_mm > 0).sum() < 30000
    assert len(simulate(SimulationSettings(motion='tumble'))) == 600


def test_iterating_gives_the_same_frames_as_asking():
    session = simulate(SimulationSettings('cubesat', seconds=0.5))
    frames = list(session)
    assert len(frames) == len(session) == 5
    again = list(session)
    for k in (3, 0):
        single = simulate(SimulationSettings('cubesat', seconds=0.5)).frame(k)
        np.testing.assert_array_equal(single.depth_mm, frames[k].depth_mm)
        np.testing.assert_array_equal(again[k].depth_mm, frames[k].depth_mm)
        np.testing.assert_array_equal(single.T_sensor_target, frames[k].T_sensor_target)
        assert single.stamp_ns == frames[k].stamp_ns


@pytest.mark.parametrize('rate', [5.0, 10.0, 30.0, 7.3])
def test_stamps_are_whole_nanoseconds_at_the_rate(rate):
    session = simulate(SimulationSettings('empty', rate_hz=rate, seconds=10))
    stamps = [session.stamp_ns(k) for k in range(len(session))]
    assert all(isinstance(s, int) for s in stamps)
    assert np.abs(np.diff(stamps) - 1e9 / rate).max() <= 1
    assert len(session) == round(10 * rate)


def test_frame_times_do_not_change_the_motion():
    slow, fast = (simulate(SimulationSettings('empty', rate_hz=r, seconds=4)) for r in (5.0, 10.0))
    np.testing.assert_allclose(slow.pose(10), fast.pose(20), atol=1e-12)


def test_in_a_gap_the_image_is_there_but_the_target_is_not():
    session = simulate(SimulationSettings('asteroid', motion='tumble', gaps=True, seconds=12))
    counts = np.array([(f.depth_mm > 0).sum() for f in session])
    assert (counts == 0).sum() >= 10 and (counts > 5000).sum() > 60
    assert np.any((counts > 0) & (counts < 0.6 * np.median(counts[counts > 0])))
    assert not any(np.diff(np.flatnonzero(counts == 0)) == 2)


def test_truth_lies_beside_the_recording(tmp_path):
    session = simulate(SimulationSettings('prism', seconds=0.3))
    stamps = [session.stamp_ns(k) for k in range(3)]
    write_truth(tmp_path / 'bag', stamps, [session.pose(k) for k in range(3)], session.target)
    poses = read_tum(tmp_path / 'bag' / 'truth.tum')
    assert [p.stamp_ns for p in poses] == stamps
    np.testing.assert_allclose(poses[2].T_sensor_target, session.pose(2), atol=1e-8)
    vertices, triangles = read_mesh(tmp_path / 'bag' / 'truth_mesh.ply')
    np.testing.assert_array_equal(vertices.astype(np.float32), session.target.vertices)
    np.testing.assert_array_equal(triangles, session.target.triangles)


def test_the_seed_changes_motion_and_noise_but_not_the_target():
    a, b = (simulate(SimulationSettings('asteroid', seed=s)) for s in (0, 1))
    np.testing.assert_array_equal(a.target.vertices, b.target.vertices)
    assert not np.allclose(a.pose(0), b.pose(0))


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'target': 'teapot'}, 'teapot'),
        ({'motion': 'wobble'}, 'wobble'),
        ({'clutter': 'fog'}, 'fog'),
        ({'rate_hz': 0.0}, 'rate and length'),
        ({'seconds': -1.0}, 'rate and length'),
        ({'range_m': 0.09}, 'range'),
        ({'range_m': 20.1}, 'range'),
        ({'sensor': 'sonar'}, 'sonar'),
        ({'sensor': 'd435', 'correlated': True}, 'kinect1'),
        ({'sensor': 'lidar', 'colour': True}, 'colour'),
        ({'spin_rad_s': float('nan')}, 'spin'),
        ({'seed': -1}, 'seed'),
        ({'size': 0.0}, 'size'),
        ({'sensor': 'lidar', 'spatial_filter': True}, 'depth images'),
        ({'sensor': 'kinect2', 'bump_px': 0.1}, 'stereo'),
        ({'junk_share': 1.5}, 'junk'),
        ({'focal_error': -1.0}, 'focal'),
    ],
)
def test_settings_that_make_no_recording_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        simulate(SimulationSettings(**options))


def test_frames_of_a_simulation_that_was_recorded_nowhere_come_again(tmp_path):
    settings = SimulationSettings(seconds=0.3, axis_sensor=(0.0, 1.0, 0.0), clutter='wall')
    sent = Simulation(settings)
    stamps = [7_000_000_000 + k for k in range(len(sent))]
    write_truth(tmp_path, stamps, [sent.pose(k) for k in range(len(sent))], sent.target)
    write_settings(tmp_path, settings)
    assert read_settings(tmp_path) == settings
    again = list(frames_again(Simulation(read_settings(tmp_path)), tmp_path))
    assert [f.stamp_ns for f in again] == stamps
    assert all(np.array_equal(f.depth, sent.frame(k).depth) for k, f in enumerate(again))
    (tmp_path / 'simulation.json').write_text('[1]')
    with pytest.raises(ValueError, match=r'simulation.json does not hold'):
        read_settings(tmp_path)


@pytest.mark.parametrize('seed', range(6))
def test_what_a_target_stands_on_is_seen_from_above(seed):
    """From below, a desk would hide the target."""
    depth = Simulation(SimulationSettings('prism', seed=seed, seconds=0.1, clutter='desk')).frame(0).depth
    rows = np.flatnonzero((depth > 0).mean(axis=1) > 0.9)
    nearest, farthest = np.median(depth[rows[-1]]), np.median(depth[rows[0]])
    assert rows[-1] == len(depth) - 1 and nearest < farthest


def brief(**options):
    return simulate(SimulationSettings('asteroid', seconds=0.6, **options))


def test_a_doubled_frame_is_the_same_image_with_a_later_stamp():
    once, twice = brief(), brief(doubled=True)
    assert len(twice) == len(once) == 6
    for k, frame in enumerate(twice):
        was = once.frame(k - k % 2)
        assert frame.stamp_ns == once.stamp_ns(k)
        np.testing.assert_array_equal(frame.depth, was.depth)
        np.testing.assert_array_equal(frame.T_sensor_target, was.T_sensor_target)


def test_a_focal_error_changes_what_is_told_and_not_what_is_seen():
    true, told = brief(colour=True), brief(colour=True, focal_error=0.02)
    assert (told.camera.fx, told.camera.fy) == (1.02 * true.camera.fx, 1.02 * true.camera.fy)
    assert told.camera.cx == true.camera.cx
    np.testing.assert_array_equal(told.frame(2).depth, true.frame(2).depth)
    np.testing.assert_array_equal(told.frame(2).rgb, true.frame(2).rgb)


@pytest.mark.parametrize('sensor', ['kinect1', 'd435'])
def test_filtered_frames_are_the_same_in_any_order(sensor):
    options = {'sensor': sensor, 'spatial_filter': True, 'temporal_filter': True, 'junk_share': 0.001}
    session = brief(**options)
    frames = [f.depth for f in session]
    for k in (4, 1, 5):
        np.testing.assert_array_equal(session.frame(k).depth, frames[k])
    np.testing.assert_array_equal(brief(**options).frame(5).depth, frames[5])
    raw = brief(sensor=sensor).frame(5).depth
    both = (raw > 0) & (frames[5] > 0)
    assert np.mean(raw[both] != frames[5][both]) > 0.1
    assert np.array_equal(session.frame(5).depth_mm * np.float32(0.001), session.frame(5).depth)


def test_a_hand_comes_to_the_edge_and_does_not_touch():
    session = simulate(SimulationSettings('cubesat', seconds=7.0, rate_hz=1.0, hand=True, noise=False))
    plain = simulate(SimulationSettings('cubesat', seconds=7.0, rate_hz=1.0, noise=False))
    added = [np.argwhere((a.depth > 0) & (b.depth == 0)) for a, b in zip(session, plain, strict=True)]
    assert [len(pixels) > 1000 for pixels in added] == [False] * 5 + [True, False]
    assert added[5][:, 1].max() == 639
    target = np.argwhere(plain.frame(5).depth > 0)
    assert added[5][:, 1].min() > target[:, 1].max() + 5
    for k in (0, 5):
        np.testing.assert_array_equal(session.frame(k).depth[:, :450], plain.frame(k).depth[:, :450])


def test_a_real_d415_has_all_of_it_and_without_noise_nothing():
    model = brief(sensor='d415_real').model
    assert model.spatial_filter and model.temporal_filter and model.doubled and model.hand
    assert model.junk_share > 0 and model.bump_px > 0 and model.focal_error > 0
    session = brief(sensor='d415_real', noise=False)
    assert session.camera.fx == session.model.rays.focal_px
    assert len({session.frame(k).depth.tobytes() for k in range(3)}) == 3
    assert brief(sensor='d415_real', noise=False, focal_error=0.02).camera.fx > session.camera.fx
