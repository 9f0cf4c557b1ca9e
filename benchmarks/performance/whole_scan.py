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

"""A recorded scan through all stages, CPU time by stage and by frame, and its memory."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.performance.measure import Cost, CpuTimer, Row, peak_mb
from benchmarks.performance.ours import OURS
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from msg_adapters.bags import open_session
from msg_adapters.errors import MalformedMessage

STAGES = {
    'isolate': 'isolate',
    'normals': 'normals',
    'view': 'view',
    'registration': 'registration and filter, scanning',
    'tracking': 'registration and filter, tracking',
    'descriptor': 'descriptor, a key frame',
    'closure_search': 'closure search, a key frame',
    'verification': 'verification, a key frame',
    'relaxation': 'relaxation, a generation',
    'refinement': 'refinement, a generation',
    'fusion': 'model and mesh, a generation',
}


@dataclass(frozen=True)
class WholeScan:
    """Rows a stage; CPU time a frame while scanning and while tracking, of a generation, of the end."""

    rows: list[Row]
    scanning: Cost
    tracking: Cost
    generation_ms: float
    finish_ms: float
    keyframes: int
    peak_mb: float


def scan(bag: Path) -> WholeScan:
    """Scan a recording twice, for the first warms up, and measure the second."""
    for _ in range(2):
        result = _scan(bag)
    return result


def _scan(bag: Path) -> WholeScan:
    timer = CpuTimer()
    scanner = Scanner(Settings(), timer=timer)
    cost: dict[str, list[float]] = {'scanning': [], 'tracking': []}
    generation_ms = 0.0
    with open_session(bag) as session:
        start = time.process_time()
        for _, frame in session:
            if isinstance(frame, MalformedMessage):
                continue
            tracked = scanner.front_end.odometry.model is not None
            step = scanner.process(frame)
            now = time.process_time()
            if step.generation is not None:
                generation_ms = generation_ms or (now - start) * 1e3
            else:
                cost['tracking' if tracked else 'scanning'].append((now - start) * 1e3)
            start = now
    keyframes = len(scanner.back_end.builder.keyframes)
    start = time.process_time()
    scanner.finish()
    finish_ms = (time.process_time() - start) * 1e3
    summary = timer.summary()
    rows = [
        Row(name, OURS, Cost(summary[key]['p50_ms'], summary[key]['p99_ms'], int(summary[key]['count'])))
        for key, name in STAGES.items()
        if key in summary
    ]
    scanning, tracking = (_mean(ms) for ms in cost.values())
    return WholeScan(rows, scanning, tracking, generation_ms, finish_ms, keyframes, peak_mb())


def _mean(ms: list[float]) -> Cost:
    """The mean in place of the median: of frames, only some are key frames."""
    return Cost(float(np.mean(ms)), float(np.percentile(ms, 99)), len(ms))
