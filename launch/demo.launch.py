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

"""Scans a simulated target: ``scan.launch.py`` with a simulated camera."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, SetEnvironmentVariable
from launch.conditions import UnlessCondition
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'debris_scanner'
BAD_INPUT = 2  # exit code of a node whose parameters cannot be used
BOOLEANS = ('true', 'false', 'True', 'False')

ARGUMENTS = {
    'target': ('shuttle_stack', 'target to simulate, by name, or a mesh file'),
    'motion': ('spin', 'motion of the target'),
    'seconds': ('60.0', 'length of the simulation, s'),
    'rviz': ('false', 'show the scan in RViz'),
    'view': ('false', 'show the scan in a browser on this machine, at http://127.0.0.1:8080'),
    'out': ('debris_demo', 'folder for the results'),
    'exit_when_done': ('false', 'save and end once the simulation is over'),
    'network': ('false', 'allow other machines to connect; otherwise this one only'),
}


def text(name: str) -> ParameterValue:
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def refused(event: ProcessExited, _context: LaunchContext) -> None:
    """End the launch, with exit code 1, if there is nothing to scan."""
    if event.returncode == BAD_INPUT:
        raise RuntimeError('sim_kinect cannot be used as it was started, see above')


def generate_launch_description() -> LaunchDescription:
    scan = PathJoinSubstitution([FindPackageShare(PACKAGE), 'launch', 'scan.launch.py'])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name,
                    default_value=default,
                    description=description,
                    choices=BOOLEANS if default in BOOLEANS else None,
                )
                for name, (default, description) in ARGUMENTS.items()
            ),
            SetEnvironmentVariable(
                'ROS_AUTOMATIC_DISCOVERY_RANGE',
                'LOCALHOST',
                condition=UnlessCondition(LaunchConfiguration('network')),
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(scan),
                launch_arguments={
                    'rviz': LaunchConfiguration('rviz'),
                    'view': LaunchConfiguration('view'),
                    'out': LaunchConfiguration('out'),
                    'exit_when_done': LaunchConfiguration('exit_when_done'),
                    'input_reliability': 'reliable',
                }.items(),
            ),
            Node(
                package=PACKAGE,
                executable='sim_kinect',
                output='screen',
                on_exit=refused,
                parameters=[
                    {
                        'target': text('target'),
                        'motion': text('motion'),
                        'seconds': ParameterValue(LaunchConfiguration('seconds'), value_type=float),
                        'truth_dir': ParameterValue([LaunchConfiguration('out'), '/truth'], value_type=str),
                        'wait_for_stages': 'preprocess odometry closure graph',
                    }
                ],
            ),
        ]
    )
