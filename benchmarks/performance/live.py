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

"""A live scan through the real nodes: frames lost, latency, CPU and memory of each process.

The camera is a recording that was rendered beforehand, and its own cost is kept apart.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from debris_scanner.cli.live.domain import free_domain
from debris_scanner.cli.live.monitor import Monitor
from debris_scanner.io.trajectories import read_tum
from debris_scanner.nodes.inputs.sensor_input import SHED
from debris_scanner.nodes.lifecycle.middleware import prepare

CAMERAS = ('play_bag', 'cloud_camera')
SECONDS = 60.0
RATE_HZ = 30.0
MINUTES = 10.0  # of a long tumble
_TICK_S = 0.5
_START_S = 90.0
_IDLE_S = 6.0


@dataclass
class LiveCost:
    """What a live scan took while the camera ran; CPU in cores, memory in MB, latency in ms."""

    name: str
    seconds: float
    cpu: dict[str, float]  # by node; a camera's is not the scanner's
    rss: dict[str, float]  # largest
    memory: list[float]  # of all processes, the most in each minute; shared pages count once
    sent: int = 0
    shed: int = 0  # by the door
    lost: int = 0  # whatever else was sent and not used
    gap_s: float = float('nan')  # the longest between two frames used
    latency_p50: float = float('nan')
    latency_p99: float = float('nan')
    closure_to_model_s: float = float('nan')
    result: str = ''
    attitude_deg: float = float('nan')  # median error of the final poses
    model_mm: float = float('nan')  # RMSE
    load: float = 0.0  # of the machine, one minute before

    @property
    def total_cpu(self) -> float:
        """Cores of the scanner's processes."""
        return sum(v for k, v in self.cpu.items() if k not in CAMERAS)


