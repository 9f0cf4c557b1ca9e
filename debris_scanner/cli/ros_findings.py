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

"""What doctor finds of ROS: rclpy, its middleware, the messages, and where packages are looked for."""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from debris_scanner.cli.findings import FAIL, OK, WARN, Finding, ask_python, version_of

ROS = (
    'import sensor_msgs.msg, nav_msgs.msg, visualization_msgs.msg, diagnostic_msgs.msg, std_srvs.srv, rclpy; '
    'print(rclpy.get_rmw_implementation_identifier())'
)


def check_ros() -> Iterator[Finding]:
    """Rclpy, its middleware and the messages, and whether ``ros2 run`` finds the package."""
    answer, error = ask_python(ROS)
    if answer is None:
        yield Finding(FAIL, 'ros', error, _remedy(error))
        yield from _check_prefixes()
        return
    yield Finding(OK, 'ros', f'rclpy {version_of("rclpy") or ""} on {answer}'.replace('  ', ' '))
    if 'fastrtps' not in answer:
        yield Finding(
            WARN,
            'middleware',
            f'{answer} does not read our Fast DDS profile',
            'give it room for 5 MB messages',
        )
    yield from _check_prefixes()


def _check_prefixes() -> Iterator[Finding]:
    """``ros2 run`` and ``ros2 launch`` look where AMENT_PREFIX_PATH says."""
    name = 'AMENT_PREFIX_PATH'
    nodes = Path(sys.prefix) / 'lib' / 'debris_scanner'
    prefixes = [p for p in os.environ.get(name, '').split(os.pathsep) if p]
    if lost := [p for p in prefixes if not Path(p).is_dir()]:
        advice = f'open a new shell, or unset {name}; then source the setup file of your workspace'
        yield Finding(WARN, name, f'names folders that are not there: {", ".join(lost)}', advice)
    if any((Path(p) / 'lib' / 'debris_scanner').is_dir() for p in prefixes):
        yield Finding(OK, name, 'names where debris_scanner is installed')
    elif prefixes:
        advice = 'for ros2 run, source the setup file of its workspace'
        if nodes.is_dir():
            advice = f'for ros2 run: export {name}={sys.prefix}:${name}'
        yield Finding(WARN, name, 'does not name a prefix with debris_scanner', advice)
    elif shutil.which('ros2') is None:
        yield Finding(OK, 'ros2', f'not here; the nodes start by debris-scan live, or from {nodes}')
    else:
        yield Finding(OK, name, f'not set; for ros2 run under pip: export {name}={sys.prefix}')


def _remedy(error: str) -> str:
    middleware = os.environ.get('RMW_IMPLEMENTATION')
    if middleware and ('rmw' in error.lower() or 'middleware' in error.lower()):
        return f'unset RMW_IMPLEMENTATION, or install {middleware.replace("_", "-")} where rclpy comes from'
    return 'source /opt/ros/jazzy/setup.bash, or: pip install "debris_scanner[ros]"'
