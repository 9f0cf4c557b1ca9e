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

A stage that was killed or crashed continues from its journal. A process on standby, which has loaded all
stages, takes its place at once.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, TracebackType

from debris_scanner.io.files import CLAIM
from debris_scanner.nodes.lifecycle.middleware import leaked_segments
from debris_scanner.nodes.lifecycle.process import HUNG, PARENT

# How long a process may take to end after SIGINT, when a scan still optimises, and after SIGTERM.
INTERRUPT_S, TERMINATE_S = 60.0, 5.0
BAD_INPUT = 2
STANDBY = 'standby'
MOST, WINDOW_S = 5, 60.0  # a stage that dies more often than this is not restarted
CALM_S = 5.0  # a restarted stage needs the processor first, before the next standby process is started


class ChildFailed(Exception):
    """A node's process ended when it should not have; ``code`` is its exit code."""

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


@dataclass
class _Child:
    process: 'subprocess.Popen[bytes]'
    log: Path
    node: str
    arguments: list[str]


class Children:
    """The processes, by name; leaving the context stops those that still run.

    Args:
        logs: folder for their output.
        claim: descriptor of a folder's lock, which they share; see :func:`claimed`.
        variables: of their environment, beside this process's.
    """

    def __init__(
        self, logs: Path, claim: int | None = None, variables: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._logs = logs
        self._variables = variables
        self._claim = claim
        self._children: dict[str, _Child] = {}
        self._standby: subprocess.Popen[bytes] | None = None
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

    def stand_by(self) -> None:
        """Start a process that can run any stage at once, for :meth:`restart`."""
        if self._standby is None or self._standby.poll() is not None:
            self._standby = self._spawn(STANDBY, [], self._logs / f'{STANDBY}.log')

    def restart(self, node: str) -> None:
        """Start a node that has ended again, with the same arguments."""
        child, spare = self._children[node], self._standby
        if spare is None or spare.poll() is not None:
            child.process = self._spawn(child.node, child.arguments, child.log)
            return
        assert spare.stdin is not None
        order = json.dumps([child.node, child.arguments, str(child.log)])
        spare.stdin.write(f'{order}\n'.encode())
        spare.stdin.flush()
        child.process, self._standby = spare, None

    def _spawn(self, node: str, arguments: list[str], log: Path) -> 'subprocess.Popen[bytes]':
        environment = os.environ | self._variables | {PARENT: str(os.getpid()), 'PYTHONUNBUFFERED': '1'}
        if self._claim is not None:
            environment[CLAIM] = str(self._claim)
        with log.open('ab') as output:
            return subprocess.Popen(
                # -P: a folder debris_scanner in the current folder is not the package
                [sys.executable, '-P', '-m', f'debris_scanner.nodes.{node}', *arguments],
                stdin=subprocess.PIPE if node == STANDBY else subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                pass_fds=() if self._claim is None else (self._claim,),
                start_new_session=True,  # Ctrl-C in the terminal goes to this process alone
            )

    def exit_code(self, node: str) -> int | None:
        """Exit code of a process; None while it runs. One whose middleware hung at its end has done all."""
        code = self._children[node].process.poll()
        return 0 if code == HUNG else code

    def last_words(self, node: str) -> str:
        """Exit code or signal of a process that has ended, and its last line of output."""
        child = self._children[node]
        return f'{_how(child.process.returncode)}: {_last_line(child.log)}'

    def running(self, node: str) -> bool:
        """Whether a process still runs."""
        return self._children[node].process.poll() is None

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
            if self.running(node):
                self._children[node].process.send_signal(signal.SIGINT)

    def wait(self, node: str, timeout_s: float) -> bool:
        """Wait for the end of a process; False after the timeout."""
        try:
            self._children[node].process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self) -> None:
        """End all processes: SIGINT, then SIGTERM, then SIGKILL."""
        if self._standby is not None:
            self._standby.kill()  # it has nothing to save
            self._standby.wait()
        for number, timeout_s in (
            (signal.SIGINT, INTERRUPT_S),
            (signal.SIGTERM, TERMINATE_S),
            (signal.SIGKILL, TERMINATE_S),
        ):
            for child in self._children.values():
                if child.process.poll() is None:
                    child.process.send_signal(number)
            deadline = time.monotonic() + timeout_s
            for node in self._children:
                self.wait(node, max(0.0, deadline - time.monotonic()))

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
        self._stand_by_s = float('inf')  # when to start the standby process

    @property
    def watched(self) -> list[str]:
        """Stages that the next check restarts if they have died by then."""
        return [stage for stage in self._deaths if stage not in self._given_up]

    def begin(self) -> None:
        """All stages run: start the standby process."""
        if self._deaths:
            self._stand_by_s = time.monotonic()

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
            self._stand_by_s = now + CALM_S
        if time.monotonic() >= self._stand_by_s:
            self._stand_by_s = float('inf')
            self._children.stand_by()
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
