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

"""What a tracked frame costs and how right it is, of a mesh that is known to begin with.

From the depth image to the pose, CPU time of the thread. Machines are compared by a pair of frames that
small_gicp registers in the same run: M3T (DLR-RM, C++), tuned, takes 0.03 of it, as was measured elsewhere.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.performance import python_peers
from benchmarks.performance.measure import Cost
from benchmarks.performance.report import number
from benchmarks.performance.scene import pair_shots
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array
from debris_scanner.evaluation.trajectory_errors import align, pose_errors
from debris_scanner.io.known_models import as_known_model
from debris_scanner.scanner import Scanner
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import make_target

TARGETS = ('shuttle_stack', 'cubesat', 'asteroid', 'upper_stage')
MOTIONS, RATES_HZ = ('spin', 'tumble'), (30, 5)
FRAMES = 240
BEGUN = 20  # tracked frames that are not counted: key frames are made, caches are filled
UNIT, UNIT_M, UNIT_PAIRS = 'cubesat', 0.004, 12  # target, voxels and number of the pairs that are the unit
HEAD = (
    '| recording | ms, median / 99 % | of a pair | tracked | attitude °, median / 95 % | position mm |\n'
    '|---|---|---|---|---|---|'
)


@dataclass(frozen=True)
class Tracked:
    """One recording."""

    name: str
    cost: Cost
    tracked: int  # of the frames after the first BEGUN that were tracked
    frames: int  # of these
    attitude_deg: tuple[float, float]  # median and 95th percentile
    position_mm: tuple[float, float]

    def line(self, pair_ms: float | None) -> str:
        """A row of the table; beside a pair of the peer, if there is one."""
        share = '' if pair_ms is None else f'{self.cost.median_ms / pair_ms:.3f}'
        return (
            f'| {self.name} | {number(self.cost.median_ms)} / {number(self.cost.p99_ms)} | {share} '
            f'| {self.tracked} of {self.frames} | {self.attitude_deg[0]:.3f} / {self.attitude_deg[1]:.3f} '
            f'| {self.position_mm[0]:.2f} / {self.position_mm[1]:.2f} |'
        )


def measure(target: str, motion: str, rate_hz: int, frames: int = FRAMES) -> Tracked:
    """Track the target's own mesh in a simulated recording of it."""
    simulation = Simulation(
        SimulationSettings(target=target, motion=motion, rate_hz=float(rate_hz), seconds=frames / rate_hz)
    )
    scanner = Scanner(model=as_known_model(make_target(target)))
    front, back = scanner.front_end, scanner.back_end
    truth: dict[int, Array] = {}
    found: dict[int, Array] = {}
    milliseconds = []
    for seen in simulation:
        frame = DepthFrame(seen.stamp_ns, seen.depth, seen.camera)
        known, start = front.odometry.model is not None, time.thread_time()
        step = front.process(frame)
        spent = time.thread_time() - start
        if known:
            truth[frame.stamp_ns] = seen.T_sensor_target
            milliseconds.append(spent * 1e3)
        if step.estimate is None:
            continue
        if known and step.estimate.tracked and step.estimate.accepted:
            found[frame.stamp_ns] = step.estimate.T_sensor_target
        # another process when live: it looks for the model, and asks about it now and then
        back.add(step.estimate, step.target, step.closures)
        if (generation := back.advance()) is not None:
            front.adopt(generation)
    counted = sorted(truth)[BEGUN:]
    found = {stamp: found[stamp] for stamp in counted if stamp in found}
    attitude, position = pose_errors(truth, found, align(truth, found))
    return Tracked(
        f'{target.replace("_", " ")}, {motion}, {rate_hz} Hz',
        Cost.of(milliseconds[BEGUN:]),
        len(found),
        len(counted),
        _median_p95(np.degrees(attitude)),
        _median_p95(position * 1e3),
    )


def recordings(frames: int) -> Iterator[Tracked]:
    """Each target in each motion at each rate."""
    return (measure(*which, frames) for which in product(TARGETS, MOTIONS, RATES_HZ))


def unit_ms() -> float | None:
    """A pair of the peer, measured now; None where it is not installed."""
    rows = python_peers.small_gicp_pair(pair_shots(UNIT_PAIRS, UNIT), UNIT_M)
    return rows[0].cost.median_ms if rows else None


def _median_p95(values: Array) -> tuple[float, float]:
    median, p95 = np.percentile(values, [50, 95])
    return float(median), float(p95)
