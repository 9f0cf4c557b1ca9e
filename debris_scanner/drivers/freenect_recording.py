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

"""Folders that libfreenect's ``record`` wrote and fakenect replays: checked first, for fakenect aborts.

``INDEX.txt`` names one file a line, ``d-SECONDS-TICKS.pgm`` a depth image of raw 11-bit values,
``r-...ppm`` a colour image, ``a-...dump`` the accelerometer; each image is a header line and its pixels.
"""

from pathlib import Path

from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.drivers.kinect_depth import HEIGHT, WIDTH

INDEX = 'INDEX.txt'
PIXEL_BYTES = {'d': 2, 'r': 3}
_LONGEST_HEADER = 100
_IS_A_FOLDER = 'name a folder that libfreenect\'s "record" wrote'


def check_recording(folder: Path) -> int:
    """Depth images of a recording.

    Raises:
        DriverError: fakenect would end the process, or read past the end of a file.
    """
    index = folder / INDEX
    try:
        text = index.read_text(errors='replace')
    except OSError as error:
        raise DriverError(Fault.RECORDING, f'{index}: {error.strerror}', _IS_A_FOLDER) from None
    if not text.endswith('\n') or '\n\n' in text or text.startswith('\n'):
        raise DriverError(Fault.RECORDING, f'{index} is empty or cut off, or has an empty line', _IS_A_FOLDER)
    depths = 0
    for line in text.splitlines():
        kind, file = line[:1], folder / line
        if Path(line).name != line:
            raise DriverError(Fault.RECORDING, f'{index} names {line!r}, which is not in its folder')
        try:
            with file.open('rb') as opened:
                header = opened.read(_LONGEST_HEADER)
            size = file.stat().st_size
        except OSError as error:
            raise DriverError(Fault.RECORDING, f'{file}: {error.strerror}') from None
        wanted = PIXEL_BYTES.get(kind, 0) * WIDTH * HEIGHT
        if size == 0 or (wanted and size != header.find(b'\n') + 1 + wanted):
            raise DriverError(Fault.RECORDING, f'{file} is not an image of {WIDTH} x {HEIGHT} pixels')
        depths += kind == 'd'
    if not depths:
        raise DriverError(Fault.RECORDING, f'{folder} holds no depth image', _IS_A_FOLDER)
    return depths
