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

"""Topic ``sensor_odometry``: how the sensor moves, for the dynamics of the target."""

from nav_msgs.msg import Odometry
from rclpy.node import Node

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import add_sensor_odometry

TOPIC = 'sensor_odometry'
QUEUE = 200  # samples: a second of a fast odometry


def follow_sensor(node: Node, path: SensorPath) -> None:
    """Add what comes on the topic to the path; unreadable messages are left out, with a line in the log."""

    def on_odometry(msg: Odometry) -> None:
        try:
            add_sensor_odometry(path, msg)
        except MalformedMessage as error:
            name = node.resolve_topic_name(TOPIC)
            node.get_logger().warning(f'message on {name} rejected: {error}', throttle_duration_sec=5.0)

    node.create_subscription(Odometry, TOPIC, on_odometry, qos.sensor_input('best_effort', QUEUE))
