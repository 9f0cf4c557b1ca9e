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

"""A thread that runs heavy tasks in order, so that the executor never waits for them."""

import contextlib
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Generator

from debris_scanner.faults import Faults

_POLL_S = 0.005
_IDLE_S = 0.2

Answer = tuple[bool, str]


class Job:
    """A task with an answer; awaitable in a service callback that has its own callback group.

    rclpy polls a waiting coroutine without a pause, so ``__await__`` sleeps for a short time.
    """

    def __init__(self, task: Callable[[], Answer]) -> None:
        self._task = task
        self._done = threading.Event()
        self.answer: Answer = (False, 'not done')

    def __call__(self) -> None:
        """Run the task; in the worker's thread."""
        try:
            self.answer = self._task()
        except Exception as error:
            self.answer = (False, f'failed: {error}')
            raise
        finally:
            self._done.set()

    def __await__(self) -> Generator[None, None, Answer]:
        while not self._done.wait(_POLL_S):
            yield
        return self.answer


class Worker:
    """Runs tasks one after another, so that only one thread uses their objects.

    Args:
        between: called after each task, and periodically while there is none.
        nice: niceness of the thread (Linux), 0 to 19.
        faults: a task that raises is noted there, and the next one runs; None: the thread ends.
    """

    def __init__(self, between: Callable[[], None], nice: int = 0, faults: Faults | None = None) -> None:
        self._between = between
        self._faults = faults
        self._nice = nice
        self._tasks: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._failure: Exception | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name='worker', daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def post(self, task: Callable[[], object]) -> None:
        """Queue a task."""
        self._tasks.put(task)

    def ask(self, task: Callable[[], Answer]) -> Job:
        """Queue a task and return its job, whose answer can be awaited."""
        job = Job(task)
        self._tasks.put(job)
        return job

    def caught_up(self) -> Callable[[], bool]:
        """A condition that holds once all tasks queued so far are done, or the thread has ended."""
        reached = threading.Event()
        self._tasks.put(reached.set)
        return lambda: reached.is_set() or not self._thread.is_alive()

    @property
    def backlog(self) -> int:
        """Number of queued tasks."""
        return self._tasks.qsize()

    def check(self) -> None:
        """Raise the exception that ended the thread, if any."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Run the queued tasks, then end the thread."""
        self._tasks.put(None)
        if self._thread.is_alive():
            self._thread.join()

    def work_until(self, condition: Callable[[], bool], timeout_s: float) -> None:
        """Within a task: run the tasks queued behind it until a condition holds or the time is up."""
        deadline = time.monotonic() + timeout_s
        while not condition() and time.monotonic() < deadline and not self._ended:
            self._contained_step()

    def _run(self) -> None:
        if self._nice and sys.platform == 'linux':  # elsewhere it would apply to the whole process
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), self._nice)
        try:
            while not self._ended:
                self._contained_step()
        except Exception as error:
            self._failure = error

    def _contained_step(self) -> None:
        if self._faults is None:
            self._step()
            return
        with self._faults.contained('a task of the scan'):
            self._step()

    def _step(self) -> None:
        try:
            task = self._tasks.get(timeout=_IDLE_S)
        except queue.Empty:
            self._between()
            return
        if task is None:
            self._ended = True
            return
        task()
        self._between()
