"""Scan live: the four nodes, or ``composed`` as one; with ``bag`` a recording is played to them."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = 'debris_scanner'
STAGES = ('preprocess', 'odometry', 'closure', 'graph')
TRUE = ('true', 'True', '1', 'yes')
# The owner of the scan has its last optimisation to do when it is interrupted.
PATIENCE_S = '60'
IDLE_S = 5.0

ARGUMENTS = {
    'bag': ('', 'recording to play: rosbag2 folder or file, or ROS 1 bag; empty: listen to the driver'),
    'params': (
        PathJoinSubstitution([FindPackageShare(PACKAGE), 'params', 'default.yaml']),
        'parameter file of the scanner',
    ),
    'rviz': ('false', 'show the scan in RViz'),
    'out': ('debris_scan', 'folder for the results'),
    'composed': ('false', 'one process in place of four'),
    'points': ('points', "the driver's organised cloud, e.g. /camera/depth_registered/points"),
    'depth': ('depth/image_raw', "the driver's depth image, e.g. /camera/depth/image_raw"),
    'camera_info': ('depth/camera_info', 'and its camera_info, e.g. /camera/depth/camera_info'),
    'input_reliability': ('best_effort', 'of the subscriptions to the sensor: best_effort or reliable'),
}


def nodes(context: LaunchContext) -> list[Node]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    def text(name: str) -> ParameterValue:
        return ParameterValue(value(name), value_type=str)

    bag = value('bag')
    stages = ('scanner',) if value('composed') in TRUE else STAGES
    sensor = {'input_reliability': 'reliable' if bag else value('input_reliability')}
    remappings = [
        ('points', value('points')),
        ('depth/image_raw', value('depth')),
        ('depth/camera_info', value('camera_info')),
    ]
    owner = {'output_dir': text('out'), 'finish_after_idle': IDLE_S if bag else 0.0}
    actions = [
        Node(
            package=PACKAGE,
            executable=stage,
            output='screen',
            parameters=[
                value('params'),
                *([sensor] if stage == stages[0] else []),
                *([owner] if stage == stages[-1] else []),
            ],
            # a bag's player publishes on the plain names
            remappings=remappings if stage == stages[0] and not bag else [],
            sigterm_timeout=PATIENCE_S,
            sigkill_timeout=PATIENCE_S,
        )
        for stage in stages
    ]
    if bag:
        played = {'bag': text('bag'), 'wait_for_stages': ' '.join(stages)}
        actions.append(Node(package=PACKAGE, executable='play_bag', output='screen', parameters=[played]))
    if value('rviz') in TRUE:
        view = PathJoinSubstitution([FindPackageShare(PACKAGE), 'rviz', 'scan.rviz'])
        actions.append(Node(package='rviz2', executable='rviz2', arguments=['-d', view]))
    return actions


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=nodes),
        ]
    )
