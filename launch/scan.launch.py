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

A node that is killed is restarted and continues from its journal. One that was asked to end stays ended, and
one that refuses its parameters ends the launch. All of them save and end once the launch has ended, however.
"""

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, TimerAction
from launch.events.process import ProcessExited, ShutdownProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from debris_scanner.nodes.inputs.cameras import CAMERAS, parameters_of

PACKAGE = 'debris_scanner'
STAGES = ('preprocess', 'odometry', 'closure', 'graph')
BOOLEANS = ('true', 'false', 'True', 'False')
TRUE = ('true', 'True')
# whom a node does not outlive: a SIGTERM ends launch alone
PARENT = {'DEBRIS_SCANNER_PARENT': str(os.getpid())}
BAD_INPUT = 2  # exit code of a node whose parameters or bag cannot be used
# How long a node may take to end: on an interrupt the owner of the scan still optimises.
PATIENCE_S = '60'
PATIENT = {'sigterm_timeout': PATIENCE_S, 'sigkill_timeout': PATIENCE_S}
IDLE_S = 5.0
RESPAWNS = 5  # a node that dies more often is not restarted
RESPAWN_S = 0.5  # the end of a launch needs a moment to be known, or a node is started once more
VIEWED = ('target_points', 'odometry', 'model', 'model_mesh', 'graph_markers')  # topics of the RViz view

ARGUMENTS = {
    'bag': ('', 'recording to play: rosbag2 folder or file, or ROS 1 bag; empty: listen to the driver'),
    'rate': ('1.0', 'speed of the recording, as a multiple of its own'),
    'params': (
        PathJoinSubstitution([FindPackageShare(PACKAGE), 'params', 'default.yaml']),
        'parameter file of the scanner',
    ),
    'record': ('false', 'keep target_pose, odometry, state and model in a bag, in the folder of the results'),
    'rviz': ('false', 'show the scan in RViz'),
    'rviz_config': (
        PathJoinSubstitution([FindPackageShare(PACKAGE), 'rviz', 'scan.rviz']),
        'configuration of RViz',
    ),
    'view': ('false', 'show the scan in a browser on this machine, at http://127.0.0.1:8080'),
    'out': ('debris_scan', 'folder for the results'),
    'model': ('', "an earlier scan's folder, or a mesh in metres, to find and track; empty: build one"),
    'extend': ('false', 'with a model: add to it what it lacks'),
    'exit_when_done': ('false', f'save and end once no frame has come for {IDLE_S:.0f} s'),
    'composed': ('false', 'one process instead of four'),
    'namespace': ('', 'of all nodes, topics and services; two scanners need one each'),
    'frame_prefix': (
        '',
        "put before the names of the target's frames; empty: the namespace, if any",
    ),
    'publish_tf': ('true', "send the target's pose to TF"),
    'use_sim_time': ('false', 'take the time of the diagnostics from /clock; a bag is then played with it'),
    'autostart': ('true', 'configure and activate the nodes; false: a lifecycle manager does'),
    'log_level': ('info', 'least severity of what the nodes log'),
    'camera': (
        '',
        'the driver that runs, for its topics, see docs/cameras.md; of another by points, depth, ...',
    ),
    'points': ('points', "the driver's organised cloud, e.g. /camera/depth_registered/points"),
    'depth': ('depth/image_raw', "the driver's depth image, e.g. /camera/depth/image_raw"),
    'camera_info': ('depth/camera_info', "the driver's camera_info, e.g. /camera/depth/camera_info"),
    'colour': ('rgb/image_raw', "the driver's registered colour image, e.g. /camera/rgb/image_raw"),
    'mask': ('mask', 'mono8 images of the target in the depth images, of a segmentation: not 0 where it is'),
    'detection': ('detection', 'vision_msgs/Detection2D of the target, where those are installed: its box'),
    'sensor_odometry': (
        'sensor_odometry',
        'nav_msgs/Odometry of the optical frame, where the sensor moves, e.g. /camera/odom',
    ),
    'axes': ('', "the axes of the driver's clouds that point right, down and forward: a lidar's are -y,-z,x"),
    'input_reliability': ('best_available', "reliability of the sensor subscriptions: their publishers'"),
}
CHOICES = {
    'rviz': BOOLEANS,
    'view': BOOLEANS,
    'record': BOOLEANS,
    'exit_when_done': BOOLEANS,
    'extend': BOOLEANS,
    'composed': BOOLEANS,
    'publish_tf': BOOLEANS,
    'use_sim_time': BOOLEANS,
    'autostart': BOOLEANS,
    'log_level': ('debug', 'info', 'warn', 'error', 'fatal'),
    'input_reliability': ('best_available', 'best_effort', 'reliable'),
    'camera': ('', *CAMERAS),
}


class Scan:
    """The processes of one scan, and what follows when one of them ends.

    A launch may hold several scans: the end of one does not end the others.

    Args:
        stages: the nodes that scan; the last one owns the scan.
        exits: whether all ends with the owner.
        out: folder for the results.
        journals: folder that is removed once all have ended and the scan is saved.
    """

    def __init__(self, stages: tuple[str, ...], exits: bool, out: Path, journals: Path) -> None:
        self._stages, self._exits, self._out, self._journals = stages, exits, out, journals
        self._began_ns = time.time_ns()
        self._codes: dict[str, int] = {}
        self._actions: list[Action] = []
        self._ending = False

    def start(self, name: str, make: Callable[..., Node], deaths: int = 0) -> Node:
        """A process; ``make`` is given its reaction to the end, and called again for a stage that dies."""

        def react(event: ProcessExited, context: LaunchContext) -> list[Action] | None:
            self._codes[name] = event.returncode
            ended = all(self._codes.get(stage) == 0 for stage in self._stages)
            running = not (self._ending or context.is_shutdown)
            follows = self._end() if running and self._exits and self._is_over(name) else None
            if not running or ended:
                self._clean()
                return follows
            if event.returncode == BAD_INPUT:  # it would end so again; raised, launch's exit code is 1
                raise RuntimeError(f'{name} cannot be used as it was started, see above')
            if event.returncode == 0:
                return follows
            if name not in self._stages or deaths == RESPAWNS:
                return None
            again = self.start(name, make, deaths + 1)
            return [TimerAction(period=RESPAWN_S, actions=[again], cancel_on_shutdown=True)]

        action = make(on_exit=react)
        self._actions.append(action)
        return action

    def _is_over(self, name: str) -> bool:
        """Whether the process that has just ended is the scan's owner, at its end."""
        return name == self._stages[-1] and self._codes[name] == 0

    def _end(self) -> list[Action]:
        self._ending = True
        ours = tuple(self._actions)
        return [EmitEvent(event=ShutdownProcess(process_matcher=lambda action: action in ours))]

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

    def flag(name: str) -> bool:
        return value(name) in TRUE

    def path(name: str) -> str:
        """As given, but for a tilde, which the shell leaves alone behind ``:=``."""
        return str(Path(value(name)).expanduser()) if value(name) else ''

    bag, out, parameters = path('bag'), Path(path('out')), Path(path('params'))
    if not parameters.is_file():  # each of the nodes would say so
        raise RuntimeError(f'params:={parameters}: there is no such file')
    rate = speed(value('rate'))
    namespace = value('namespace').strip('/')
    stages = ('scanner',) if flag('composed') else STAGES
    exits = flag('exit_when_done')
    # a folder per launch: a respawned node finds it again, and the next launch uses another one
    journals = out / 'journal' / f'{time.time_ns()}-{os.getpid()}'
    scan = Scan(stages, exits, out, journals)
    sensor: dict[str, object] = {'input_reliability': 'reliable' if bag else value('input_reliability')}
    camera = value('camera')
    topics = {
        'points': value('points'),
        'depth/image_raw': value('depth'),
        'depth/camera_info': value('camera_info'),
        'rgb/image_raw': value('colour'),
        'mask': value('mask'),
        'detection': value('detection'),
        'sensor_odometry': value('sensor_odometry'),
    }
    if camera and not bag:
        sensor |= {name: as_text(text) for name, text in parameters_of(camera).items()}
        topics |= {ours: theirs for ours, theirs in CAMERAS[camera].items() if topics[ours] == ours}
    if axes := value('axes'):  # else the camera's, or those of the parameter file
        sensor['axes'] = as_text(axes)
    remappings = list(topics.items())
    prefix = value('frame_prefix') or (f'{namespace}/' if namespace else '')
    frames = {'frame_prefix': as_text(prefix)}
    owner = {
        'output_dir': as_text(str(out)),
        'model': as_text(path('model')),
        'extend': flag('extend'),
        'finish_after_idle': IDLE_S if bag or exits else 0.0,
        'exit_after_idle': exits,
    }
    own = {
        'preprocess': [sensor],
        'odometry': [frames, {'publish_tf': flag('publish_tf')}],
        'closure': [],
        'graph': [frames, owner],
        'scanner': [sensor, frames, {'publish_tf': flag('publish_tf')}, owner],
    }
    everywhere = {'use_sim_time': flag('use_sim_time')}
    level = ['--log-level', value('log_level')]

    def stage(name: str) -> Node:
        common = {'journal_dir': as_text(str(journals)), 'autostart': flag('autostart')} | everywhere

        def make(on_exit: Callable[..., list[Action] | None]) -> Node:
            return Node(
                package=PACKAGE,
                executable=name,
                namespace=namespace,
                output='screen',
                parameters=[str(parameters), common, *own[name]],
                remappings=[] if bag else remappings,  # play_bag publishes on the default names
                ros_arguments=level,
                additional_env=PARENT,
                on_exit=on_exit,
                **PATIENT,
            )

        return scan.start(name, make)

    def beside(executable: str, package: str = PACKAGE, **given: object) -> Node:
        def make(on_exit: Callable[..., list[Action] | None]) -> Node:
            return Node(
                package=package,
                executable=executable,
                namespace=namespace,
                output='screen',
                additional_env=PARENT,
                on_exit=on_exit,
                **given,
            )

        return scan.start(executable, make)

    actions = [stage(name) for name in stages]
    if bag:
        played = {
            'bag': as_text(bag),
            'rate': rate,
            'wait_for_stages': ' '.join(stages),
            'clock': flag('use_sim_time'),
        }
        actions.append(beside('play_bag', parameters=[played], ros_arguments=level))
    if flag('record'):
        recorded = {'bag': as_text(str(out / 'recorded'))} | everywhere
        actions.append(beside('record_scan', parameters=[recorded], ros_arguments=level, **PATIENT))
    if flag('view'):
        actions.append(beside('viewer', parameters=[everywhere], ros_arguments=level))
    if flag('rviz'):
        actions.append(
            beside(
                'rviz2',
                'rviz2',
                arguments=['-d', path('rviz_config'), '-f', f'{prefix}sensor'],  # of any driver, see odometry
                remappings=[(f'/{topic}', topic) for topic in VIEWED],
                parameters=[everywhere],
            )
        )
    return actions


def speed(text: str) -> float:
    """The argument ``rate``, whether a bag is played or not."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not 0 < number < float('inf'):
        raise RuntimeError(f'rate:={text}: a number above zero is needed')
    return number


def as_text(value: str) -> ParameterValue:
    """A parameter that stays text, whatever it looks like."""
    return ParameterValue(value, value_type=str)


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
