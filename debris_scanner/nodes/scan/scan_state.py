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

"""Topic ``state``: scanning, generating, tracking or lost, decided in one place and published by one node.

Two latched publishers would leave a late joiner with two last words. The node that generates models
also hears every verdict of the odometry, so it alone can tell all four states apart.
"""

import threading

from rclpy.node import Node
from std_msgs.msg import String

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.tracking.odometry import LOST, SCANNING, TRACKING

GENERATING = 'generating'


class ScanState:
    """The scan's state, published whenever it changes."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(String, 'state', qos.latched())
        self._lock = threading.Lock()
        self.value = ''
        self.reset()

    def reset(self) -> None:
        """A new scan."""
        self._odometry = SCANNING
        self._generating = False
        self._announced = False  # a model is out that odometry has not taken up yet
        self._update()

    def odometry(self, state: str, tracked: bool) -> None:
        """What odometry says with a frame."""
        self._odometry = state
        if tracked:
            self._announced = False
        self._update()

    def generation_began(self) -> None:
        """A model is being made."""
        self._generating = True
        self._update()

    def generation_ended(self, published: bool) -> None:
        """It was published, or there is none."""
        self._generating = False
        self._announced = published
        self._update()

    def _update(self) -> None:
        """Worker and executor both come here."""
        with self._lock:
            value = self._odometry
            if value not in (LOST, TRACKING) and (self._generating or self._announced):
                value = GENERATING
            if value != self.value:
                self.value = value
                self._publisher.publish(String(data=value))
