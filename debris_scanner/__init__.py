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

"""Watch a rotating object with a depth sensor, close the loop, build its model, track it.

Ten lines make a scan::

    import debris_scanner as ds

    scanner = ds.Scanner()
    for stamp_ns, depth in frames:
        estimate = scanner.add(depth, camera, stamp_ns)
    result = scanner.finish()

What is named here is the library. It is loaded when it is first used: importing the package loads nothing
else and changes nothing, no environment variable either. Executables choose threads and the cache of compiled
kernels for themselves: :func:`debris_scanner.kernel_cache.prepare_process`.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from debris_scanner.core.camera import Camera
    from debris_scanner.core.frames import DepthFrame, Model
    from debris_scanner.core.results import Check
    from debris_scanner.evaluation.metrics import Truth, evaluate
    from debris_scanner.io.result_files import ScanResult
    from debris_scanner.scanner import (
        Estimate,
        Event,
        Found,
        LoopClosed,
        Lost,
        ModelBuilt,
        ModelRejected,
        Scanner,
        Tracker,
    )
    from debris_scanner.settings import Settings
    from debris_scanner.two_views import Registration, register

__version__ = '1.0.0'

_MODULE_OF = {
    'Camera': 'core.camera',
    'Check': 'core.results',
    'DepthFrame': 'core.frames',
    'Estimate': 'scanner',
    'Event': 'scanner',
    'Found': 'scanner',
    'LoopClosed': 'scanner',
    'Lost': 'scanner',
    'Model': 'core.frames',
    'ModelBuilt': 'scanner',
    'ModelRejected': 'scanner',
    'Registration': 'two_views',
    'ScanResult': 'io.result_files',
    'Scanner': 'scanner',
    'Settings': 'settings',
    'Tracker': 'scanner',
    'Truth': 'evaluation.metrics',
    'evaluate': 'evaluation.metrics',
    'register': 'two_views',
}

__all__ = [
    'Camera',
    'Check',
    'DepthFrame',
    'Estimate',
    'Event',
    'Found',
    'LoopClosed',
    'Lost',
    'Model',
    'ModelBuilt',
    'ModelRejected',
    'Registration',
    'ScanResult',
    'Scanner',
    'Settings',
    'Tracker',
    'Truth',
    'evaluate',
    'register',
]


def __getattr__(name: str) -> Any:
    """A name of the library, loaded at its first use."""
    if name not in _MODULE_OF:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(importlib.import_module(f'{__name__}.{_MODULE_OF[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """All names, for completion at a prompt."""
    return sorted({*globals(), *__all__})
