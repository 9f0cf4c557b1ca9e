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

"""Tasks on dask.distributed: a cluster of this machine, or one that runs already, by its address.

Of many tasks only a window is submitted at a time, so that the scheduler's memory does not grow with their
number. A task whose process crashes, or whose worker is lost, is tried again; a scheduler that is lost ends
the run, with everything that was done accounted for.
"""

import contextlib
import logging
import os
import queue
import sys
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

from tqdm import tqdm

from debris_scanner.batch import BatchError
from debris_scanner.batch.isolation import Failure
from debris_scanner.batch.worker import Outcome, Setup, Task, abort, run_task
from debris_scanner.interruption import Interruption

_CONNECT_S = 30.0
_LOST_S = 60.0  # for a scheduler to come back
_POLL_S = 0.5
_WINDOW = 8  # tasks submitted for each slot of the cluster: its workers never wait for the client
_LEAST_WINDOW = 64
_CLOSE_S = 10.0
_AGAIN = Failure('lost', 'submitted again')


@dataclass(frozen=True)
class Cluster:
    """Where tasks run."""

    workers: int | None = None  # of this machine, one core each; None for all its cores
    scheduler: str | None = None  # address of a running one
    memory: int | None = None  # bytes a local worker may take; None for its share of the machine's


@dataclass(frozen=True)
class Surroundings:
    """What tasks run in."""

    preload: Sequence[str] = ()  # modules that they use
    variables: Mapping[str, str] = field(default_factory=dict)  # of their environment
    sources: Path | None = None  # root, in place of what is installed, on the local cluster
    archive: bytes | None = None  # the same as a zip, for a cluster that does not share this disk
    seconds: float | None = None  # that a task may take
    isolated: bool = True  # each has a process of its own

    def setup(self, run: str, local: bool) -> Setup:
        """The same for the workers of a run."""
        sources = str(self.sources) if self.sources is not None and local else None
        variables = dict(self.variables)
        return Setup(run, tuple(self.preload), variables, sources, self.seconds, self.isolated)


@dataclass
class _Flight:
    """A task under way."""

    task: Task
    attempt: int
    future: Any
    share: float = 0.0


@dataclass
class _Run:
    """State of one call of ``Engine.run``."""

    setup: Setup
    archive: Any
    retries: int
    bar: 'tqdm[Any]'
    interruption: Interruption
    ready: 'queue.SimpleQueue[Any]' = field(default_factory=queue.SimpleQueue)
    flights: dict[str, _Flight] = field(default_factory=dict)  # by the future's key
    again: deque[tuple[Task, int]] = field(default_factory=deque)
    failed: int = 0


