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

"""Sources wait until somebody listens: a frame that is sent earlier would be lost."""

import threading

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.publisher import Publisher

from debris_scanner.nodes import qos
from debris_scanner.nodes.diagnostics import TOPIC, read_reports
from debris_scanner.nodes.pacing import wait_for
from debris_scanner.nodes.parameters import declare
from debris_scanner.nodes.stage import StageNode

_SETTLE_S = 1.0  # the subscriber may still be finding us when we have found it


class WaitingNode(StageNode):
    """A node that can wait for the subscribers of its outputs, and for stages that must be ready.

    Args:
        name: of the node.
        wait_s: default of how long to wait, seconds.
    """

    def __init__(self, name: str, wait_s: float) -> None:
        super().__init__(name)
        self.wait_s = declare(
            self, 'wait_for_subscribers', wait_s, 'how long to wait for them before playing to nobody, s', 0.0
        )
        stages = declare(
            self, 'wait_for_stages', '', 'nodes that must have found each other too, names by spaces'
        )
        self._waiting_for = set(stages.split())
        if self._waiting_for:
            self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.awaited: tuple[Publisher, ...] = ()  # all of them must have found a subscriber

    def wait(self, stop: threading.Event) -> bool:
        """Wait, in a thread of its own; whether to begin, which is so after all patience too."""
        matched = wait_for(self._all_there, stop, self.wait_s)
        if stop.is_set():
            return False
        if not matched:
            missing = ' '.join(sorted(self._waiting_for)) or 'a subscriber'
            self.get_logger().warning(f'no sign of {missing} in {self.wait_s:.0f} s: playing regardless')
        return not stop.wait(_SETTLE_S)

    def _all_there(self) -> bool:
        return not self._waiting_for and all(p.get_subscription_count() for p in self.awaited)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.ready and report.namespace == self.get_namespace():
                self._waiting_for.discard(report.stage)
