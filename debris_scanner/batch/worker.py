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

"""What a Dask worker does with a task: it hands it to a process of its own and reports the outcome."""

import signal
import socket
import threading
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from debris_scanner.batch.isolation import Failure, Isolation, Limits

_TELL_EVERY_S = 2.0  # progress passes through the scheduler, which has thousands of tasks to look after


@dataclass(frozen=True)
class Task:
    """One thing to do: ``function(*arguments, progress=...)``, in a process of its own."""

    key: str  # unique in a run
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    weight: float = 1.0  # on the progress bar


@dataclass(frozen=True)
class Setup:
    """What all tasks of a run have in common."""

    run: str  # unique
    preload: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)
    sources: str | None = None  # root of the sources to import, if it is on this machine
    seconds: float | None = None  # that a task may take
    isolated: bool = True  # False calls the function in the worker: for what cannot fail


@dataclass(frozen=True)
class Outcome:
    """How a task ended."""

    key: str
    value: Any = None
    failure: Failure | None = None
    seconds: float = 0.0
    worker: str = ''
    attempts: int = 1
    run_key: str = ''  # of the submission


_slot = threading.local()  # one isolation for each thread of the worker
_active: dict[Isolation, str] = {}  # and the run that it works for
_active_lock = threading.Lock()


def dask_setup(worker: Any) -> None:
    """Let Ctrl-C be the batch's affair alone: what Dask calls in a local worker when it starts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_task(task: Task, run_key: str, setup: Setup, archive: bytes | None = None) -> Outcome:
    """Run a task on this worker; whatever the task does is an outcome.

    Args:
        task: to run.
        run_key: of this submission.
        setup: of the run.
        archive: zip of the sources, for a worker that does not share the batch's disk.
    """
    from distributed import get_worker

    worker = get_worker()
    start = time.perf_counter()
    value, failure = None, None
    try:
        if setup.isolated:
            value = _isolated(task, setup, archive, worker)
        else:
            value = task.function(*task.arguments, progress=lambda _share, _text: None)
    except Failure as error:
        failure = error
    except OSError as error:  # of the worker's own scratch
        failure = Failure('error', f'worker {worker.name}: {error}', type(error).__name__)
    seconds = time.perf_counter() - start
    where = f'{socket.gethostname()}/{worker.name}'
    return Outcome(task.key, value, failure, seconds, where, run_key=run_key)


def _isolated(task: Task, setup: Setup, archive: bytes | None, worker: Any) -> Any:
    scratch = Path(worker.local_directory)
    isolation = _isolation(setup, archive, scratch)
    told_s = -_TELL_EVERY_S

    def progress(share: float, text: str) -> None:
        nonlocal told_s
        if (now := time.monotonic()) - told_s >= _TELL_EVERY_S:
            told_s = now
            worker.log_event(setup.run, {'task': task.key, 'share': share, 'text': text})

    memory = worker.memory_manager.memory_limit
    limits = Limits(setup.seconds, memory // worker.state.nthreads if memory else None)
    with _active_lock:
        _active[isolation] = setup.run
    try:
        return isolation.run(task.function, task.arguments, scratch, limits, progress)
    finally:
        with _active_lock:
            del _active[isolation]


def _isolation(setup: Setup, archive: bytes | None, scratch: Path) -> Isolation:
    """This thread's isolation; a run that needs another one replaces it."""
    wanted = (
        setup.preload,
        tuple(sorted(setup.environment.items())),
        setup.sources,
        setup.run if archive else '',
    )
    if getattr(_slot, 'wanted', None) != wanted:
        if (old := getattr(_slot, 'isolation', None)) is not None:
            old.close()
        root = Path(setup.sources) if setup.sources is not None else None
        if archive is not None:
            root = _unpacked(archive, scratch / f'sources-{setup.run}')
        _slot.isolation = Isolation(setup.preload, setup.environment, root)
        _slot.wanted = wanted
    isolation: Isolation = _slot.isolation
    return isolation


def _unpacked(archive: bytes, root: Path) -> Path:
    with _active_lock:
        if not root.is_dir():
            part = root.with_suffix('.part')
            with zipfile.ZipFile(BytesIO(archive)) as file:
                file.extractall(part)
            part.rename(root)
    return root


def abort(run: str) -> None:
    """End the tasks of a run on this worker."""
    with _active_lock:
        own = [isolation for isolation, active in _active.items() if active == run]
    for isolation in own:
        isolation.abort()
