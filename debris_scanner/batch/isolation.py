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

"""A task in a process of its own: whatever it does, the worker lives, and says what happened to it."""

import contextlib
import json
import os
import pickle
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from debris_scanner.batch.template import Progress, Request, Result, send

# Linear algebra and kernels of a task stay within the one core that its slot of the worker has.
ONE_THREAD = dict.fromkeys(
    ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS'), '1'
)
_POLL_S = 0.2
_GRACE_S = 3.0
_START_S = 300.0  # imports of a busy machine, from a slow disk
_LOG_TAIL = 20_000  # characters that are kept of a failed task


class Failure(Exception):
    """A task without a result.

    Attributes:
        kind: ``error`` (it raised), ``crashed``, ``memory``, ``time`` or ``aborted``.
        name: the exception's class, for ``error``.
        log: end of what it printed.
    """

    def __init__(self, kind: str, message: str, name: str = '', log: str = '') -> None:
        super().__init__(kind, message, name, log)
        self.kind, self.message, self.name, self.log = kind, message, name, log

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True)
class Limits:
    """What a task may take; None for no bound."""

    seconds: float | None = None
    memory: int | None = None  # bytes, resident, with its children


class Isolation:
    """Runs tasks one after the other, each in a fork of one template; for one thread at a time."""

    def __init__(
        self, preload: Sequence[str], environment: Mapping[str, str], sources: Path | None = None
    ) -> None:
        """Start nothing yet.

        Args:
            preload: modules that the template imports.
            environment: variables beside this process's own.
            sources: root of the sources to import; None for those that are installed.
        """
        self._preload, self._sources = tuple(preload), sources
        # unbuffered: what a task printed before it crashed is kept
        self._environment = {**os.environ, **ONE_THREAD, 'PYTHONUNBUFFERED': '1', **environment}
        # Dask's workers give memory back at once, and ask for it page by page; a task's goes when it ends
        self._environment.pop('MALLOC_TRIM_THRESHOLD_', None)
        if sources is not None:
            paths = [str(sources), *filter(None, [self._environment.get('PYTHONPATH')])]
            self._environment['PYTHONPATH'] = os.pathsep.join(paths)
        self._template: subprocess.Popen[bytes] | None = None
        self._unread = b''
        self._pid: int | None = None  # of the task under way
        self._aborted = False
        self._lock = threading.Lock()

    def run(
        self,
        function: Callable[..., Any],
        arguments: Sequence[Any],
        scratch: Path,
        limits: Limits,
        progress: Progress | None = None,
    ) -> Any:
        """Call ``function(*arguments, progress=...)`` in a process and a folder of its own, both gone after.

        Args:
            function: pickled by its name, or by value if it has none.
            arguments: picklable.
            scratch: folder for the task's own one.
            limits: beyond which it is ended.
            progress: told the share done and a word, as the task says it.

        Raises:
            Failure: the task has no result.
        """
        import cloudpickle

        folder = Path(tempfile.mkdtemp(prefix='task-', dir=scratch))
        try:
            payload = cloudpickle.dumps((function, tuple(arguments)))
            (folder / 'work').mkdir()
            request = Request(payload, str(folder / 'result'), str(folder / 'log.txt'), str(folder / 'work'))
            return self._value(request, limits, progress or (lambda _share, _text: None))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def abort(self) -> None:
        """End the task under way, from another thread; its ``run`` raises."""
        with self._lock:
            self._aborted = True
            self._kill()

    def close(self) -> None:
        """End the template, and with it the task under way."""
        template, self._template, self._unread = self._template, None, b''
        if template is None:
            return
        assert template.stdin is not None and template.stdout is not None
        self._kill()
        for pipe in (template.stdin, template.stdout):
            with contextlib.suppress(OSError):
                pipe.close()
        try:
            template.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            template.kill()
            template.wait()

    def _value(self, request: Request, limits: Limits, progress: Progress) -> Any:
        template = self._ready()
        assert template.stdin is not None
        self._aborted = False
        send(template.stdin.fileno(), request)
        ended, status = self._watch(template, limits, progress)
        log = _tail(Path(request.log))
        if ended is not None:
            raise Failure(*ended, log=log)
        if status is None:
            self.close()
            raise Failure('crashed', 'its parent process was killed', log=log)
        if status != 0:
            raise Failure('crashed', f'its process {_words(status)}', log=log)
        result: Result = pickle.loads(Path(request.result).read_bytes())
        if result.error:
            raise Failure('error', result.message, result.error, log)
        return result.value

    def _watch(
        self, template: 'subprocess.Popen[bytes]', limits: Limits, progress: Progress
    ) -> tuple[tuple[str, str] | None, int | None]:
        """Why the task was ended, None if it was not; and its exit status, None if the template died."""
        start, ended = time.monotonic(), None
        while True:
            for said in self._answers(template, _POLL_S):
                if said is None:
                    return ended, None
                if 'pid' in said:
                    with self._lock:
                        self._pid = said['pid']
                        if self._aborted:
                            self._kill()
                elif 'share' in said:
                    progress(said['share'], said['text'])
                elif 'status' in said:
                    with self._lock:
                        self._pid = None
                    if self._aborted:
                        ended = ('aborted', 'the batch was interrupted')
                    return ended, said['status']
            if ended is None and (why := self._beyond(limits, time.monotonic() - start)) is not None:
                ended = why
                self._kill()

    def _beyond(self, limits: Limits, seconds: float) -> tuple[str, str] | None:
        if limits.seconds is not None and seconds > limits.seconds:
            return 'time', f'gave up after {limits.seconds:.0f} s'
        if (
            limits.memory is not None
            and self._pid is not None
            and (used := _resident(self._pid)) > limits.memory
        ):
            return (
                'memory',
                f'took {used / 1e6:.0f} MB of memory; a task may take {limits.memory / 1e6:.0f} MB',
            )
        return None

    def _kill(self) -> None:
        if self._pid is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._pid, signal.SIGKILL)

    def _ready(self) -> 'subprocess.Popen[bytes]':
        """The template, started if there is none."""
        if self._template is not None and self._template.poll() is None:
            return self._template
        self.close()
        command = [sys.executable, '-m', 'debris_scanner.batch.template', *self._preload]
        self._template = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=self._environment,
            start_new_session=True,  # Ctrl-C is the batch's affair
        )
        until = time.monotonic() + _START_S
        while time.monotonic() < until:
            for said in self._answers(self._template, _POLL_S):
                if said is None:
                    self.close()
                    raise Failure('crashed', f'its parent process did not start: {" ".join(command)}')
                if 'ready' in said:
                    return self._template
        self.close()
        raise Failure('time', f'its parent process did not start in {_START_S:.0f} s')

    def _answers(self, template: 'subprocess.Popen[bytes]', wait_s: float) -> list[dict[str, Any] | None]:
        """What the template and its task said; ends in None if the template is gone."""
        assert template.stdout is not None
        pipe = template.stdout.fileno()
        if not select.select([pipe], [], [], wait_s)[0]:
            return []
        data = os.read(pipe, 1 << 16)
        *lines, self._unread = (self._unread + data).split(b'\n')
        return [*(json.loads(line) for line in lines), *([] if data else [None])]


def _resident(pid: int) -> int:
    """Bytes that a process and its children hold."""
    try:
        process = psutil.Process(pid)
        family = [process, *process.children(recursive=True)]
    except psutil.Error:
        return 0
    total = 0
    for member in family:
        with contextlib.suppress(psutil.Error):
            total += member.memory_info().rss
    return total


def _tail(log: Path) -> str:
    try:
        return log.read_text(encoding='utf-8', errors='replace')[-_LOG_TAIL:]
    except OSError:
        return ''


def _words(status: int) -> str:
    if status >= 0:
        return f'ended with {status}'
    try:
        name = signal.Signals(-status).name
    except ValueError:
        name = f'signal {-status}'
    hint = ' (the system may have run out of memory)' if -status == signal.SIGKILL else ''
    return f'was ended by {name}{hint}'
