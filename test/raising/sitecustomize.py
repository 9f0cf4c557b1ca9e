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

"""On the path of a process: methods that raise at one call, as the variable ``RAISE_AT`` names them.

It holds words such as ``debris_scanner.tracking.odometry:Odometry.process:70``: the 70th call raises, in the
first process that comes to it; a file of the folder ``RAISED`` marks that it has.
"""

import importlib
import os
import sys
from pathlib import Path


def raise_at(module: str, method: str, call: int, mark: Path) -> None:
    """Let a method raise at its n-th call, counted from 1 in this process."""
    owner = importlib.import_module(module)
    *path, name = method.split('.')
    for part in path:
        owner = getattr(owner, part)
    original, calls = getattr(owner, name), 0

    def raising(*args: object, **kwargs: object) -> object:
        nonlocal calls
        calls += 1
        if calls == call and not mark.exists():
            mark.touch()
            raise ZeroDivisionError(f'injected into call {call} of {method}')
        return original(*args, **kwargs)

    setattr(owner, name, raising)


def raise_as_asked() -> None:
    for number, word in enumerate(os.environ.get('RAISE_AT', '').split()):
        module, method, call = word.split(':')
        raise_at(module, method, int(call), Path(os.environ['RAISED']) / str(number))


if any('multiprocessing.forkserver' in word for word in sys.orig_argv):
    os.register_at_fork(after_in_child=raise_as_asked)  # calls count in the node's own process
else:
    raise_as_asked()
