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

"""A node's process from start to end: set up, spin, and save what was gathered on SIGINT or SIGTERM."""

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Protocol

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from debris_scanner.core.parameters import ParameterError
from debris_scanner.io.result_files import OutputError
from debris_scanner.nodes.lifecycle.managed import ManagedNode
from debris_scanner.nodes.lifecycle.middleware import prepare
from debris_scanner.nodes.lifecycle.parameters import refuse_unknown
from msg_adapters.errors import BagError

BAD_INPUT = 2
PARENT = 'DEBRIS_SCANNER_PARENT'  # process that a node must not outlive
WAKE_S = 0.1  # signals and ends are noticed this soon: a wait inside the middleware cannot be interrupted
IMPATIENT_S = 1.0  # one Ctrl-C may arrive twice: from the terminal and from a launcher


class ProcessNode(Protocol):
    """What :func:`run` needs of a node beside being one."""

    finished: bool  # set by a node that has nothing left to do

    def close(self) -> None:
        """Save what was gathered; the context is still valid, so a last message may be published."""


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until it has finished or the process is told to end; the exit code."""
    remarks = prepare()
    stop = _StopOnSignal()
    # rclpy's own handlers would invalidate the context before anything could be saved and published
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    try:
        try:
            node = make_node()
            if not isinstance(node, ManagedNode):
                refuse_unknown(node)
            elif node.autostart:
                node.start()
        except (ParameterError, OutputError, BagError) as error:
            print(f'{" ".join(str(error).split())}', file=sys.stderr)
            return BAD_INPUT
        for remark in remarks:
            node.get_logger().warning(remark)
        _spin(node, stop)
        return 0
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()


def _spin(node: Node, stop: '_StopOnSignal') -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.create_timer(WAKE_S, stop.look_for_parent)
    try:
        while not (stop.requested or node.finished):
            executor.spin_once()
    finally:
        node.close()
        executor.shutdown()
        node.destroy_node()


class _StopOnSignal:
    """SIGINT and SIGTERM ask for the end; a second SIGINT, from somebody impatient, tears it down."""

    def __init__(self) -> None:
        self.requested = False
        self._asked_s = 0.0
        self._parent = int(os.environ.get(PARENT, 0))
        signal.signal(signal.SIGINT, self._ask)
        signal.signal(signal.SIGTERM, self._ask)

    def _ask(self, number: int, _frame: FrameType | None) -> None:
        impatient = self.requested and time.monotonic() - self._asked_s > IMPATIENT_S
        if number == signal.SIGINT and impatient:
            raise KeyboardInterrupt
        self.requested, self._asked_s = True, time.monotonic()

    def look_for_parent(self) -> None:
        """Ends with the process that started us, should that one be killed."""
        if self._parent and os.getppid() != self._parent:
            self.requested = True
