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

"""Cases in parallel processes, with one progress bar for all.

A process takes case after case. If one dies or takes too long, only its case becomes an error, and a new
process goes on with the rest.
"""

import multiprocessing
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.scorecard.cases import Case

THREAD_VARIABLES = (
    'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS'
)  # fmt: skip
_POLL_S = 0.5
_GRACE_S = 3.0
_REPORT_EVERY = 20  # frames

Record = dict[str, Any]


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    case: Case
    since: float
    frames: int = 0


def run_cases(
    cases: Sequence[Case],
    jobs: int,
    sources: Path,
    extras: Sequence[str],
    limit_s: float,
    on_result: Callable[[Case, Record], None],
) -> None:
    """Run all cases; every one ends in a call of ``on_result``, with its figures or with its error.

    Args:
        cases: to run, in this order.
        jobs: processes at a time.
        sources: root of the sources that the processes import.
        extras: see ``run_case``.
        limit_s: a case that takes longer is given up.
        on_result: called in this process.

    Raises:
        KeyboardInterrupt: all processes are ended then; finished cases have been passed on.
    """
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, '1'))
    sys.path.insert(0, str(sources))  # processes that are spawned inherit the path
    waiting, running = list(cases), list[_Worker]()
    failed = 0
    with tqdm(total=sum(c.frames for c in cases), desc='scorecard', unit='frame', disable=None) as bar:

        def finish(worker: _Worker, record: Record) -> None:
            nonlocal failed
            failed += 'error' in record
            bar.update(worker.case.frames - worker.frames)
            on_result(worker.case, record)
            left = len(waiting) + len(running) - 1
            bar.set_postfix_str(f'{left} cases left, {failed} broke, {worker.case.name}', refresh=False)

        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    running.append(_start(waiting.pop(0), extras))
                wait([*(w.pipe for w in running), *(w.process.sentinel for w in running)], _POLL_S)
                for worker in list(running):
                    record = _news(worker, bar)
                    if record is None and time.monotonic() - worker.since > limit_s:
                        record = {'error': f'gave up after {limit_s:.0f} s'}
                    if record is None:
                        continue
                    finish(worker, record)
                    reusable = worker.process.is_alive() and 'error' not in record
                    if reusable and waiting:
                        _give(worker, waiting.pop(0), extras)
                        continue
                    running.remove(worker)
                    _end(worker)
        finally:
            for worker in running:
                _end(worker)
            sys.path.remove(str(sources))


def _start(case: Case, extras: Sequence[str]) -> _Worker:
    # spawned, not forked: threads of the libraries do not survive a fork
    context = multiprocessing.get_context('spawn')
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    worker = _Worker(process, ours, case, time.monotonic())
    _give(worker, case, extras)
    return worker


def _give(worker: _Worker, case: Case, extras: Sequence[str]) -> None:
    worker.case, worker.since, worker.frames = case, time.monotonic(), 0
    worker.pipe.send((case, extras))


def _news(worker: _Worker, bar: 'tqdm[Any]') -> Record | None:
    """The record of the worker's case if it is done, the frames it did shown on the bar."""
    try:
        while worker.pipe.poll():
            said = worker.pipe.recv()
            if isinstance(said, dict):
                return said
            done = min(said, worker.case.frames)
            bar.update(done - worker.frames)
            worker.frames = done
    except (EOFError, OSError):
        pass
    if worker.process.is_alive():
        return None
    worker.process.join()
    return {'error': f'its process ended with {worker.process.exitcode}'}


def _end(worker: _Worker) -> None:
    """End a process, by force if it does not go when asked."""
    worker.pipe.close()
    worker.process.terminate()
    worker.process.join(_GRACE_S)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()


def _work(pipe: Connection) -> None:
    """Body of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is interrupted too, and ends us

    def report(frames: int) -> None:
        if frames % _REPORT_EVERY == 0:
            pipe.send(frames)

    while True:
        try:
            case, extras = pipe.recv()
        except EOFError:
            return
        try:
            # here and not above: sources that do not even import are an error like others
            from benchmarks.scorecard.run_case import run_case

            record = run_case(case, extras, report)
        except Exception:
            record = {'error': traceback.format_exc()}
        pipe.send(record)
