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

"""The launch files under the real `ros2 launch`, with tf2_ros; skipped where these are not installed."""

import json
import re
import sys

import psutil
import pytest
from launching import ROOT
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from real_ros import Command, need_ros2, ran
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from debris_scanner.nodes.lifecycle import qos

pytestmark = pytest.mark.ros  # but for a whole scan, they wait more than they compute: beside others they may
LONGEST_S = 180.0  # a first start compiles
SCAN = ROOT / 'launch' / 'scan.launch.py'


@pytest.fixture(autouse=True)
def _ros(domain):
    need_ros2()


def change(peer, node, transition):
    request = ChangeState.Request(transition=Transition(id=transition))
    return peer.call(ChangeState, f'{node}/change_state', request).success


def followers(peer, topic):
    return {info.node_name for info in peer.node.get_subscriptions_info_by_topic(topic)}


def test_without_input_it_says_what_it_waits_for_and_a_shutdown_is_not_undone(peer, tmp_path):
    states = peer.listen(String, 'state', qos.latched())
    out = tmp_path / 'out'
    with Command(tmp_path, 'ros2', 'launch', SCAN, f'out:={out}', 'sensor_odometry:=/arm/odom') as launch:
        peer.until(lambda: len(peer.reports) == 4, 'all four nodes', LONGEST_S)
        # a subscription is seen before its node's name is
        peer.until(lambda: followers(peer, '/arm/odom') == {'odometry', 'graph'}, 'both followers')
        peer.until(lambda: states, 'a state')
        assert states[-1].data == 'waiting'
        launch.until('no frames yet: ')
        assert 'points has no publisher' in launch.text
        assert change(peer, 'odometry', Transition.TRANSITION_ACTIVE_SHUTDOWN)
        launch.until('[odometry-2]: process has finished cleanly')
        # one that is killed is started again, meanwhile
        pid = int(re.search(r'closure-3.: process started with pid .(\d+)', launch.text).group(1))
        psutil.Process(pid).kill()
        launch.until('[closure-5]: process started')
        assert peer.call(Trigger, 'graph/finish').message.startswith('no model: no_target')
        peer.until(lambda: states[-1].data == 'finished', 'the end of the scan')
        launch.interrupt()
        assert launch.wait() == 0
        assert launch.text.count('[odometry-') and 'odometry-6' not in launch.text
        assert 'exit code -2' not in launch.text
    assert json.loads((out / 'summary.json').read_text())['reason'] == 'no_target'
    assert not (out / 'journal').exists()


def test_a_launch_that_is_terminated_leaves_no_node_behind(peer, tmp_path):
    out = tmp_path / 'out'
    with Command(tmp_path, 'ros2', 'launch', SCAN, f'out:={out}', 'composed:=true') as launch:
        peer.until(lambda: 'scanner' in peer.reports, 'the node', LONGEST_S)
        (pid,) = re.findall(r'process started with pid .(\d+)', launch.text)
        node = psutil.Process(int(pid))
        launch.process.terminate()
        launch.wait()
        node.wait(60)  # it is no child of this process, so its exit code is not known
    assert json.loads((out / 'summary.json').read_text())['reason'] == 'interrupted'  # it saved


def test_a_launch_that_is_interrupted_at_once_ends_without_a_traceback(tmp_path):
    with Command(tmp_path, 'ros2', 'launch', scripts_of_the_sources(tmp_path), f'out:={tmp_path}') as launch:
        launch.until('process started', times=4)
        launch.interrupt()
        launch.wait()
        assert 'Traceback' not in launch.text and 'Fatal' not in launch.text, launch.text
        assert 'exit code 1' not in launch.text


def scripts_of_the_sources(folder):
    """A launch file that has ``scan.launch.py`` start the scripts as they are here, installed or not."""
    library, binaries = folder / 'prefix' / 'lib' / 'debris_scanner', folder / 'prefix' / 'bin'
    index = folder / 'prefix' / 'share' / 'ament_index' / 'resource_index' / 'packages'
    for made in (library, binaries, index, folder / 'prefix' / 'share' / 'debris_scanner'):
        made.mkdir(parents=True)
    (index / 'debris_scanner').touch()
    (folder / 'prefix' / 'share' / 'debris_scanner' / 'params').symlink_to(ROOT / 'params')
    for script in (ROOT / 'scripts').iterdir():
        (library / script.name).write_bytes(script.read_bytes())
        (library / script.name).chmod(0o755)
    (binaries / 'python3').write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (binaries / 'python3').chmod(0o755)
    launch = folder / 'sources.launch.py'
    launch.write_text(
        'import os\n'
        f'prefix = {str(folder / "prefix")!r}\n'
        'os.environ["AMENT_PREFIX_PATH"] = prefix + ":" + os.environ["AMENT_PREFIX_PATH"]\n'
        'from launch import LaunchDescription\n'
        'from launch.actions import IncludeLaunchDescription\n'
        'def generate_launch_description():\n'
        f'    return LaunchDescription([IncludeLaunchDescription({str(SCAN)!r})])\n'
    )
    return launch