def make_recording(
    folder: Path, seconds: float = SECONDS, rate_hz: float = RATE_HZ, motion: str = 'spin'
) -> Path:
    """The shuttle stack as 640x480 depth images; made once."""
    if not (folder / 'metadata.yaml').exists():
        command = [
            sys.executable, '-m', 'debris_scanner', 'simulate', 'shuttle_stack', '--motion', motion,
            '--rate', str(rate_hz), '--seconds', str(seconds), '--out', str(folder),
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True)
    return folder


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Other programs that want a core each, and end with this one."""
    rests_never = f'import os\nwhile os.getppid() == {os.getpid()}: sum(range(10000))'
    loops = [subprocess.Popen([sys.executable, '-c', rests_never]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def depth_images(bag: Path, out: Path, composed: bool = False) -> LiveCost:
    """The recording, played as depth images."""
    options = ['--bag', str(bag), *(['--composed'] if composed else [])]
    cost = _measured('scanner, depth' if composed else 'four processes, depth', options, out, None)
    command = [sys.executable, '-m', 'debris_scanner', 'evaluate', str(out), '--truth', str(bag)]
    subprocess.run(command, check=True, capture_output=True)
    metrics = json.loads((out / 'metrics.json').read_text())
    cost.attitude_deg = (metrics['attitude_deg'] or {}).get('median', float('nan'))
    cost.model_mm = (metrics['model_mm'] or {}).get('rmse', float('nan'))
    return cost


def clouds(bag: Path, out: Path, composed: bool = False) -> LiveCost:
    """The recording as coloured clouds of 32 bytes a point, 9.8 MB a frame."""
    camera = [sys.executable, '-m', 'benchmarks.performance.cloud_camera', str(bag)]
    options = ['--idle-seconds', str(_IDLE_S), *(['--composed'] if composed else [])]
    return _measured('scanner, clouds' if composed else 'four processes, clouds', options, out, camera)


def _measured(name: str, options: list[str], out: Path, camera: Sequence[str] | None) -> LiveCost:
    load = os.getloadavg()[0]
    prepare(local_only=True)
    os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    command = [sys.executable, '-m', 'debris_scanner', 'live', '--out', str(out), *options]
    (out / 'summary.json').unlink(missing_ok=True)
    out.mkdir(parents=True, exist_ok=True)
    with (out / 'live.log').open('w') as log:
        scan = subprocess.Popen(command, stdout=log, stderr=log)
    player = subprocess.Popen(camera, stdout=subprocess.PIPE) if camera else None
    watch = _Watch([scan.pid, *([player.pid] if player else [])])
    try:
        watch.follow(scan)
        said = player.communicate(timeout=_START_S)[0] if player else b'0'
        scan.wait()
    finally:
        for process in filter(None, (player, scan)):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
    if not (out / 'summary.json').exists():
        raise RuntimeError(f'the live scan left no summary: {(out / "live.log").read_text()[-500:]}')
    memory = [watch.minutes[k] for k in sorted(watch.minutes)]
    cost = LiveCost(name, watch.seconds, watch.cpu(), dict(watch.rss), memory, load=load)
    stamps = [pose.stamp_ns for pose in read_tum(out / 'odometry.tum')]
    cost.gap_s = float(np.diff(stamps).max()) / 1e9 if len(stamps) > 1 else float('nan')
    return _with_summary(cost, json.loads((out / 'summary.json').read_text()), int(said or 0))


def _with_summary(cost: LiveCost, summary: dict[str, Any], sent: int) -> LiveCost:
    """The cost with what the scan reports of itself."""
    timing = summary['timing']
    latency = timing.get('latency_odometry', {})
    cost.sent = max(sent, summary['frames']['read'])
    cost.shed = summary['frames']['rejected'].get(SHED, 0)
    cost.lost = cost.sent - summary['frames']['used'] - cost.shed
    cost.latency_p50 = latency.get('p50_ms', float('nan'))
    cost.latency_p99 = latency.get('p99_ms', float('nan'))
    cost.closure_to_model_s = timing.get('closure_to_model', {}).get('p50_ms', float('nan')) / 1e3
    cost.result = summary['result']
    return cost


class _Watch:
    """CPU and memory of the node processes under some roots, from the first frame to the last.

    Frames are counted as the nodes' diagnostics have them, once a second.
    """

    def __init__(self, roots: Sequence[int]) -> None:
        self._roots = [psutil.Process(pid) for pid in roots]
        self._names: dict[int, str] = {}
        self._first: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._start_s = 0.0
        self.rss: dict[str, float] = defaultdict(float)
        self.minutes: dict[int, float] = defaultdict(float)  # memory, of the minutes since the first frame
        self.seconds = 0.0

    def follow(self, scan: 'subprocess.Popen[bytes]') -> None:
        """Until no more frames come, or the scan ends."""
        monitor = Monitor('graph')
        frames = 0
        try:
            while scan.poll() is None and (monitor.idle_s or 0.0) < _IDLE_S / 2:
                monitor.spin(_TICK_S)
                received = monitor.progress().frames
                now = self._look()
                if received == frames:
                    continue
                if not frames:
                    self._start_s, self._first = time.monotonic(), now
                frames, self._last, self.seconds = received, now, time.monotonic() - self._start_s
        finally:
            monitor.close()

    def cpu(self) -> dict[str, float]:
        """Cores, by node."""
        return {n: (s - self._first.get(n, 0.0)) / max(self.seconds, 1e-9) for n, s in self._last.items()}

    def _look(self) -> dict[str, float]:
        """CPU seconds so far, by node."""
        now: dict[str, float] = {}
        together = 0.0
        for root in self._roots:
            try:
                processes = [root, *root.children(recursive=True)]
            except psutil.Error:
                continue
            for process in processes:
                try:
                    name = self._names.get(process.pid) or _node_name(process)
                    if name is None:
                        continue
                    self._names[process.pid] = name
                    times, memory = process.cpu_times(), process.memory_full_info()
                except psutil.Error:  # ended meanwhile
                    continue
                now[name] = times.user + times.system
                self.rss[name] = max(self.rss[name], memory.rss / 1e6)
                together += 0.0 if name in CAMERAS else memory.pss / 1e6
        minute = int((time.monotonic() - self._start_s) // 60) if self._start_s else 0
        self.minutes[minute] = max(self.minutes[minute], together)
        return now


def _node_name(process: psutil.Process) -> str | None:
    for part in process.cmdline():
        if part.startswith(('debris_scanner.nodes.', 'benchmarks.performance.cloud_camera')):
            return part.rsplit('.', 1)[1]
    return None
