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

"""A node's process from start to end: set up, spin, and save the scan on SIGINT or SIGTERM."""

import gc
import multiprocessing
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from debris_scanner.core.optional import missing_libraries
from debris_scanner.nodes.lifecycle.managed import UNUSABLE, ManagedNode
from debris_scanner.nodes.lifecycle.middleware import prepare
from debris_scanner.nodes.lifecycle.parameters import refuse_unknown
from debris_scanner.nodes.lifecycle.stage import StageNode

UNSAVED, BAD_INPUT = 1, 2
PARENT = 'DEBRIS_SCANNER_PARENT'  # variable with the id of the process that a launched node must not outlive
WAKE_S = 0.1  # period of checks for signals: a wait inside the middleware cannot be interrupted
PARTING_S = 10.0  # the middleware may take to end; Fast DDS can wait for a listener for ever, at full load
ANSWERED_S = 0.5  # two heartbeats of the middleware: what is lost of an answer is sent again by then
HUNG = -signal.SIGALRM  # exit code of a process that had to be ended then: all it had to do was done
REPEAT_S = 1.0  # a SIGINT this soon after the first is the same Ctrl-C, sent by terminal and launcher


def run(make_node: Callable[[], StageNode], args: Sequence[str] | None = None, images: bool = False) -> int:
    """Run one node until it has finished or the process receives a signal; returns the exit code.

    Args:
        make_node: makes the node; its ``close`` may still publish a last message.
        args: of the command line; None: those of the process.
        images: whether the node sends images or a sensor's clouds.
    """
    remarks = prepare(images=images)
    stop = _StopOnSignal()
    # rclpy's own handlers would invalidate the context before anything could be saved and published
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # the base of rclpy's own exceptions, which have no public name
        print(_rcl_text(error), file=sys.stderr)
        return BAD_INPUT
    try:
        try:
            node = make_node()
            if not isinstance(node, ManagedNode):
                refuse_unknown(node)
            elif node.autostart:
                node.start()
        except UNUSABLE as error:
            print(f'{" ".join(str(error).split())}', file=sys.stderr)
            return BAD_INPUT
        for remark in [*remarks, *missing_libraries()]:
            node.get_logger().warning(remark)
        _spin(node, stop)
        return UNSAVED if node.unsaved else 0
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()
        stop.ignore()
        gc.freeze()  # Python would look through all objects once more as it ends: seconds on a busy machine


def _rcl_text(error: RuntimeError) -> str:
    """Why the command line or its parameter file cannot be used, without the places in rcl's sources."""
    text = ' '.join(str(error).split()).removeprefix('failed to initialize rcl: ')
    return 'the command line cannot be used: ' + re.sub(r', at \S+:\d+', '', text)


def _spin(node: StageNode, stop: '_StopOnSignal') -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    node.create_timer(WAKE_S, stop.check_parent)
    try:
        while not (stop.requested or node.finished):
            executor.spin_once()
    finally:
        node.close()
        if node.finished:  # asked to by a service, perhaps: its answer must not end with the writer
            time.sleep(ANSWERED_S)
        if not node.unsaved:
            _end_in_time()
        executor.shutdown()
        node.destroy_node()


def _end_in_time() -> None:
    """End the process by a signal that no thread has to handle, should the middleware hang."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, PARTING_S)


class _StopOnSignal:
    """SIGINT and SIGTERM request an orderly end; a second SIGINT ends the process at once."""

    def __init__(self) -> None:
        self.requested = False
        self._requested_s = 0.0
        self._starter = multiprocessing.parent_process()  # the live scan that had it forked, if any
        self._parent = os.getppid() if self._starter else int(os.environ.get(PARENT, 0))
        signal.signal(signal.SIGINT, self._request)
        signal.signal(signal.SIGTERM, self._request)

    def _request(self, number: int, _frame: FrameType | None) -> None:
        again = self.requested and time.monotonic() - self._requested_s > REPEAT_S
        if number == signal.SIGINT and again:
            raise KeyboardInterrupt
        self.requested, self._requested_s = True, time.monotonic()

    def ignore(self) -> None:
        """All is saved: a late signal must not make an orderly end look like a death.

        Python gives signals back their default, deadly, effect while it shuts down.
        """
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)

    def check_parent(self) -> None:
        """Request the end once the process that started this one has ended, or what it was forked from."""
        left = self._starter is not None and not self._starter.is_alive()
        if left or (self._parent and os.getppid() != self._parent):
            self.requested = True
