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

"""Simulated sessions as bags: what the options say, whole or absent, and the truth beside them."""

import json
import subprocess
import sys

import numpy as np
import pytest
import yaml

from debris_scanner.cli import simulate as verb
from debris_scanner.cli.main import main
from debris_scanner.core.geometry import inverse, log_so3
from debris_scanner.core.results import StampedPose
from debris_scanner.io.mesh_files import read_mesh
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sim.clutter import CLUTTER_NAMES
from debris_scanner.sim.motions import MOTION_NAMES
from debris_scanner.sim.sensors import SENSOR_NAMES, SENSORS
from debris_scanner.sim.session import SimulationSettings, simulate
from debris_scanner.sim.targets import TARGET_NAMES
from debris_scanner.tracking.sensor_path import ODOMETRY, SensorPath
from msg_adapters.bags import open_session


def run(out, *options, target='prism'):
    return main(['simulate', target, '--out', str(out), *options])


def frames_of(bag):
    with open_session(bag) as session:
        return [frame for _, frame in session]


def test_bag_holds_the_simulated_frames_and_their_truth(tmp_path, capsys):
    out = tmp_path / 'new' / 'bag'
    assert run(out, '--seconds', '0.6', '--seed', '3') == 0
    simulation = simulate(SimulationSettings('prism', seconds=0.6, seed=3))
    frames, poses = frames_of(out), read_tum(out / 'truth.tum')
    assert len(frames) == len(poses) == len(simulation) == 6
    for k, expected in enumerate(simulation):
        assert frames[k].stamp_ns == poses[k].stamp_ns == expected.stamp_ns
        np.testing.assert_allclose(frames[k].depth, expected.depth_mm * 1e-3, atol=1e-6)
        assert frames[k].camera == expected.camera
        np.testing.assert_allclose(poses[k].T_sensor_target, expected.T_sensor_target, atol=1e-8)
    vertices, triangles = read_mesh(out / 'truth_mesh.ply')
    assert (len(vertices), len(triangles)) == (
        len(simulation.target.vertices),
        len(simulation.target.triangles),
    )
    printed = capsys.readouterr()
    assert '6 frames' in printed.out
    assert printed.err == ''  # no bar where there is no terminal


def test_topics_frame_and_metadata_follow_the_conventions(tmp_path):
    run(tmp_path / 'bag', '--seconds', '0.3')
    metadata = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert metadata['storage_identifier'] == 'mcap'
    assert metadata['relative_file_paths'] == ['bag.mcap']
    topics = {t['topic_metadata']['name']: t for t in metadata['topics_with_message_count']}
    assert {name: t['topic_metadata']['type'] for name, t in topics.items()} == {
        '/depth/image_raw': 'sensor_msgs/msg/Image',
        '/depth/camera_info': 'sensor_msgs/msg/CameraInfo',
    }
    assert all(t['message_count'] == 3 for t in topics.values())
    with open_session(tmp_path / 'bag') as session:
        raw = next(iter(session._bag.messages({'/depth/image_raw'})))
    from msg_adapters.bags import decode

    image = decode(raw)
    assert (image.encoding, image.header.frame_id) == ('16UC1', 'camera_depth_optical_frame')
    assert raw.stamp_ns == 10**9


def test_a_swinging_sensor_may_say_how_it_moves(tmp_path):
    seconds = 0.6
    assert run(tmp_path / 'bag', '--motion', 'swing', '--seconds', str(seconds), '--sensor-odometry') == 0
    simulation = simulate(SimulationSettings('prism', 'swing', seconds=seconds))
    path = SensorPath()
    with open_session(tmp_path / 'bag') as session:
        session.read_sensor_odometry(path)
    true = [StampedPose(simulation.stamp_ns(k), simulation.pose(k)) for k in range(len(simulation))]
    placed = path.place(true)
    assert placed.frame == ODOMETRY and 0 < placed.sigma_rad < np.radians(0.01)
    # the target's centre stands still in the world, but for the odometry's noise
    positions = np.array([pose.T_sensor_target[:3, 3] for pose in placed.poses])
    assert np.abs(positions - positions[0]).max() < 1e-3
    seen = np.array([pose.T_sensor_target[:3, 3] for pose in true])
    assert np.abs(seen - seen[0]).max() > 5e-3
    again = simulation.sensor_odometry(50.0)
    np.testing.assert_array_equal(again[3].T_world_sensor, simulation.sensor_odometry(50.0)[3].T_world_sensor)


