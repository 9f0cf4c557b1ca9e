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

"""The process that owns a device: C libraries that abort, hang or leak cannot take the node with them.

:mod:`debris_scanner.drivers.supervisor` starts it with the arguments DRIVER SETTINGS FD; it ends when its
standard input does.
"""

import dataclasses
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress

from debris_scanner.drivers.captures import COLOUR, DEPTH, Capture, DepthDevice, DeviceSettings
from debris_scanner.drivers.channel import Sender
from debris_scanner.drivers.device_clock import DeviceClock, RateLimit
from debris_scanner.drivers.faults import DriverError, EndOfRecording
from debris_scanner.drivers.library_check import OPENNI2

READ_S = 0.5  # a message goes to the supervisor at least this often
SETTLE_FRAMES = 5  # skipped of a device: the first come late and would mistie its clock
CLOSE_S = 2.0  # time for a library to release its device


def open_device(driver: str, settings: DeviceSettings) -> DepthDevice:
    """The device of a driver.

    Raises:
        DriverError: it cannot be opened.
    """
    if driver == OPENNI2:
        from debris_scanner.drivers.openni2_device import OpenNI2Device

        return OpenNI2Device(settings)
    from debris_scanner.drivers.freenect_device import FreenectDevice

    return FreenectDevice(settings)


def stream(device: DepthDevice, sender: Sender, max_rate_hz: float, stop: threading.Event) -> None:
    """Send the device's images, at most at the requested rate, until stopped.

    After each depth image the newest colour image is sent.

    Raises:
        DriverError: the device is gone.
        EndOfRecording: nothing will come any more.
    """
    limit = RateLimit(max_rate_hz)
    clocks = {name: DeviceClock(device.info.recording) for name in (DEPTH, COLOUR)}
    to_skip = 0 if device.info.recording else SETTLE_FRAMES
    colour: Capture | None = None
    due = False
    sender.opened(device.info)
    while not stop.is_set():
        capture = device.read(READ_S)
        if capture is not None:
            stamp = clocks[capture.stream].stamp_ns(capture.device_ns, capture.arrival_ns)
            capture = dataclasses.replace(capture, stamp_ns=stamp)
        if capture is None or to_skip:
            to_skip -= capture is not None and capture.stream == DEPTH
            sender.alive()
        elif capture.stream != DEPTH:
            colour = capture
        elif limit.passes(capture.device_ns):
            sender.capture(capture)
            due = True
        else:
            sender.alive()
        if due and colour is not None:
            sender.capture(colour)
            colour, due = None, False


def main(argv: Sequence[str]) -> int:
    """Open the device, stream, and report how it ended; then exit with code 0."""
    driver, settings, fd = argv
    sender = Sender(int(fd))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the node's; our input ends then
    stop = threading.Event()
    threading.Thread(target=_end_with_input, args=(stop,), daemon=True).start()
    device: DepthDevice | None = None
    given = DeviceSettings(**json.loads(settings))
    try:
        device = open_device(driver, given)
        stream(device, sender, given.max_rate_hz, stop)
    except DriverError as error:
        with suppress(BrokenPipeError):  # our node has gone
            sender.fault(error)
    except EndOfRecording:
        with suppress(BrokenPipeError):
            sender.end()
    except BrokenPipeError:
        pass
    if device is not None:
        device.close()
    # skip the interpreter's shutdown: threads that a library left behind would use freed memory
    sys.stdout.flush()
    os._exit(0)


def _end_with_input(stop: threading.Event) -> None:
    sys.stdin.buffer.read()
    stop.set()
    threading.Event().wait(CLOSE_S)
    os._exit(0)  # a library hangs; nobody waits any more


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
