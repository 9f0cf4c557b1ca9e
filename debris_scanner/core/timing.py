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

"""Stage timing: how often each stage ran and its median and 99th percentile."""

import time
from array import array
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

WINDOW = 20_000  # latest samples kept per stage: memory stays bounded over hours


class StageTimer:
    """Collects durations by stage name; ``summary()`` is the ``timing`` block of summary.json."""

    def __init__(self) -> None:
        self._count: dict[str, int] = defaultdict(int)
        self._samples: dict[str, array[float]] = defaultdict(lambda: array('d'))

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block under ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Record one duration measured elsewhere."""
        n, samples = self._count[name], self._samples[name]
        if len(samples) < WINDOW:
            samples.append(seconds)
        else:
            samples[n % WINDOW] = seconds
        self._count[name] = n + 1

    def summary(self) -> dict[str, dict[str, float]]:
        """Count, p50_ms and p99_ms of every stage seen."""
        rows: dict[str, dict[str, float]] = {}
        for name, samples in list(self._samples.items()):  # other threads may add meanwhile
            p50, p99 = np.percentile(np.array(samples) * 1e3, [50, 99])
            rows[name] = {
                'count': self._count[name],
                'p50_ms': round(float(p50), 3),
                'p99_ms': round(float(p99), 3),
            }
        return rows
