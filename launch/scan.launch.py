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

"""Scans live: with four nodes, or ``composed`` in one; ``bag`` plays a recording.

A node that is killed is restarted and continues from its journal. One that refuses its parameters ends the
launch.
"""

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'debris_scanner'
STAGES = ('preprocess', 'odometry', 'closure', 'graph')
BOOLEANS = ('true', 'false', 'True', 'False')
TRUE = ('true', 'True')
BAD_INPUT = 2  # exit code of a node whose parameters or bag cannot be used
# How long a node may take to end: on an interrupt the owner of the scan still optimises.
PATIENCE_S = '60'
IDLE_S = 5.0
RESPAWNS = 5  # a node that dies more often is not restarted
RESPAWN_S = 0.5  # the end of a launch needs a moment to be known, or a node is started once more

ARGUMENTS = {
    'bag': ('', 'recording to play: rosbag2 folder or file, or ROS 1 bag; empty: listen to the driver'),
    'rate': ('1.0', 'speed of the recording, as a multiple of its own'),
    'params': (
        PathJoinSubstitution([FindPackageShare(PACKAGE), 'params', 'default.yaml']),
        'parameter file of the scanner',
    ),
    'rviz': ('false', 'show the scan in RViz'),
    'view': ('false', 'show the scan in a browser on this machine, at http://127.0.0.1:8080'),
    'out': ('debris_scan', 'folder for the results'),
    'model': ('', "an earlier scan's folder, or a mesh in metres, to find and track; empty: build one"),
    'extend': ('false', 'with a model: add to it what it lacks'),
    'exit_when_done': ('false', 'with a bag: shut down once the scan is saved'),
    'composed': ('false', 'one process instead of four'),
    'points': ('points', "the driver's organised cloud, e.g. /camera/depth_registered/points"),
    'depth': ('depth/image_raw', "the driver's depth image, e.g. /camera/depth/image_raw"),
    'camera_info': ('depth/camera_info', "the driver's camera_info, e.g. /camera/depth/camera_info"),
    'colour': ('rgb/image_raw', "the driver's registered colour image, e.g. /camera/rgb/image_raw"),
    'input_reliability': ('best_effort', 'reliability of the sensor subscriptions'),
}
CHOICES = {
    'rviz': BOOLEANS,
    'view': BOOLEANS,
    'exit_when_done': BOOLEANS,
    'extend': BOOLEANS,
    'composed': BOOLEANS,
    'input_reliability': ('best_effort', 'reliable'),
}


class Ending:
    """What follows when a process ends.

    Args:
        stages: the nodes that scan; the last one owns the scan.
        exits: whether the launch ends with the owner.
        out: folder for the results.
        journals: folder that is removed once all have ended and the scan is saved.
    """

    def __init__(self, stages: tuple[str, ...], exits: bool, out: Path, journals: Path) -> None:
        self._stages, self._exits, self._out, self._journals = stages, exits, out, journals
        self._began_ns = time.time_ns()
        self._codes: dict[str, int] = {}

    def of(self, node: str) -> Callable[[ProcessExited, LaunchContext], list[Shutdown] | None]:
        """The reaction to the end of a node."""

        def react(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
            self._codes[node] = event.returncode
            if context.is_shutdown:
                self._clean()
            elif event.returncode == BAD_INPUT:  # it would end so again; raised, launch's exit code is 1
                raise RuntimeError(f'{node} cannot be used as it was started, see above')
            elif self._exits and node == self._stages[-1]:
                return [Shutdown(reason='the scan is finished')]
            return None

        return react

    def _clean(self) -> None:
        """Remove the journals, unless they are all that is left of the scan."""
        if not all(stage in self._codes for stage in self._stages) or self._codes[self._stages[-1]]:
            return
        summaries = [self._out / 'summary.json', self._out / 'no_model' / 'summary.json']
        if any(path.exists() and path.stat().st_mtime_ns > self._began_ns for path in summaries):
            shutil.rmtree(self._journals, ignore_errors=True)
            if not any(self._journals.parent.glob('*')):  # of other launches
                shutil.rmtree(self._journals.parent, ignore_errors=True)


def nodes(context: LaunchContext) -> list[Node]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def text(name: str) -> ParameterValue:
        return ParameterValue(value(name), value_type=str)

    bag, out = value('bag'), Path(value('out')).expanduser()
    parameters = Path(value('params')).expanduser()
    if not parameters.is_file():  # each of the nodes would say so
        raise RuntimeError(f'params:={parameters}: there is no such file')
    composed = value('composed') in TRUE
    stages = ('scanner',) if composed else STAGES
    exits = bool(bag) and value('exit_when_done') in TRUE
    # a folder per launch: a respawned node finds it again, and the next launch uses another one
    journals = out / 'journal' / f'{time.time_ns()}-{os.getpid()}'
    ended = Ending(stages, exits, out, journals)
    kept = {'journal_dir': ParameterValue(str(journals), value_type=str)}
    sensor = {'input_reliability': 'reliable' if bag else value('input_reliability')}
    remappings = [
        ('points', value('points')),
        ('depth/image_raw', value('depth')),
        ('depth/camera_info', value('camera_info')),
        ('rgb/image_raw', value('colour')),
    ]
    known = str(Path(value('model')).expanduser()) if value('model') else ''
    owner = {
        'output_dir': ParameterValue(str(out), value_type=str),
        'model': ParameterValue(known, value_type=str),
        'extend': value('extend') in TRUE,
        'finish_after_idle': IDLE_S if bag else 0.0,
        'exit_after_idle': exits,
    }
    actions = [
        Node(
            package=PACKAGE,
            executable=stage,
            output='screen',
            parameters=[
                str(parameters),
                kept,
                *([sensor] if stage == stages[0] else []),
                *([owner] if stage == stages[-1] else []),
            ],
            # play_bag publishes on the default names
            remappings=remappings if stage == stages[0] and not bag else [],
            respawn=not (exits and stage == stages[-1]),
            respawn_max_retries=RESPAWNS,
            respawn_delay=RESPAWN_S,
            on_exit=ended.of(stage),
            sigterm_timeout=PATIENCE_S,
            sigkill_timeout=PATIENCE_S,
        )
        for stage in stages
    ]
    if bag:
        rate = ParameterValue(LaunchConfiguration('rate'), value_type=float)
        played = {'bag': text('bag'), 'rate': rate, 'wait_for_stages': ' '.join(stages)}
        actions.append(
            Node(
                package=PACKAGE,
                executable='play_bag',
                output='screen',
                parameters=[played],
                on_exit=ended.of('play_bag'),
            )
        )
    if value('view') in TRUE:
        actions.append(Node(package=PACKAGE, executable='viewer', output='screen'))
    if value('rviz') in TRUE:
        view = PathJoinSubstitution([FindPackageShare(PACKAGE), 'rviz', 'scan.rviz'])
        actions.append(Node(package='rviz2', executable='rviz2', arguments=['-d', view]))
    return actions


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name, default_value=default, description=description, choices=CHOICES.get(name)
                )
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=nodes),
        ]
    )
