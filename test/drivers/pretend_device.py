"""In place of a device's process: acts as told, one word a life, and leaves the library out."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from debris_scanner.camera import Camera
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
