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

"""A process that has loaded all stages and waits for the order to run one of them.

Loading takes two seconds, in which a target turns too far to be tracked; a process on standby is ready within
some tenths of a second.
"""

import importlib
import json
import os
import sys
from pathlib import Path
from typing import NamedTuple

from debris_scanner.warm_up import warm_up

STAGES = ('preprocess', 'odometry', 'closure', 'graph', 'scanner')


class Order(NamedTuple):
    """The node to run, its arguments, and the file for its output."""

    node: str
    arguments: list[str]
    log: str


def main() -> int:
    """Entry point of ``python -m debris_scanner.nodes.standby``; the order is a line of JSON on stdin."""
    for stage in STAGES:
        importlib.import_module(f'debris_scanner.nodes.{stage}')
    warm_up()
    line = sys.stdin.readline()
    if not line:  # the parent has ended
        return 0
    order = Order(*json.loads(line))
    with Path(order.log).open('ab') as log:
        os.dup2(log.fileno(), sys.stdout.fileno())
        os.dup2(log.fileno(), sys.stderr.fileno())
    code: int = importlib.import_module(f'debris_scanner.nodes.{order.node}').main(order.arguments)
    return code


if __name__ == '__main__':
    sys.exit(main())
