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

"""Without Open3D, numba and rosbags everything imports, and what needs one says which, and how to get it."""

import subprocess
import sys

import pytest

from debris_scanner.core.optional import Absent, MissingLibrary

# a finder before all others, in a process of its own: what it is asked for is not installed
BLOCKED = """\
import importlib.abc, sys
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {missing!r}:
            raise ModuleNotFoundError('No module named ' + repr(name), name=name)
sys.meta_path.insert(0, Absent())
{code}
"""
ALL = ('open3d', 'numba', 'rosbags')
NODES = ('preprocess', 'odometry', 'closure', 'graph', 'scanner', 'sim_kinect', 'play_bag', 'viewer',
         'openni2_camera', 'freenect_camera')  # fmt: skip


def run(missing, code):
    command = [sys.executable, '-c', BLOCKED.format(missing=missing, code=code)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_all_nodes_and_the_command_line_import_without_them():
    modules = [f'debris_scanner.nodes.{name}' for name in NODES] + ['debris_scanner.cli.main']
    done = run(ALL, f'import {", ".join(modules)}')
    assert done.returncode == 0, done.stderr


@pytest.mark.ros
@pytest.mark.parametrize(
    ('missing', 'node', 'off'),
    [
        ('numba', 'preprocess', 'numba is not installed: no frame can be processed'),
        ('rosbags', 'play_bag', 'rosbags is not installed: no recording can be read'),
    ],
)
def test_a_node_says_what_is_off_and_ends(missing, node, off, session_bag):
    given = ['--ros-args', '-p', f'bag:={session_bag}'] if node == 'play_bag' else []
    done = run((missing,), f'from debris_scanner.nodes.{node} import main\nsys.exit(main({given!r}))')
    assert done.returncode == 2, done.stderr
    assert off in done.stderr
    assert "pip install 'debris_scanner[scan]'" in done.stderr
    assert 'Traceback' not in done.stderr


@pytest.mark.ros
def test_a_node_that_can_do_without_says_what_will_be_off():
    given = ['--ros-args', '-p', 'autostart:=false']
    code = f'from debris_scanner.nodes.odometry import main\nsys.exit(main({given!r}))'
    command = [sys.executable, '-c', BLOCKED.format(missing=('open3d',), code=code)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as node:
        line = next((line for line in node.stderr if 'open3d' in line), '')
        node.terminate()
        assert node.wait(60) == 0
    assert 'open3d is not installed: no mesh can be read or rendered' in line


def test_the_command_line_says_it_too(session_bag, tmp_path):
    code = f'from debris_scanner.cli.main import main\nsys.exit(main(["scan", {str(session_bag)!r}, '
    done = run(('rosbags',), code + f'"--out", {str(tmp_path / "out")!r}]))')
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith('debris-scan scan: rosbags is not installed')
    assert done.stderr.count('\n') == 1


def test_what_is_absent_raises_whatever_is_done_with_it():
    absent = Absent('numba')
    for use in (lambda: absent(), lambda: absent.name):
        with pytest.raises(MissingLibrary, match='numba is not installed: no frame'):
            use()
    assert not hasattr(absent, '__wrapped__')


@pytest.mark.ros
def test_without_ros_a_scan_says_where_it_comes_from(session_bag, tmp_path):
    argv = ['scan', str(session_bag), '--out', str(tmp_path)]
    done = run(
        ('sensor_msgs', 'rclpy'), f'from debris_scanner.cli.main import main\nsys.exit(main({argv!r}))'
    )
    assert done.returncode == 2, done.stderr
    assert 'sensor_msgs' in done.stderr and 'source /opt/ros/jazzy/setup.bash' in done.stderr
    assert len(done.stderr.splitlines()) == 1
