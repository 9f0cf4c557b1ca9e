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

"""Whether a driver's library is installed, tested in a process of its own: loading it may crash."""

import subprocess
import sys
from collections.abc import Sequence

from debris_scanner.drivers.faults import DriverError, Fault

# defined here, because doctor must import it even where numpy cannot be imported
OPENNI2, FREENECT = 'openni2', 'freenect'
DRIVERS = (OPENNI2, FREENECT)
_TIMEOUT_S = 20.0


def load(driver: str, library: str = '') -> str:
    """Load the library in this process; returns its name and version.

    Raises:
        DriverError: it is missing.
    """
    if driver == OPENNI2:
        from debris_scanner.drivers import openni2_library

        version = openni2_library.load(library).get_version()
        return f'OpenNI {version.major}.{version.minor}.{version.maintenance}.{version.build}'
    from debris_scanner.drivers.freenect_library import FreenectLibrary

    FreenectLibrary(library)
    return 'libfreenect'


def check_library(driver: str, library: str = '') -> str:
    """As :func:`load`, but in another process.

    Raises:
        DriverError: it is missing, or crashes.
    """
    command = [sys.executable, '-m', 'debris_scanner.drivers.library_check', driver, library]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        raise DriverError(Fault.LIBRARY, f'{driver} does not load in {_TIMEOUT_S:.0f} s') from None
    lines = done.stdout.splitlines()
    if done.returncode == 0 and lines:
        return lines[-1]
    if done.returncode == 1 and lines:
        text, _, advice = lines[-1].partition('\t')
        raise DriverError(Fault.LIBRARY, text, advice)
    raise DriverError(Fault.LIBRARY, f'{driver} crashes when it is loaded (exit code {done.returncode})')


def main(argv: Sequence[str]) -> int:
    """Print the library's name and version, or with exit code 1 why it cannot be loaded and what to do."""
    driver, library = argv
    try:
        print(load(driver, library))
    except DriverError as error:
        print(f'{error.text}\t{error.advice}')
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
