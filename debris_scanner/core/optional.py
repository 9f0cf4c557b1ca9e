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

"""Libraries without a rosdep key: everything imports without them, and what needs one says so by name.

All kernels are compiled by :func:`kernel` or :func:`inlined`: numba's ``njit`` with one error model. Division
by zero gives inf or NaN, as in numpy, and never ends a scan; kernels guard what they divide by. Without numba
each kernel is a function that raises :class:`MissingLibrary`: as plain Python a frame would take minutes.
"""

import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Any

__all__ = ['Absent', 'MissingLibrary', 'array_at', 'inlined', 'kernel', 'missing_libraries', 'pointer']

EXTRA = 'scan'  # of setup.py: all of them


class MissingLibrary(ImportError):
    """A library that is not installed; the message says what does not work without it, and how to get it."""

    @classmethod
    def named(cls, library: str) -> 'MissingLibrary':
        """Of a library."""
        return cls(f"{library} is not installed: {WITHOUT[library]}; pip install 'debris_scanner[{EXTRA}]'")


class Absent:
    """Stands in for a name of a library that is not installed: any use raises :class:`MissingLibrary`.

    Args:
        library: that is missing.
    """

    def __init__(self, library: str) -> None:
        self._library = library

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Raise MissingLibrary."""
        raise MissingLibrary.named(self._library)

    def __getattr__(self, name: str) -> Any:
        """Raise MissingLibrary, but for what Python itself asks of an object."""
        if name.startswith('__'):
            raise AttributeError(name)
        raise MissingLibrary.named(self._library)


WITHOUT = {
    'numba': 'no frame can be processed',
    'open3d': 'no mesh can be read or rendered, so no known model, simulation, report or evaluation',
    'rosbags': 'no recording can be read or written',
}


def missing_libraries() -> list[str]:
    """What does not work here, a text for each library that is not installed."""
    return [str(MissingLibrary.named(name)) for name in WITHOUT if not _is_installed(name)]


def _is_installed(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ImportError:
        return False


try:
    from numba import carray as array_at
    from numba import njit, types
    from numba.core import cgutils
    from numba.extending import intrinsic

    @intrinsic
    def pointer(_typing: Any, _address: Any) -> Any:
        """In a kernel, the pointer to an address, of which ``array_at`` makes an array."""

        def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
            return builder.inttoptr(given[0], cgutils.voidptr_t)

        return types.voidptr(types.intp), generate

except ImportError:
    array_at = pointer = Absent('numba')

    def njit(*given: Any, **_: Any) -> Any:
        """As numba's decorator, with or without signature and options."""
        absent = Absent('numba')
        if given and callable(given[0]):
            return absent
        return lambda _kernel: absent


_compiled = partial(njit, nogil=True, error_model='numpy')


def kernel(*, fastmath: bool = False) -> Callable[[Any], Any]:
    """Decorate a function to be compiled for the types of its first call, once a machine.

    It takes no signature: with one, each process that imports the module would load what is compiled, which
    takes half a second, whether it calls the function or not.

    Args:
        fastmath: whether sums may be reordered, which is quicker; NaN must not be told from numbers there.
    """
    decorate: Callable[[Any], Any] = _compiled(cache=True, fastmath=fastmath)
    return decorate


def inlined(function: Any) -> Any:
    """A function to be compiled as a part of each kernel that calls it."""
    return _compiled(inline='always', fastmath=True)(function)
