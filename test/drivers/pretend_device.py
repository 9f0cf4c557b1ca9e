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

"""In place of a device's process: acts as told, one word a life, and leaves the library out."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.drivers.captures import DEPTH, Capture, DeviceInfo
from debris_scanner.drivers.channel import Sender
from debris_scanner.drivers.faults import DriverError, Fault


def main():
    sender = Sender(int(sys.argv[3]))
    acts = Path(json.loads(sys.argv[2])['device'])
    word, *rest = acts.read_text().split() or ['hangs']
    acts.write_text(' '.join(rest))
    if word == 'no_device':
        sender.fault(DriverError(Fault.DEVICE, 'nothing there', 'plug it in'))
        return
    if word == 'garbage':
        os.write(int(sys.argv[3]), b'\xff' * 64)
        return
    if word == 'hangs_at_once':
        signal.pause()
    sender.opened(DeviceInfo('pretended', Camera(5, 5, 2, 1, 4, 2), 'made up', False, word == 'ends', None))
    if word == 'silent':
        while True:
            time.sleep(0.1)
            sender.alive()
    for k in range(3):
        pixels = np.full((2, 4), k, np.uint16)
        sender.capture(Capture(DEPTH, pixels, k * 10**8, time.time_ns()))
    if word == 'ends':
        sender.end()
    elif word == 'crashes':
        os.kill(os.getpid(), signal.SIGSEGV)
    elif word == 'deaf':
        signal.pause()
    else:
        sys.stdin.read()


if __name__ == '__main__':
    main()
