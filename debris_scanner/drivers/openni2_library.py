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

"""Loading the OpenNI2 library through the PyPI binding ``openni``."""

import os
from pathlib import Path
from typing import Any

from debris_scanner.drivers.faults import DriverError, Fault

NAMES = ('libOpenNI2.so.0', 'libOpenNI2.so')  # Debian's; that of the vendors' packages
FOLDERS = ('OPENNI2_REDIST64', 'OPENNI2_REDIST')  # what the vendors' packages have users set
INSTALL_LIBRARY = 'sudo apt-get install libopenni2-0'
INSTALL_BINDING = 'pip install "debris_scanner[drivers]"'


def load(library: str = '') -> Any:
    """The binding's module ``openni2``, initialised.

    Args:
        library: file to load in place of the installed one.

    Raises:
        DriverError: the binding or the library is missing, or cannot be used.
    """
    try:
        from openni import _openni2, openni2
    except ImportError as error:
        raise DriverError(
            Fault.LIBRARY, f'the Python binding openni is not installed ({error})', INSTALL_BINDING
        ) from None
    if openni2.is_initialized():
        return openni2
    if not openni2.loaded_dll_directory:
        name = _load_first(_openni2, [library] if library else candidates())
        openni2.loaded_dll_directory = str(Path(name).parent)  # so that the binding does not load it itself
    try:
        openni2.initialize()
    except Exception as error:  # of the binding's own class, which depends on what failed
        raise DriverError(Fault.LIBRARY, f'OpenNI2 does not start: {words(error)}') from None
    return openni2


def candidates() -> list[str]:
    """Files to try, in order: the folders that users set, then where the system looks."""
    folders = [Path(os.environ[name]) for name in FOLDERS if os.environ.get(name)]
    return [str(folder / name) for folder in folders for name in NAMES if (folder / name).is_file()] + [
        *NAMES
    ]


def words(error: Exception) -> str:
    """The binding's message as plain text."""
    parts = (part.decode(errors='replace') if isinstance(part, bytes) else part for part in error.args)
    return ', '.join(part for part in parts if isinstance(part, str)) or type(error).__name__


def _load_first(binding: Any, names: list[str]) -> str:
    """Load the first that loads; returns its name."""
    reasons = []
    for name in names:
        try:
            binding.load_dll(name)
        except (OSError, AttributeError) as error:  # not there; not OpenNI2
            reasons.append(str(error))
        else:
            return name
    raise DriverError(Fault.LIBRARY, f'OpenNI2 cannot be loaded ({reasons[0]})', INSTALL_LIBRARY)
