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

"""Sources: nodes that publish a recording or a simulation in real time.

A frame that is sent before anybody listens is lost, so a :class:`WaitingNode` first waits for the nodes that
it was told to wait for, and for its subscribers. A :class:`SourceNode` then publishes a series with a
:class:`Pacer`, a thread that makes each item, waits until it is due, and sends it.
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

LATE_S = 0.02  # a frame sent longer after it was due counts as late
REMIND_S = 10.0  # how often it says what it waits for
_SETTLE_S = 1.0  # a subscriber may discover us later than we discover it
_FLUSH_S = 0.5  # lets the last message leave before its publisher ends


class Due(NamedTuple):
    """An item to send, ``offset_s`` after the start."""

    offset_s: float
    send: Callable[[int], None]  # called with the time, ns, at which it was due
    is_frame: bool


class Pacer:
    """Sends a series in real time, from a thread that makes each item while it waits for it.

    Args:
        series: items in order of time.
        wait: called before the start; if it returns False, nothing is sent.
    """

    def __init__(self, series: Iterable[Due], wait: Callable[[threading.Event], bool]) -> None:
        self._series = series
        self._wait = wait
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='pacer', daemon=True)
        self._failure: Exception | None = None
        self.sent = 0  # frames
        self.late = 0  # frames sent more than LATE_S after they were due
        self.finished = False

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop sending."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def check(self) -> None:
        """Raise the exception that ended the thread, if any."""
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
                start_ns = time.time_ns()  # when the first item is ready
            due_ns = start_ns + round(item.offset_s * 1e9)
            if self._stop.wait(max(0.0, (due_ns - time.time_ns()) * 1e-9)):
                return
            if item.is_frame and time.time_ns() - due_ns > LATE_S * 1e9:
                self.late += 1
            item.send(due_ns)
            self.sent += item.is_frame


def wait_for(condition: Callable[[], bool], stop: threading.Event, timeout_s: float) -> bool:
    """Poll a condition; False after the timeout, or once ``stop`` is set."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if stop.wait(0.05) or time.monotonic() > deadline:
            return False
    return True


class WaitingNode(StageNode):
    """A node that can wait for the subscribers of its outputs, and for other nodes to be ready.

    Args:
        name: of the node.
        wait_s: default of the longest wait, seconds.
    """

    def __init__(self, name: str, wait_s: float) -> None:
        super().__init__(name)
        self.wait_s = declare(
            self, 'wait_for_subscribers', wait_s, 'longest wait for subscribers before playing, s', 0.0
        )
        stages = declare(
            self,
            'wait_for_stages',
            '',
            'nodes to wait for until they are connected; names by spaces',
        )
        self._waiting_for = set(stages.split())
        if self._waiting_for:
            self.create_subscription(DiagnosticArray, TOPIC, self._on_diagnostics, qos.waiting())
        self.awaited: tuple[Publisher, ...] = ()  # all of them must have found a subscriber

    def wait(self, stop: threading.Event) -> bool:
        """Wait, in another thread than the executor's; False if stopped.

        The nodes are waited for however long it takes: on a new machine they compile their kernels first.
        Only the wait for other subscribers has an end, after which it returns True.
        """
        while not wait_for(lambda: not self._waiting_for, stop, REMIND_S) and not stop.is_set():
            self.get_logger().info(f'waiting for {" ".join(sorted(self._waiting_for))}')
        if not wait_for(self._matched, stop, self.wait_s) and not stop.is_set():
            self.get_logger().warning(f'no subscriber found in {self.wait_s:.0f} s: playing anyway')
        return not stop.wait(_SETTLE_S)

    @property
    def waits(self) -> bool:
        """Whether there is anything to wait for."""
        return bool(self._waiting_for) or self.wait_s > 0

    def _matched(self) -> bool:
        return all(p.get_subscription_count() for p in self.awaited)

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for report in read_reports(msg):
            if report.ready and report.namespace == self.get_namespace():
                self._waiting_for.discard(report.stage)


class SourceNode(WaitingNode):
    """Waits for subscribers, publishes its series, reports the counts in its diagnostics, and ends."""

    def __init__(self, name: str) -> None:
        super().__init__(name, wait_s=30.0)
        self._stay = declare(self, 'stay', False, 'keep running after the end, to report the counts')
        self._pacer: Pacer | None = None
        self._flushed = False

    def play(self, series: Iterable[Due], publishers: tuple[Publisher, ...]) -> None:
        """Publish a series once all publishers have a subscriber."""
        self.awaited = publishers
        self._pacer = Pacer(series, self.wait)
        self.create_timer(0.1, self._look)
        self._pacer.start()

    def diagnostic_values(self) -> dict[str, Any]:
        """Number of frames sent, and whether the series has ended."""
        pacer = self._pacer
        if pacer is None:
            return {}
        return {'finished': int(pacer.finished), 'count.published': pacer.sent, 'count.late': pacer.late}

    @property
    def ended(self) -> bool:
        """Whether the series has ended."""
        return self._pacer is not None and self._pacer.finished

    def close(self) -> None:
        """Stop sending."""
        if self._pacer is not None:
            self._pacer.stop()
        super().close()

    def reset(self) -> None:
        """A source continues; only the scan begins anew."""

    def _look(self) -> None:
        pacer = self._pacer
        assert pacer is not None
        pacer.check()
        if not pacer.finished or self._flushed:
            return
        self._flushed = True
        self.get_logger().info(f'{pacer.sent} frames sent, {pacer.late} of them late')
        self.diagnostics.publish()
        if not self._stay:
            self.create_timer(_FLUSH_S, self._finish)

    def _finish(self) -> None:
        self.finished = True
