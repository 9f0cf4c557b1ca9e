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

"""CPU time of a call, a stage, a process: what other work on the machine disturbs least."""

import resource
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from debris_scanner.core.timing import StageTimer


@dataclass(frozen=True)
class Cost:
    """CPU milliseconds, all threads: median and 99th percentile of so many runs."""

    median_ms: float
    p99_ms: float
    count: int

    @staticmethod
    def of(milliseconds: Sequence[float]) -> 'Cost':
        p50, p99 = np.percentile(milliseconds, [50, 99])
        return Cost(float(p50), float(p99), len(milliseconds))


@dataclass(frozen=True)
class PairError:
    """Of registered pairs against the truth: rotation in degrees, mean and largest, and mean shift, mm."""

    mean_deg: float
    max_deg: float
    mean_mm: float

    def __str__(self) -> str:
        return f'{self.mean_deg:.2f}° ({self.max_deg:.2f}°), {self.mean_mm:.2f} mm'


@dataclass(frozen=True)
class Row:
    """One line of a table: who did what, at what cost, how well."""

    what: str
    who: str
    cost: Cost
    note: str = ''


def repeat(task: Callable[[], object], times: int = 30, warm_up: int = 1) -> Cost:
    """CPU time of each of several calls."""
    for _ in range(warm_up):
        task()
    milliseconds = []
    for _ in range(times):
        start = time.process_time()
        task()
        milliseconds.append((time.process_time() - start) * 1e3)
    return Cost.of(milliseconds)


def cpu_ms(task: Callable[[], object]) -> float:
    """CPU time of one call."""
    start = time.process_time()
    task()
    return (time.process_time() - start) * 1e3


class CpuTimer(StageTimer):
    """The scanner's stage timer, reading CPU time in place of the clock."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = time.process_time()
        try:
            yield
        finally:
            self.add(name, time.process_time() - start)


def peak_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
