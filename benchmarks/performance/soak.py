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

"""Memory over a long scan, as fast as the machine goes: the offline scanner, fed frames made on the fly."""

import itertools
import multiprocessing
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import psutil

from debris_scanner.core.frames import DepthFrame
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings

SAMPLES = 6


@dataclass(frozen=True)
class Sample:
    """State of a scan after so much time of its own."""

    minutes: float
    frames: int
    keyframes: int
    stored: int
    resident_mb: float
    frame_ms: float  # mean since the last sample, the rendering left out


@dataclass
class Soak:
    """A long scan: samples in order of time."""

    name: str
    samples: list[Sample] = field(default_factory=list)


def all_runs(_out: Path, quick: bool) -> list[Soak]:
    """A tumble of ten minutes at 30 Hz, and an hour of spin at 10 Hz, each in a process of its own."""
    soaks = []
    for task in (_tumble, _spin):
        with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as pool:
            soaks.append(pool.submit(task, quick).result())
    return soaks


def _tumble(quick: bool) -> Soak:
    simulation = Simulation(
        SimulationSettings(motion='tumble', rate_hz=30.0, seconds=60.0 if quick else 600.0)
    )
    return run('tumble, 30 Hz', _frames(simulation), len(simulation), 30.0)


def _spin(quick: bool) -> Soak:
    one_turn = SimulationSettings(rate_hz=10.0, seconds=4 * np.pi)
    return run('spin, 10 Hz', _looped(one_turn), 1200 if quick else 36_000, 10.0)


def run(name: str, frames: Iterator[DepthFrame], count: int, rate_hz: float) -> Soak:
    """Scan so many frames, with samples at even distances."""
    scanner, soak = Scanner(Settings()), Soak(name)
    process = psutil.Process()
    spent, since = 0.0, 0
    marks = {round(count * (k + 1) / SAMPLES) for k in range(SAMPLES)}
    for n, frame in enumerate(itertools.islice(frames, count), 1):
        start = time.process_time()
        scanner.process(frame)
        spent += time.process_time() - start
        if n in marks:
            store = scanner.back_end.builder.store
            resident = process.memory_info().rss / 1e6
            kept = len(store.with_depth)
            keyframes = len(scanner.back_end.builder.keyframes)
            minutes = n / rate_hz / 60
            soak.samples.append(Sample(minutes, n, keyframes, kept, resident, spent * 1e3 / (n - since)))
            spent, since = 0.0, n
    return soak


def _frames(simulation: Simulation) -> Iterator[DepthFrame]:
    for f in simulation:
        yield DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera)


def _looped(settings: SimulationSettings) -> Iterator[DepthFrame]:
    """One turn over and over, with stamps that go on."""
    frames = list(_frames(Simulation(settings)))
    period_ns = round(len(frames) / settings.rate_hz * 1e9)
    for turn in itertools.count():
        for frame in frames:
            yield replace(frame, stamp_ns=frame.stamp_ns + turn * period_ns)