def test_truth_does_not_travel_in_the_messages(tmp_path):
    run(tmp_path / 'bag', '--seconds', '0.2')
    with open_session(tmp_path / 'bag') as session:
        assert {c.topic for c in session._bag.channels} == {'/depth/image_raw', '/depth/camera_info'}


def test_rate_spin_axis_and_range(tmp_path):
    run(tmp_path / 'bag', '--seconds', '1', '--rate', '5', '--spin', '-0.8', '--axis', '0', '-1', '0.2',
        '--range', '1.1', '--no-noise')  # fmt: skip
    poses = read_tum(tmp_path / 'bag' / 'truth.tum')
    assert np.diff([p.stamp_ns for p in poses]).tolist() == [200_000_000] * 4
    assert all(abs(p.T_sensor_target[2, 3] - 1.1) < 1e-6 for p in poses)
    turn = log_so3((poses[1].T_sensor_target @ inverse(poses[0].T_sensor_target))[:3, :3])
    axis = np.array([0, -1, 0.2]) / np.hypot(1, 0.2)
    np.testing.assert_allclose(turn, -0.16 * axis, atol=1e-6)


def test_size_scales_a_target(tmp_path):
    run(tmp_path / 'bag', '--seconds', '0.1', '--size', '0.2')
    vertices, _ = read_mesh(tmp_path / 'bag' / 'truth_mesh.ply')
    assert np.ptp(vertices, axis=0).max() == pytest.approx(0.2, abs=1e-6)


def test_mesh_file_is_a_target(tmp_path):
    run(tmp_path / 'bag', '--seconds', '0.1')
    assert run(tmp_path / 'again', '--seconds', '0.1', target=str(tmp_path / 'bag' / 'truth_mesh.ply')) == 0
    assert (frames_of(tmp_path / 'again')[0].depth > 0).sum() > 1000


def test_equal_options_give_equal_images_and_the_seed_changes_them(tmp_path):
    for name, seed in (('a', 1), ('b', 1), ('c', 2)):
        run(tmp_path / name, '--seconds', '0.2', '--seed', str(seed))
    a, b, c = ([f.depth for f in frames_of(tmp_path / name)] for name in 'abc')
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, c)


@pytest.mark.parametrize(
    ('flag', 'value'),
    [
        ('--mli', None),
        ('--mli-share', '0.4'),
        ('--correlated', None),
        ('--no-noise', None),
        ('--clutter', 'wall'),
    ],
)
def test_every_flag_changes_the_images(tmp_path, flag, value):
    common = ['--seconds', '0.1', '--seed', '5']
    run(tmp_path / 'plain', *common)
    run(tmp_path / 'with', *common, flag, *([value] if value else []))
    assert not np.array_equal(frames_of(tmp_path / 'plain')[0].depth, frames_of(tmp_path / 'with')[0].depth)


@pytest.mark.parametrize(
    ('sensor', 'topic', 'encoding'),
    [
        ('d435', '/depth/image_raw', '16UC1'),
        ('d405', '/depth/image_raw', '32FC1'),
        ('lidar', '/points', None),
    ],
)
def test_a_sensor_arrives_as_it_would_send(tmp_path, sensor, topic, encoding):
    """At its own distance, as images or an unorganised cloud, and nothing is lost in the bag."""
    run(tmp_path / 'bag', '--seconds', '0.3', '--sensor', sensor)
    from msg_adapters.bags import decode

    with open_session(tmp_path / 'bag') as session:
        assert session.topic == topic
        message = decode(next(iter(session._bag.messages({topic}))))
        frames = [frame for _, frame in session]
    if encoding is None:
        assert message.height == 1 and [f.name for f in message.fields] == ['x', 'y', 'z']
    else:
        assert message.encoding == encoding
    simulation = simulate(SimulationSettings('prism', seconds=0.3, sensor=sensor))
    for frame, expected in zip(frames, simulation, strict=True):
        assert frame.stamp_ns == expected.stamp_ns and frame.camera == expected.camera
        np.testing.assert_array_equal(frame.depth, expected.depth)
        assert (frame.depth > 0).sum() > 300
    poses = read_tum(tmp_path / 'bag' / 'truth.tum')
    assert poses[0].T_sensor_target[2, 3] == pytest.approx(SENSORS[sensor].range_m)


def test_gaps_hide_the_target(tmp_path):
    run(tmp_path / 'bag', '--seconds', '12', '--rate', '2', '--gaps')
    seen = {bool((f.depth > 0).any()) for f in frames_of(tmp_path / 'bag')}
    assert seen == {True, False}