@pytest.mark.slow
def test_of_two_scanners_one_ends_and_the_other_goes_on(peer, tmp_path, brief_bag):
    both = tmp_path / 'both.launch.py'
    both.write_text(
        'from launch import LaunchDescription\n'
        'from launch.actions import GroupAction, IncludeLaunchDescription\n'
        'def scan(**given):\n'
        f'    return GroupAction([IncludeLaunchDescription({str(SCAN)!r}, launch_arguments=given.items())])\n'
        'def generate_launch_description():\n'
        f"    left = scan(namespace='left', out='left', composed='true', bag={str(brief_bag)!r},"
        " exit_when_done='true', use_sim_time='true')\n"
        "    right = scan(namespace='right', out='right', composed='true', bag='',"
        " exit_when_done='false')\n"
        '    return LaunchDescription([left, right])\n'
    )
    clocks = peer.listen(Clock, '/clock')
    echo = ('ros2', 'topic', 'echo', '--no-daemon', '/tf', 'tf2_msgs/msg/TFMessage')
    with Command(tmp_path, *echo) as tf, Command(tmp_path, 'ros2', 'launch', both) as launch:
        peer.until(lambda: len(clocks) > 100, 'the time of the recording', 300.0)
        launch.until('no frame for 5 s: finishing', timeout_s=300.0)
        launch.until('process has finished cleanly', times=2, timeout_s=300.0)  # left's scanner and player
        frames = set(re.findall(r'child_frame_id: (\S+)', tf.text))
        named = {'left/target_scanning', 'left/sensor'}
        assert named <= frames <= {*named, 'left/target'}, tf.text
        times = [c.clock.sec + c.clock.nanosec * 1e-9 for c in clocks]
        assert times == sorted(times)
        answer = peer.call(Trigger, 'right/scanner/save_model')
        assert not answer.success
        assert answer.message.startswith('no model')
    frames = json.loads((tmp_path / 'left' / 'summary.json').read_text())['frames']
    assert frames['read'] == 45 == frames['used'] + sum(frames['rejected'].values())
    assert set(frames['rejected']) <= {'shed', 'not_registered'} and frames['used'] > 20
    assert not (tmp_path / 'left' / 'journal').exists()


def test_the_real_command_line_lists_sets_and_refuses(peer, tmp_path):
    with Command(tmp_path, 'ros2', 'run', 'debris_scanner', 'graph') as node:
        peer.until(lambda: 'graph' in peer.reports, 'the node', LONGEST_S)
        code, text = ran(tmp_path, 'ros2', 'lifecycle', 'get', '--no-daemon', '--spin-time', '4', '/graph')
        assert (code, 'active [3]' in text) == (0, True), text
        code, text = ran(
            tmp_path,
            'ros2',
            'param',
            'set',
            '--no-daemon',
            '--spin-time',
            '4',
            '/graph',
            'fusion.voxel',
            '-1.0',
        )
        assert 'fusion.voxel' in text
        assert node.process.poll() is None
    malformed = tmp_path / 'malformed.yaml'
    malformed.write_text('/**:\n  ros__parameters:\n    a: [1, x: 2\n')
    code, text = ran(
        tmp_path, 'ros2', 'run', 'debris_scanner', 'graph', '--ros-args', '--params-file', malformed
    )
    assert code == 2
    assert 'Traceback' not in text
    assert str(malformed) in text


def test_colcon_builds_links_and_runs(tmp_path):
    source = tmp_path / 'src'
    source.mkdir()
    (source / 'debris_scanner').symlink_to(ROOT)
    code, text = ran(
        tmp_path, 'colcon', 'build', '--symlink-install', '--packages-select', 'debris_scanner'
    )  # fmt: skip
    assert code == 0, text
    assert 'Finished <<< debris_scanner' in text
    installed = tmp_path / 'install' / 'debris_scanner'
    assert (installed / 'share' / 'debris_scanner' / 'launch' / 'scan.launch.py').is_file()
    assert (installed / 'lib' / 'debris_scanner' / 'scanner').is_file()


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        (['composed:=TRUE'], 'provided value "TRUE" is not valid'),
        (['params:=/none.yaml'], 'params:=/none.yaml: there is no such file'),
        (['params:={unknown}', 'composed:=true'], 'scanner cannot be used as it was started'),
        (['bag:=/none', 'composed:=true'], 'play_bag cannot be used as it was started'),
        (['rate:=abc'], 'rate:=abc: a number above zero is needed'),
    ],
)
def test_what_cannot_be_started_ends_the_launch_at_once(tmp_path, given, said):
    unknown = tmp_path / 'unknown.yaml'
    unknown.write_text('/**:\n  ros__parameters:\n    isolation.min_pixel: 3\n')
    arguments = [part.format(unknown=unknown) for part in given]
    code, text = ran(tmp_path, 'ros2', 'launch', SCAN, f'out:={tmp_path / "out"}', *arguments)
    assert code == 1, text
    assert said in text
    assert 'Traceback' not in text
    assert text.count('process started') <= 2, 'a node was started again'
