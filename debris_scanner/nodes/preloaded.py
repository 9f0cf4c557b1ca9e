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

"""What each node loads before it is itself, for the process that all nodes of a live scan are forked from.

Importing this module loads it: numba, SciPy, messages and kernels, three seconds of processor time. Not
rclpy, whose threads a fork would lack.
"""

import contextlib
import gc
import importlib
import signal

from debris_scanner.warm_up import warm_up

MESSAGES = ('diagnostic_msgs', 'lifecycle_msgs', 'nav_msgs', 'rcl_interfaces', 'sensor_msgs')
CONVERSIONS = ('bags', 'models', 'target_frames')


def _load() -> None:
    warm_up()
    for name in MESSAGES:
        importlib.import_module(f'{name}.msg')
    for name in CONVERSIONS:
        importlib.import_module(f'msg_adapters.{name}')


_handler = signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits for this
with contextlib.suppress(Exception):  # a node that fails for the same reason says so in its log
    _load()
signal.signal(signal.SIGINT, _handler)
gc.freeze()  # a collection would write to each object, and so copy what all nodes share
