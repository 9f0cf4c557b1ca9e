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

"""The process that tasks are forked from: it has loaded the libraries once and never runs a task itself.

``python -m debris_scanner.batch.template MODULE[:FUNCTION]...`` imports the modules, calls the functions, and
then takes requests on stdin.
A fork costs milliseconds where a new interpreter costs seconds of imports, and yet each task has a process to
itself: what it leaks or breaks ends with it. Forking is safe as long as there is one thread, so that a module
which starts one is named on stderr.

Request: length (8 bytes), then a pickled ``Request``. Answers on stdout: lines of JSON, each short
enough to be written at once: the pid, progress, the exit status.
"""

import contextlib
import importlib
import json
import os
import pickle
import signal
import struct
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from debris_scanner.kernel_cache import prepare_process

_AT_ONCE = 512  # bytes that a pipe takes undivided (POSIX)
_OOM_SCORE = 500  # the kernel ends a task before it ends its worker


@dataclass(frozen=True)
class Request:
    """One task for the template."""

    payload: bytes  # pickled (function, arguments)
    result: str  # file for the pickled Result
    log: str  # file for stdout and stderr
    folder: str  # working folder


@dataclass(frozen=True)
class Result:
    """What became of a task that came to its own end."""

    value: Any = None
    error: str = ''  # name of the exception's class, empty without one
    message: str = ''
    trace: str = ''


Progress = Callable[[float, str], None]  # share done, and in words


def send(pipe: int, request: Request) -> None:
    """Write a request (the worker's side)."""
    data = pickle.dumps(request)
    left = memoryview(struct.pack('<Q', len(data)) + data)
    while left:
        left = left[os.write(pipe, left) :]


def _receive(pipe: int) -> Request | None:
    """The next request; None once the worker is gone."""
    head = _exactly(pipe, 8)
    if head is None:
        return None
    data = _exactly(pipe, struct.unpack('<Q', head)[0])
    return None if data is None else pickle.loads(data)


def _exactly(pipe: int, count: int) -> bytes | None:
    # unbuffered: what is not read yet has to be visible to a task that watches the same pipe
    data = b''
    while len(data) < count:
        part = os.read(pipe, count - len(data))
        if not part:
            return None
        data += part
    return data


def _tell(pipe: int, **what: Any) -> None:
    line = json.dumps(what).encode() + b'\n'
    if len(line) <= _AT_ONCE:
        with contextlib.suppress(BrokenPipeError):
            os.write(pipe, line)


def main(modules: list[str]) -> None:
    """Serve until stdin ends."""
    prepare_process()
    requests, answers = 0, os.dup(1)
    os.dup2(2, 1)  # what libraries print is no answer
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the batch is interrupted too, and ends us
    for name in modules:
        try:
            module, _, function = name.partition(':')
            loaded = importlib.import_module(module)
            if function:
                getattr(loaded, function)()
        except Exception:  # a task that needs it says so, in its own log
            traceback.print_exc()
    _tell(answers, ready=True, threads=threading.active_count())
    while (request := _receive(requests)) is not None:
        pid = os.fork()
        if pid == 0:
            _work(request, requests, answers)
        _, status = os.waitpid(pid, 0)
        _tell(answers, status=os.waitstatus_to_exitcode(status))


def _work(request: Request, requests: int, answers: int) -> None:
    """Body of a forked process; never returns."""
    code = 70
    try:
        os.setsid()  # its own children can be ended with it
        log = os.open(request.log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.chdir(request.folder)
        with contextlib.suppress(OSError):  # no such file but on Linux
            Path('/proc/self/oom_score_adj').write_text(str(_OOM_SCORE))
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _tell(answers, pid=os.getpid())
        threading.Thread(target=_end_with_worker, args=(requests,), daemon=True).start()
        result = _result(request, lambda share, text: _tell(answers, share=share, text=text[:100]))
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        temporary = f'{request.result}.part'
        with Path(temporary).open('wb') as file:
            file.write(result)
        Path(temporary).replace(request.result)
        code = 0
    except BaseException:
        with contextlib.suppress(BaseException):
            traceback.print_exc()
            sys.stderr.flush()
    finally:
        os._exit(code)


def _result(request: Request, progress: Progress) -> bytes:
    try:
        function, arguments = pickle.loads(request.payload)
        return pickle.dumps(Result(function(*arguments, progress=progress)))
    except Exception as error:
        told = ' '.join(str(error).split()) or type(error).__name__
        trace = traceback.format_exc()
        print(trace, file=sys.stderr)
        # the exception itself may not be picklable, or be of a module that the reader lacks
        return pickle.dumps(Result(error=type(error).__qualname__, message=told, trace=trace))


def _end_with_worker(requests: int) -> None:
    """End this process with its worker: while a task runs nothing is sent, and only the end can be read."""
    while os.read(requests, 1):
        pass
    os.killpg(0, signal.SIGKILL)


if __name__ == '__main__':
    # under its own name, so that requests unpickle as the class that is used here
    from debris_scanner.batch import template

    template.main(sys.argv[1:])
