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

"""Scans that take no time and break as the recording says, and the verb with them."""

import os
import signal
import sys
import time
from pathlib import Path

from debris_scanner.batch.recording import BadRecording
from debris_scanner.core.results import CAMERA_INFO, NO_TARGET
from debris_scanner.io.result_files import ScanResult, write_results

DONE = 'STUB_SCANS_DONE'  # variable that names a file with a line a scan begun


def scan(bag, out, params):
    """The recording's words say what happens to it."""
    words = bag.read_bytes().split()
    with Path(os.environ[DONE]).open('a') as file:
        file.write(f'{bag.name}\n')
    print('scanning', bag.name)
    if b'poison' in words:
        raise BadRecording('not a bag')
    if b'crash' in words:
        os.kill(os.getpid(), signal.SIGSEGV)
    if b'greedy' in words:
        taken = []
        while True:
            taken.append(bytearray(b'x' * 20_000_000))
            time.sleep(0.02)
    if b'full' in words:
        raise OSError(28, 'No space left on device')
    if b'slow' in words:
        time.sleep(float(words[1]))
    wrong = b'uncalibrated' in words
    result = ScanResult(CAMERA_INFO, None, hint='fx 0') if wrong else ScanResult(NO_TARGET, None)
    write_results(out, result, 0.0)


def stub(number, progress):
    """A task that costs nothing."""
    return number


def recordings(folder, **contents):
    """Files that count as recordings, by the words in them."""
    folder.mkdir(exist_ok=True)
    for name, words in contents.items():
        (folder / f'{name}.mcap').write_text(f'{words} name:{name}')
    return folder


if __name__ == '__main__':  # the verb with such scans
    import stub_scans

    from debris_scanner.cli import batch
    from debris_scanner.cli.main import main

    batch.scan_quietly = stub_scans.scan
    sys.exit(main(sys.argv[1:]))
