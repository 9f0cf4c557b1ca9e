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

"""What the simulator and the player have in common: a node that publishes a recording in real time."""

from collections.abc import Iterable
from typing import Any

from rclpy.publisher import Publisher

from debris_scanner.nodes.pacing import Due, Pacer
from debris_scanner.nodes.parameters import declare
from debris_scanner.nodes.waiting import WaitingNode

_FLUSH_S = 0.5  # the last message leaves before its writer does


class SourceNode(WaitingNode):
    """Waits for subscribers, publishes its series, says so in its diagnostics, and ends."""

    def __init__(self, name: str) -> None:
        super().__init__(name, wait_s=30.0)
        self._stay = declare(self, 'stay', False, 'go on living after the end, with its counts to be read')
        self._pacer: Pacer | None = None
        self._flushed = False

    def play(self, series: Iterable[Due], publishers: tuple[Publisher, ...]) -> None:
        """Begin; all of the publishers must have found a subscriber."""
        self.awaited = publishers
        self._pacer = Pacer(series, self.wait)
        self.create_timer(0.1, self._look)
        self._pacer.start()

    def diagnostic_values(self) -> dict[str, Any]:
        """Frames sent, and whether those were all."""
        pacer = self._pacer
        if pacer is None:
            return {}
        return {'finished': int(pacer.finished), 'count.published': pacer.sent, 'count.late': pacer.late}

    def close(self) -> None:
        """Stop sending."""
        if self._pacer is not None:
            self._pacer.stop()
        super().close()

    def ended(self) -> None:
        """Called once, when the series has come to its end."""

    def reset(self) -> None:
        """A recording goes on; what it shows is for the others to scan anew."""

    def _look(self) -> None:
        pacer = self._pacer
        assert pacer is not None
        pacer.check()
        if not pacer.finished or self._flushed:
            return
        self._flushed = True
        self.get_logger().info(f'{pacer.sent} frames sent, {pacer.late} of them late')
        self.diagnostics.publish()
        self.ended()
        if not self._stay:
            self.create_timer(_FLUSH_S, self._finish)

    def _finish(self) -> None:
        self.finished = True
