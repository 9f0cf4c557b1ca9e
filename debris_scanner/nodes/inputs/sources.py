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

"""Publishing at the right time: a thread that makes what comes next, waits until it is due, and sends it.

Sources wait until somebody listens: a frame that is sent earlier would be lost.

What the simulator and the player have in common: a node that publishes a recording in real time.
"""

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.publisher import Publisher

from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import TOPIC, read_reports
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import StageNode

LATE_S = 0.02


class Due(NamedTuple):
    """Something to send, this long after the start."""

    offset_s: float
    send: Callable[[int], None]  # called with the time, ns, at which it was due
    is_frame: bool


class Pacer:
    """Sends a series in real time; making an item may take as long as the time until it is due.

    Args:
        series: made item by item, in order of time.
        wait: called before the start; False gives up.
    """

    def __init__(self, series: Iterable[Due], wait: Callable[[threading.Event], bool]) -> None:
        self._series = series
        self._wait = wait
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='pacer', daemon=True)
        self._failure: Exception | None = None
        self.sent = 0  # frames
        self.late = 0  # frames sent noticeably after they were due
        self.finished = False

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Send nothing more."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def check(self) -> None:
        """Raise here what ended the thread."""
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            if self._wait(self._stop):
                self._send_all()
        except Exception as error:
            self._failure = error
        finally:
            self.finished = True

    def _send_all(self) -> None:
        start_ns = None
        for item in self._series:
            if start_ns is None:
                start_ns = time.time_ns()  # when the first is ready
            due_ns = start_ns + round(item.offset_s * 1e9)
            if self._stop.wait(max(0.0, (due_ns - time.time_ns()) * 1e-9)):
                return
            if item.is_frame and time.time_ns() - due_ns > LATE_S * 1e9:
                self.late += 1
            item.send(due_ns)
            self.sent += item.is_frame


def wait_for(condition: Callable[[], bool], stop: threading.Event, timeout_s: float) -> bool:
    """Whether a condition came true in time and nobody asked to stop; polled."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if stop.wait(0.05) or time.monotonic() > deadline:
            return False
    return True


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
