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

"""Nodes as forks of one process that has loaded what all of them load: Python's own fork server.

A live scan has five to seven node processes, and each would load for three seconds of processor time. Forked,
a node is there within half a second, also in the place of one that was killed, and shares the memory of what
is loaded.
"""

import contextlib
import importlib
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import reduction
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from debris_scanner.io.files import CLAIM

PRELOADED = 'debris_scanner.nodes.preloaded'

Run = Callable[[str, Sequence[str]], int]


def load(variables: Mapping[str, str]) -> None:
    """Start the process that nodes are forked from, and wait until it has loaded and compiled everything.

    Args:
        variables: of its environment, beside this process's.
    """
    # safe path: a folder debris_scanner in the current folder is not the package
    given = {'PYTHONSAFEPATH': '1', **variables}
    before = {name: os.environ.get(name) for name in given}
    os.environ.update(given)
    try:
        context = multiprocessing.get_context('forkserver')
        context.set_forkserver_preload([PRELOADED])
        first = context.Process(target=_do_nothing)
        first.start()
        first.join()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def run_node(node: str, arguments: Sequence[str]) -> int:
    """Run ``debris_scanner.nodes.<node>`` in this process; its exit code."""
    code: int = importlib.import_module(f'debris_scanner.nodes.{node}').main(list(arguments))
    return code


def fork(
    node: str,
    arguments: Sequence[str],
    log: Path,
    environment: Mapping[str, str],
    claim: int | None = None,
    run: Run = run_node,
) -> BaseProcess:
    """Start a node in a process and a session of its own; it ends with this process, even if that is killed.

    Args:
        node: module.
        arguments: of its command line.
        log: file that its output is appended to.
        environment: of the process.
        claim: descriptor of a folder's lock, which it shares; see :func:`~debris_scanner.io.files.claimed`.
        run: what runs it.
    """
    context = multiprocessing.get_context('forkserver')
    shared = None if claim is None else _Descriptor(claim)
    given = (run, node, list(arguments), str(log), dict(environment), str(Path.cwd()), shared)
    process = context.Process(target=_become, args=given, name=node)
    process.start()
    return process


class _Descriptor:
    """A file descriptor as an argument of a process that is being started."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __reduce__(self) -> tuple[Callable[[Any], int], tuple[Any]]:
        return _received, (reduction.DupFd(self._number),)


def _received(sent: Any) -> int:
    number: int = sent.detach()
    return number


def _do_nothing() -> None:
    pass


def _become(
    run: Run,
    node: str,
    arguments: list[str],
    log: str,
    environment: dict[str, str],
    folder: str,
    claim: int | None,
) -> None:
    os.setsid()  # Ctrl-C in the terminal goes to the parent alone
    with contextlib.suppress(OSError):  # top and pgrep show this name
        Path('/proc/self/comm').write_text(node)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    if claim is not None:
        os.environ[CLAIM] = str(claim)
    with Path(log).open('ab') as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # in order with the errors
    sys.argv = [node, *arguments]
    sys.exit(run(node, arguments))
