"""A process that has loaded everything and waits to be told which node it is.

Loading takes two seconds, in which a target turns too far to be followed; a node that stands by is back
in some tenths of one.
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
    """Which node to be, with which arguments, and where to print."""

    node: str
    arguments: list[str]
    log: str


def main() -> int:
    """Entry point of ``python -m debris_scanner.nodes.standby``; the order is a line of JSON on stdin."""
    mains = {stage: importlib.import_module(f'debris_scanner.nodes.{stage}').main for stage in STAGES}
    warm_up()
    line = sys.stdin.readline()
    if not line:  # whoever started us has ended
        return 0
    order = Order(*json.loads(line))
    with Path(order.log).open('ab') as log:
        os.dup2(log.fileno(), sys.stdout.fileno())
        os.dup2(log.fileno(), sys.stderr.fileno())
    code: int = mains[order.node](order.arguments)
    return code


if __name__ == '__main__':
    sys.exit(main())
