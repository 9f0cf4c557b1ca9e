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

"""Node ``record_scan``: keeps what a scan publishes of its results in a bag, as it was sent."""

import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import Marker

from debris_scanner.back_end import FINISHED
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, Problem
from debris_scanner.nodes.lifecycle.parameters import declare_path
from debris_scanner.nodes.lifecycle.process import run
from debris_scanner.nodes.lifecycle.stage import StageNode
from msg_adapters.bag_writer import BagWriter
from msg_adapters.errors import BagError

PATIENCE_S = 60.0  # for the end of the scan, as long as its owner is there
TOPICS: dict[str, tuple[type, QoSProfile]] = {
    'target_pose': (PoseWithCovarianceStamped, qos.waiting()),
    'odometry': (Odometry, qos.waiting()),
    'state': (String, qos.latched()),
    'model': (PointCloud2, qos.latched()),
    'model_id': (String, qos.latched()),
    'model_mesh': (Marker, qos.latched()),
}


class RecordScanNode(StageNode):
    """Writes the bag from the first message on; it is whole once the scan and this node have ended.

    Interrupted together with the scan, it waits until that has published its last model and state.
    """

    def __init__(self) -> None:
        super().__init__('record_scan')
        self._folder = declare_path(self, 'bag', 'folder of the bag; if it is taken, a number is added')
        self._bag: BagWriter | None = None
        self._problem_of_bag = ''
        self._state = ''
        for topic, (kind, profile) in TOPICS.items():
            callback = partial(self._keep, self.resolve_topic_name(topic), kind)
            self.create_subscription(kind, topic, callback, profile, raw=True)
        self._states = self.create_subscription(String, 'state', self._on_state, qos.latched())

    def problem(self) -> Problem | None:
        """Why nothing is recorded any more."""
        return (ERROR, self._problem_of_bag) if self._problem_of_bag else None

    def reset(self) -> None:
        """What has been recorded stays; the next scan follows it in the bag."""

    def close(self) -> None:
        """Close the bag, once the scan has ended."""
        end_s = time.monotonic() + PATIENCE_S
        while self._state not in ('', FINISHED) and time.monotonic() < end_s:
            if not self.count_publishers(self._states.topic_name) or self.executor is None:
                break
            self.executor.spin_once(0.1)
        if self._bag is not None:
            try:
                self._bag.close()
                self.get_logger().info(f'the results are recorded in {self._bag.path}')
            except BagError as error:
                self.get_logger().error(str(error))
        super().close()

    def _on_state(self, msg: String) -> None:
        self._state = msg.data

    def _keep(self, topic: str, kind: type, data: bytes) -> None:
        if self._problem_of_bag or self._folder is None:
            return
        msgtype = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        try:
            if self._bag is None:
                self._bag = BagWriter(free_name(self._folder))
            self._bag.write_raw(topic, msgtype, time.time_ns(), data)
        except BagError as error:
            self._problem_of_bag = f'not recorded: {error}'
            self.get_logger().error(self._problem_of_bag)
            return
        self.diagnostics.counts['recorded'] += 1

    def diagnostic_values(self) -> dict[str, Any]:
        """Where the bag will be."""
        return {} if self._bag is None else {'bag': str(self._bag.path)}


def free_name(folder: Path) -> Path:
    """The folder, or the first with a number behind its name that does not exist."""
    name, number = folder, 1
    while name.exists():
        number += 1
        name = folder.with_name(f'{folder.name}_{number}')
    return name


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner record_scan``."""
    return run(RecordScanNode, args)


if __name__ == '__main__':
    sys.exit(main())