def test_gaps_can_wait_and_the_target_can_leave_or_show_in_part(tmp_path):
    common = ['--seconds', '8', '--rate', '4', '--no-noise']
    for name, options in (
        ('plain', []),
        ('late', ['--gaps', '--gaps-from', '60']),
        ('patchy', ['--patchy']),
        ('gone', ['--leaves', '3']),
    ):
        run(tmp_path / name, *common, *options)
    pixels = {
        name: np.array([(f.depth > 0).sum() for f in frames_of(tmp_path / name)])
        for name in ('plain', 'late', 'patchy', 'gone')
    }
    np.testing.assert_array_equal(pixels['late'], pixels['plain'])
    share = pixels['patchy'] / pixels['plain']
    assert share.min() > 0.25 and share[0] == 1 and (share < 0.75).sum() > 2
    assert (pixels['gone'][:10] == pixels['plain'][:10]).all() and not pixels['gone'][12:].any()


def test_help_lists_what_there_is():
    assert all(name in verb.TARGETS for name in TARGET_NAMES)
    assert all(name in verb.MOTIONS for name in MOTION_NAMES)
    assert all(name in verb.CLUTTER for name in CLUTTER_NAMES)
    assert verb.SENSORS.split(', ') == list(SENSOR_NAMES)


@pytest.mark.parametrize(
    ('target', 'options', 'names'),
    [
        ('teapot', [], 'teapot'),
        ('missing.obj', [], 'missing.obj'),
        ('prism', ['--motion', 'wobble'], 'wobble'),
        ('prism', ['--clutter', 'fog'], 'fog'),
        ('prism', ['--sensor', 'sonar'], 'sonar'),
        ('prism', ['--seconds', '-1'], 'positive'),
        ('prism', ['--axis', '0', '0', '1'], 'line of sight'),
        ('prism', ['--seed', '-4'], 'seed'),
    ],
)
def test_impossible_wishes_are_one_line_and_leave_nothing(tmp_path, capsys, target, options, names):
    assert run(tmp_path / 'bag', *options, target=target) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1 and names in err and err.startswith('debris-scan simulate: ')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('value', ['nan', 'inf', 'fast'])
def test_numbers_must_be_numbers(tmp_path, capsys, value):
    with pytest.raises(SystemExit) as ended:
        run(tmp_path / 'bag', '--rate', value)
    assert ended.value.code == 2
    assert value in capsys.readouterr().err


def test_existing_folder_is_left_alone(tmp_path, capsys):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'mine.txt').write_text('precious')
    assert run(tmp_path / 'bag', '--seconds', '0.1') == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1 and 'exists already' in err
    assert [p.name for p in (tmp_path / 'bag').iterdir()] == ['mine.txt']


def test_interrupted_recording_leaves_no_bag(tmp_path):
    code = (
        'import os, signal, sys\n'
        'from debris_scanner.sim import session\n'
        'from debris_scanner.cli.main import main\n'
        'frame = session.Simulation.frame\n'
        'def interrupted(self, k):\n'
        '    if k == 3: os.kill(os.getpid(), signal.SIGTERM)\n'
        '    return frame(self, k)\n'
        'session.Simulation.frame = interrupted\n'
        f'sys.exit(main(["simulate", "prism", "--seconds", "1", "--out", {json.dumps(str(tmp_path / "b"))}]))'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=False)
    assert done.returncode == 143
    assert done.stderr.splitlines() == ['debris-scan: terminated']
    assert list(tmp_path.iterdir()) == []


def test_session_of_this_repository_is_what_its_readme_says(session_bag):
    """The README names the default command: its motion and, but for the last digit, its images."""
    assert 'debris-scan simulate shuttle_stack --out bags/' in (session_bag.parent / 'README.md').read_text()
    simulation = simulate(SimulationSettings())
    poses, frames = read_tum(session_bag / 'truth.tum'), frames_of(session_bag)
    assert len(poses) == len(frames) == len(simulation) == 250
    for k in (0, 77, 249):
        expected = simulation.frame(k)
        assert frames[k].stamp_ns == poses[k].stamp_ns == expected.stamp_ns
        np.testing.assert_allclose(poses[k].T_sensor_target, expected.T_sensor_target, atol=1e-8)
        alike = np.abs(frames[k].depth - expected.depth_mm * 1e-3) < 1e-6
        assert alike.mean() > 0.999
    assert sum(p.stat().st_size for p in session_bag.iterdir()) < 10e6
