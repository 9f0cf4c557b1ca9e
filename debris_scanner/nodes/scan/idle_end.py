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

"""Notices that the input is silent, and finishes the scan when it has ended."""

import time
from collections.abc import Callable

from debris_scanner.nodes.lifecycle.parameters import declare_live
from debris_scanner.nodes.lifecycle.stage import StageNode

REPORTS_S = 2.0  # frames are counted in reports, one a second
SILENT_PERIODS = 5  # a sensor that skips so many frames is silent


class IdleEnd:
    """Calls ``finish`` once after frames have come and then none for ``finish_after_idle`` seconds.

    Args:
        node: that declares the parameters.
        frames: number of frames received so far.
        finish: called once at the end of the input.
        silent: called twice a second with whether frames have ceased to come.
    """

    def __init__(
        self,
        node: StageNode,
        frames: Callable[[], int],
        finish: Callable[[], None],
        silent: Callable[[bool], None],
    ) -> None:
        self._patience_s, self._exits = self.declare(node)
        self._node = node
        self._frames = frames
        self._finish = finish
        self._silent = silent
        self._count = 0
        self._first_s = self._last_s = time.monotonic()  # when the first and the latest frame came
        self._ended = False
        node.create_timer(0.5, self._look)

    @staticmethod
    def declare(node: StageNode) -> tuple[Callable[[], float], Callable[[], bool]]:
        """Declare the parameters; returns what reads them."""
        patience_s = declare_live(
            node,
            'finish_after_idle',
            0.0,
            'finish after so long without a frame, s; 0: never',
            0.0,
        )
        exits = declare_live(node, 'exit_after_idle', False, 'end the process after finish_after_idle')
        return patience_s, exits

    def done(self) -> None:
        """The scan is saved: end the process, if exit_after_idle is set."""
        self._node.finished = self._exits()

    def _look(self) -> None:
        count, now_s, patience_s = self._frames(), time.monotonic(), self._patience_s()
        if count != self._count:
            if count < self._count or not self._count:  # the first ones, or a new scan
                self._first_s = now_s
            self._count, self._last_s, self._ended = count, now_s, False
        idle_s = now_s - self._last_s
        period_s = (self._last_s - self._first_s) / max(1, count)
        self._silent(count > 0 and idle_s > REPORTS_S + SILENT_PERIODS * period_s)
        if count and 0 < patience_s < idle_s and not self._ended:
            self._ended = True  # only once, until frames come again
            self._node.get_logger().info(f'no frame for {patience_s:.0f} s: finishing')
            self._finish()
