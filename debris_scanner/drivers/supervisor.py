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

"""Supervision of a device's process: starts it, receives its images, and restarts it after any fault."""

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from debris_scanner.drivers import channel
from debris_scanner.drivers.captures import Capture, DeviceInfo, DeviceSettings
from debris_scanner.drivers.channel import Receiver
from debris_scanner.drivers.device_process import CLOSE_S
from debris_scanner.drivers.faults import DriverError, Fault

MODULE = 'debris_scanner.drivers.device_process'
STEP_S = 0.1  # a stop takes effect this soon


class Patience(NamedTuple):
    """Timeouts, seconds."""

    opening: float = 20.0  # a library that looks for its device
    answer: float = 5.0  # a library that has opened it
    frames: float = 5.0  # between two images of a device that streams
    retry: float = 1.0  # before the second try; doubled for each further one
    most_retry: float = 15.0


@dataclass(frozen=True)
class Listener:
    """Callbacks; called from the supervisor's thread, one at a time."""

    opened: Callable[[DeviceInfo], None]
    capture: Callable[[Capture], None]
    fault: Callable[[DriverError, float], None]  # what happened, and seconds until the next try
    ended: Callable[[], None]  # the recording has come to its end


class DeviceSupervisor:
    """A thread that runs a device's process.

    Args:
        driver: ``openni2`` or ``freenect``.
        settings: of the device.
        listener: receives all events.
        patience: timeouts.
    """

    def __init__(
        self, driver: str, settings: DeviceSettings, listener: Listener, patience: Patience | None = None
    ) -> None:
        self._command = [sys.executable, '-m', MODULE, driver, json.dumps(dataclasses.asdict(settings))]
        self._listener = listener
        self._patience = patience or Patience()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='device', daemon=True)
        self._failure: Exception | None = None
        self._delivered = False
        self.process_id: int | None = None  # of the process that has the device now

    def start(self) -> None:
        """Start; the device is opened in the background."""
        self._thread.start()

    def stop(self) -> None:
        """Release the device; waits until its process has ended."""
        self._stop.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()

    def check(self) -> None:
        """Raise the error that ended the thread: a listener's, not the device's."""
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        pause = self._patience.retry
        try:
            while not self._stop.is_set():
                self._delivered = False
                try:
                    if self._one_process():
                        self._listener.ended()
                        return
                except DriverError as error:
                    if self._delivered:
                        pause = self._patience.retry
                    self._listener.fault(error, pause)
                    self._stop.wait(pause)
                    pause = min(2 * pause, self._patience.most_retry)
        except Exception as error:
            self._failure = error

    def _one_process(self) -> bool:
        """One life of the device's process; whether it played a recording to its end.

        Raises:
            DriverError: why it did not.
        """
        ours, theirs = os.pipe()
        receiver = Receiver(ours)
        process = subprocess.Popen(
            [*self._command, str(theirs)], stdin=subprocess.PIPE, pass_fds=(theirs,), start_new_session=True
        )
        os.close(theirs)
        self.process_id = process.pid
        try:
            return self._listen(receiver, process)
        finally:
            self.process_id = None
            receiver.close()
            _end(process)

    def _listen(self, receiver: Receiver, process: 'subprocess.Popen[bytes]') -> bool:
        patience = self._patience
        heard = framed = time.monotonic()
        opened = False
        while not self._stop.is_set():
            try:
                message = receiver.read(STEP_S)
            except (EOFError, ValueError):
                raise _crash(process) from None
            now = time.monotonic()
            if message is None:
                if now - heard > (patience.answer if opened else patience.opening):
                    raise DriverError(
                        Fault.SILENT,
                        f'the driver library has not answered for {now - heard:.0f} s; it is started anew',
                        'unplug the device and plug it in again if this goes on',
                    )
                continue
            kind, content = message
            heard = now
            if kind == channel.OPENED:
                opened, framed = True, now
                self._listener.opened(content)
            elif kind == channel.CAPTURE:
                framed, self._delivered = now, True
                self._listener.capture(content)
            elif kind == channel.FAULT:
                raise content
            elif kind == channel.END:
                return True
            if opened and now - framed > patience.frames:
                raise DriverError(
                    Fault.SILENT,
                    f'the device is open but has sent no image for {now - framed:.0f} s; it is opened anew',
                    'see that its plug and its power supply sit firmly, and that no other program uses it',
                )
        return False


def _crash(process: 'subprocess.Popen[bytes]') -> DriverError:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(CLOSE_S)
    code = process.returncode
    how = 'was cut off' if code is None else f'exit code {code}' if code >= 0 else signal.Signals(-code).name
    return DriverError(Fault.CRASHED, f'its process ended ({how}); it is started anew')


def _end(process: 'subprocess.Popen[bytes]') -> None:
    """Close its input, which asks it to release the device, and wait for its end; kill it if need be."""
    if process.stdin is not None:
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
    try:
        process.wait(CLOSE_S + 1.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