class Engine:
    """A connection to a cluster; as a context it ends what it started."""

    def __init__(self, cluster: Cluster, say: Callable[[str], None] = lambda _: None) -> None:
        """Start or join the cluster.

        Args:
            cluster: where tasks run.
            say: told what a user wants to know, such as the dashboard's address.

        Raises:
            BatchError: there is no scheduler at the address.
        """
        from dask import config
        from distributed import Client

        self._cluster, self._say, self._own = cluster, say, None
        for name in (
            'distributed.worker',
            'distributed.client',
            'distributed.scheduler',
            'distributed.nanny',
        ):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what they report is in the outcomes
        config.set({'distributed.comm.timeouts.connect': f'{_CONNECT_S}s'})
        if cluster.scheduler is None:
            self._own = _local(cluster)
        try:
            self._client = Client(
                self._own or cluster.scheduler,
                timeout=_CONNECT_S,
                set_as_default=False,
                heartbeat_interval='5s',
            )
        except (OSError, ValueError) as error:
            told = ' '.join(str(error).split())
            raise BatchError(f'no Dask scheduler answers at {cluster.scheduler}: {told}') from error
        if self._client.dashboard_link:
            say(f'dashboard {self._client.dashboard_link}')

    def __enter__(self) -> 'Engine':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the cluster; a local one ends."""
        with contextlib.suppress(Exception):
            self._client.close(timeout=_CLOSE_S)
        if self._own is not None:
            with contextlib.suppress(Exception):
                self._own.close(timeout=_CLOSE_S)

    @property
    def slots(self) -> int:
        """Tasks that the cluster runs at a time."""
        workers = self._client.scheduler_info(n_workers=-1)['workers']
        return sum(int(w['nthreads']) for w in workers.values())

    def run(
        self,
        tasks: Sequence[Task],
        on_outcome: Callable[[Outcome], None],
        *,
        title: str,
        unit: str = 'task',
        retries: int = 0,
        inside: Surroundings | None = None,
    ) -> None:
        """Run all tasks; each ends in one call of ``on_outcome``, with its value or its failure.

        Args:
            tasks: with keys that differ.
            on_outcome: called in this thread.
            title: before the bar.
            unit: of the tasks' weights.
            retries: times that a failed task is tried again.
            inside: what the tasks run in.

        Raises:
            BatchError: the scheduler was lost; what is done has been passed on.
            KeyboardInterrupt: no task is under way any more.
        """
        if not tasks:
            return
        inside = inside or Surroundings()
        name = f'debris-scanner-{uuid.uuid4().hex[:12]}'
        local = self._own is not None
        archive = None if local else inside.archive
        shipped = None if archive is None else self._client.scatter(archive, hash=True)
        total = sum(t.weight for t in tasks)
        bar = tqdm(total=total, desc=title, unit=unit, disable=None, smoothing=0.05)
        with bar, Interruption() as interruption:
            run = _Run(inside.setup(name, local), shipped, retries, bar, interruption)
            self._client.subscribe_topic(name, lambda event: run.ready.put(('progress', event)))
            try:
                self._loop(run, iter(tasks), len(tasks), on_outcome)
            except BaseException:
                self._abort(run)
                raise
            finally:
                with contextlib.suppress(Exception):
                    self._client.unsubscribe_topic(name)

    def _loop(
        self, run: _Run, waiting: Iterable[Task], count: int, on_outcome: Callable[[Outcome], None]
    ) -> None:
        warned = False
        since = time.monotonic()
        window = max(_LEAST_WINDOW, _WINDOW * self.slots)
        while count:
            run.interruption.act()
            if len(run.flights) <= window // 2:
                fresh = [*run.again, *((t, 1) for t in islice(waiting, window - len(run.flights)))]
                run.again.clear()
                self._submit(run, fresh)
            taken = _taken(run.ready, _POLL_S)
            for kind, what in taken:
                if kind == 'progress':
                    _advance(run, what[1])
            for outcome in self._landed(run, [what for kind, what in taken if kind == 'done']):
                count -= 1
                on_outcome(outcome)
            if self._client.status != 'running':
                self._wait_for_scheduler(run)
            if not warned and time.monotonic() - since > _CONNECT_S and not self.slots:
                warned = True
                self._say('no worker has joined the cluster yet: waiting for one')

    def _submit(self, run: _Run, fresh: Sequence[tuple[Task, int]]) -> None:
        if not fresh:
            return
        keys = [f'{run.setup.run}-{task.key}-{attempt}-{uuid.uuid4().hex[:6]}' for task, attempt in fresh]
        futures = self._client.map(
            run_task, [t for t, _ in fresh], keys, key=keys, pure=False, setup=run.setup, archive=run.archive
        )
        for key, future, (task, attempt) in zip(keys, futures, fresh, strict=True):
            run.flights[key] = _Flight(task, attempt, future)
            future.add_done_callback(lambda f: run.ready.put(('done', f)))

    def _landed(self, run: _Run, futures: Sequence[Any]) -> Iterator[Outcome]:
        """Outcomes of the tasks that will not be tried again.

        Dask's own retries end with its scheduler, and say neither how many there were nor why.
        """
        finished = [f for f in futures if f.status == 'finished']
        values: dict[str, Outcome] = {}
        with contextlib.suppress(Exception):  # lost on the way: then their status says so, or they come again
            found = self._client.gather(finished, errors='skip')
            values = {f'{o.run_key}': o for o in found}
        for future in futures:
            flight = run.flights.get(future.key)
            if flight is None:
                continue
            task = flight.task
            if future.key in values:
                outcome = replace(values[future.key], attempts=flight.attempt)
            elif future.status == 'error':
                outcome = Outcome(task.key, failure=_lost(future.exception()), attempts=flight.attempt)
            else:  # cancelled with the scheduler or lost with a worker, through no fault of its own
                outcome = Outcome(task.key, failure=_AGAIN, attempts=flight.attempt)
            del run.flights[future.key]
            failed = outcome.failure is not None
            if outcome.failure is _AGAIN or (failed and flight.attempt <= run.retries):
                run.again.append((task, flight.attempt + (outcome.failure is not _AGAIN)))
                run.bar.update(-flight.share * task.weight)
                continue
            run.bar.update(round((1 - flight.share) * task.weight, 6))
            run.failed += failed
            run.bar.set_postfix_str(f'{run.failed} failed, {task.key}', refresh=False)
            yield outcome

    def _wait_for_scheduler(self, run: _Run) -> None:
        """Wait for a lost scheduler; what it had is submitted again.

        Raises:
            BatchError: it does not come back.
        """
        until = time.monotonic() + _LOST_S
        self._say('the connection to the scheduler is lost: waiting for it')
        while time.monotonic() < until and self._client.status not in ('running', 'closed'):
            time.sleep(_POLL_S)
        if self._client.status != 'running':
            where = self._cluster.scheduler or 'on this machine'
            raise BatchError(f'the scheduler {where} is gone; the same command goes on from here')

    def _abort(self, run: _Run) -> None:
        """End what is under way, as far as the cluster can be reached."""
        if self._client.status != 'running' or not run.flights:
            return
        with contextlib.suppress(Exception):
            self._client.cancel([f.future for f in run.flights.values()], force=True)
            self._client.run(abort, run.setup.run, on_error='ignore', wait=True)


def _local(cluster: Cluster) -> Any:
    from distributed import LocalCluster

    count = cluster.workers or len(os.sched_getaffinity(0))
    return LocalCluster(
        n_workers=count,
        threads_per_worker=1,
        processes=True,
        memory_limit=cluster.memory or 'auto',
        host='127.0.0.1',
        dashboard_address='127.0.0.1:0',
        silence_logs=logging.CRITICAL,
        preload=['debris_scanner.batch.worker'],
    )


def _taken(ready: 'queue.SimpleQueue[Any]', wait_s: float) -> list[Any]:
    """What is ready, after waiting for the first of it."""
    taken = []
    with contextlib.suppress(queue.Empty):
        taken.append(ready.get(timeout=wait_s))
        while True:
            taken.append(ready.get_nowait())
    return taken


def _advance(run: _Run, said: Mapping[str, Any]) -> None:
    for flight in run.flights.values():
        if flight.task.key == said['task'] and said['share'] > flight.share:
            run.bar.update(round((said['share'] - flight.share) * flight.task.weight, 6))
            run.bar.set_postfix_str(f'{run.failed} failed, {flight.task.key}: {said["text"]}', refresh=False)
            flight.share = said['share']


def _lost(error: BaseException | None) -> Failure:
    if type(error).__name__ == 'KilledWorker':
        return Failure('lost', 'its workers died one after the other while they had it')
    return Failure('lost', f'the cluster gave it up: {" ".join(str(error).split())}')


def say(text: str) -> None:
    """Say something on stderr, beside the bar."""
    tqdm.write(f'debris-scan: {text}', file=sys.stderr)
