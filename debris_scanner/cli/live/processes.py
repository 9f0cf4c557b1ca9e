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

"""Node processes: :class:`Children` starts, checks and stops them, :class:`Respawn` restarts stages that die.

A stage that was killed or crashed continues from its journal.
"""

import contextlib
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import MappingProxyType, TracebackType

from debris_scanner.nodes.forked import Run, fork, run_node
from debris_scanner.nodes.lifecycle.middleware import leaked_segments
from debris_scanner.nodes.lifecycle.process import HUNG

# How long a process may take to end after SIGINT, when a scan still optimises, and after SIGTERM.
INTERRUPT_S, TERMINATE_S = 60.0, 5.0
BAD_INPUT = 2
MOST, WINDOW_S = 5, 60.0  # a stage that dies more often than this is not restarted


class ChildFailed(Exception):
    """A node's process ended when it should not have; ``code`` is its exit code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


@dataclass
class _Child:
    process: BaseProcess
    log: Path
    node: str
    arguments: list[str]


class Children:
    """The processes, by name; leaving the context stops those that still run.

    Args:
        logs: folder for their output.
        claim: descriptor of a folder's lock, which they share; see :func:`claimed`.
        variables: of their environment, beside this process's.
        run: what runs a node.
    """

    def __init__(
        self,
        logs: Path,
        claim: int | None = None,
        variables: Mapping[str, str] = MappingProxyType({}),
        run: Run = run_node,
    ) -> None:
        self._logs, self._claim, self._variables, self._run = logs, claim, variables, run
        self._children: dict[str, _Child] = {}
        logs.mkdir(parents=True, exist_ok=True)

    def start(self, node: str, arguments: Iterable[str] = (), called: str = '') -> None:
        """Start ``debris_scanner.nodes.<node>``; it ends with this process, even if that is killed.

        Args:
            node: module.
            arguments: of its command line.
            called: name among the children, if a node is started more than once.
        """
        given, called = list(arguments), called or node
        log = self._logs / f'{called}.log'
        log.write_bytes(b'')
        self._children[called] = _Child(self._spawn(node, given, log), log, node, given)

    def restart(self, node: str) -> None:
        """Start a node that has ended again, with the same arguments."""
        child = self._children[node]
        child.process = self._spawn(child.node, child.arguments, child.log)

    def _spawn(self, node: str, arguments: list[str], log: Path) -> BaseProcess:
        return fork(node, arguments, log, os.environ | self._variables, self._claim, self._run)

    def exit_code(self, node: str) -> int | None:
        """Exit code of a process; None while it runs. One whose middleware hung at its end has done all."""
        code = self._children[node].process.exitcode
        return 0 if code == HUNG else code

    def last_words(self, node: str) -> str:
        """Exit code or signal of a process that has ended, and its last line of output."""
        child = self._children[node]
        code = child.process.exitcode
        return f'{"still runs" if code is None else _how(code)}: {_last_line(child.log)}'

    def running(self, node: str) -> bool:
        """Whether a process still runs."""
        return self._children[node].process.exitcode is None

    def check(self, may_end: Iterable[str] = (), may_fail: Iterable[str] = ()) -> None:
        """Check that all processes run.

        Args:
            may_end: nodes that may end with exit code 0 or by a signal.
            may_fail: nodes that nothing depends on.

        Raises:
            ChildFailed: another one has ended.
        """
        for node, child in self._children.items():
            code = self.exit_code(node)
            if code is None or node in may_fail or (code <= 0 and node in may_end):
                continue
            raise ChildFailed(f'{node} ended unexpectedly ({_how(code)}): {_last_line(child.log)}', code)

    def interrupt(self, *nodes: str) -> None:
        """Send SIGINT: the nodes save and end."""
        for node in nodes:
            self._send(node, signal.SIGINT)

    def wait(self, node: str, timeout_s: float) -> bool:
        """Wait for the end of a process; False after the timeout."""
        self._children[node].process.join(timeout_s)
        return not self.running(node)

    def stop(self) -> None:
        """End all processes: SIGINT, then SIGTERM, then SIGKILL."""
        for number, timeout_s in (
            (signal.SIGINT, INTERRUPT_S),
            (signal.SIGTERM, TERMINATE_S),
            (signal.SIGKILL, TERMINATE_S),
        ):
            for node in self._children:
                self._send(node, number)
            deadline = time.monotonic() + timeout_s
            for node in self._children:
                self.wait(node, max(0.0, deadline - time.monotonic()))

    def _send(self, node: str, number: signal.Signals) -> None:
        pid = self._children[node].process.pid
        if self.running(node) and pid is not None:
            with contextlib.suppress(ProcessLookupError):  # it has just ended
                os.kill(pid, number)

    def __enter__(self) -> 'Children':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


class Respawn:
    """Restarts the stages of a scan.

    Args:
        children: their processes.
        stages: their names.
    """

    def __init__(self, children: Children, stages: Iterable[str]) -> None:
        self._children = children
        self._deaths: dict[str, deque[float]] = {stage: deque() for stage in stages}
        self._given_up: set[str] = set()

    @property
    def watched(self) -> list[str]:
        """Stages that the next check restarts if they have died by then."""
        return [stage for stage in self._deaths if stage not in self._given_up]

    def check(self) -> list[str]:
        """Restart the stages that have died; returns their names.

        A stage that ended for bad input, or that dies again and again, is not restarted.
        """
        restarted = []
        for stage, deaths in self._deaths.items():
            code = self._children.exit_code(stage)
            if code is None:
                continue
            if code == BAD_INPUT:
                self._given_up.add(stage)
                continue
            now = time.monotonic()
            while deaths and now - deaths[0] > WINDOW_S:
                deaths.popleft()
            if len(deaths) >= MOST:
                self._given_up.add(stage)
                continue
            deaths.append(now)
            how = self._children.last_words(stage)
            self._children.restart(stage)
            _remove_leaks()
            print(f'debris-scan live: {stage} ended ({how}) and was restarted', file=sys.stderr)
            restarted.append(stage)
        return restarted


def _how(code: int) -> str:
    return f'exit code {code}' if code >= 0 else f'signal {-code}'


def _last_line(log: Path) -> str:
    lines = log.read_text(errors='replace').strip().splitlines()
    return lines[-1].strip() if lines else 'no output'


def _remove_leaks() -> None:
    """Remove the shared memory that killed processes left behind, 64 MB each."""
    for path in leaked_segments():
        try:
            path.unlink(missing_ok=True)
        except OSError:  # owned by another user
            continue
