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

"""Open3D, also on a machine without libusb, and without its plots until one is drawn.

For plots in notebooks it loads a web framework, which takes a quarter of its time.

Its shared library is linked against libusb, for a camera driver that is not needed here. On a machine without
libusb (a bare container) the library in the PyPI package ``libusb-package`` serves as well, provided it is
loaded first.
"""

import ctypes
import importlib
import sys
from functools import partial
from types import ModuleType
from typing import Any

from debris_scanner.core.optional import MissingLibrary

_PLOTS = 'open3d.visualization.draw_plotly'
_PLOT_FUNCTIONS = ('get_plotly_fig', 'draw_plotly', 'draw_plotly_server')


def load_open3d() -> ModuleType:
    """The module ``open3d``, also where the system has no libusb.

    Raises:
        MissingLibrary: Open3D is not installed.
        ImportError: the shared library that the message names is missing.
    """
    if 'open3d' not in sys.modules:
        _postpone_plots()
    try:
        return importlib.import_module('open3d')
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and error.name == 'open3d':
            raise MissingLibrary.named('open3d') from None
        if 'libusb' not in str(error):
            raise
        try:
            path = importlib.import_module('libusb_package').get_library_path()
        except ImportError:
            path = None
        if path is None:
            raise ImportError(
                f'Open3D cannot be loaded: {error}. Install the system package libusb-1.0-0, '
                'or `pip install libusb-package`.'
            ) from error
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
        return importlib.import_module('open3d')


def _postpone_plots() -> None:
    """Let Open3D find functions in place of its module for plots, which load it when they are called."""

    def plot(name: str, *given: Any, **named: Any) -> Any:
        if sys.modules.get(_PLOTS) is stand_in:
            del sys.modules[_PLOTS]
        return getattr(importlib.import_module(_PLOTS), name)(*given, **named)

    stand_in = ModuleType(_PLOTS)
    for name in _PLOT_FUNCTIONS:
        setattr(stand_in, name, partial(plot, name))
    sys.modules[_PLOTS] = stand_in
