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

"""Publishing at the right time: a thread that makes what comes next, waits until it is due, and sends it."""

import threading
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

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
