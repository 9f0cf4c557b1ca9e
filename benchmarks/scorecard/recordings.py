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

"""Where a case's frames and truth come from: the simulator, or a real recording."""

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_recordings import REAL, Real
from benchmarks.scorecard.cases import Case
from benchmarks.scorecard.targets import RECORDING, STRANGER, data_folder, mesh_file
from benchmarks.strangers import craft, sensor
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.evaluation.truth_cloud import cloud_ply
from debris_scanner.io.files import write_atomically
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.sim.session import FIRST_STAMP_NS, TRUTH_MESH, Simulation, SimulationSettings
from debris_scanner.sim.targets import scaled


class Recording(Protocol):
    """Frames with their truth."""

    def frames(self) -> Iterator[tuple[DepthFrame, Array | None]]:
        """Frames in order with their true T_sensor_target (4, 4), where there is one."""

    def visibility(self, stamp_ns: int) -> float:
        """Share of the target that shows."""

    def size_m(self) -> float:
        """Largest extent of the target."""

    def write_surface(self, folder: Path) -> None:
        """Write the true surface where ``evaluate`` looks for it."""


class SimulatedRecording:
    """A recording of the simulator."""

    def __init__(self, case: Case) -> None:
        mesh = mesh_file(case.target)
        settings = SimulationSettings(
            **{
                'target': case.target.name if mesh is None else str(mesh),
                'size': case.target.size,
                'seed': case.seed,
            }
            | case.options
        )
        if case.target.kind == STRANGER:
            target = scaled(case.target.name, craft(case.seed), case.options['size'])
            self._simulation = Simulation(settings, target, sensor(case.seed))
        else:
            self._simulation = Simulation(settings)

    def frames(self) -> Iterator[tuple[DepthFrame, Array | None]]:
        for f in self._simulation:
            yield DepthFrame(f.stamp_ns, f.depth, f.camera), f.T_sensor_target

    def pose_at(self, stamp_ns: int) -> Array:
        """True T_sensor_target (4, 4), up to a minute after the end."""
        return self._simulation.pose_at(stamp_ns)

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Principal moments about the target's axes, any unit."""
        return self._simulation.settings.inertia

    @property
    def centre_of_mass(self) -> tuple[float, float, float]:
        """In the target frame, m."""
        return self._simulation.settings.centre_of_mass

    def visibility(self, stamp_ns: int) -> float:
        return self._simulation.motion.visibility((stamp_ns - FIRST_STAMP_NS) * 1e-9)

    def size_m(self) -> float:
        return float(np.ptp(self._simulation.target.vertices, axis=0).max())

    def write_surface(self, folder: Path) -> None:
        target = self._simulation.target
        write_mesh_ply(folder / TRUTH_MESH, target.vertices, target.triangles)


class RealRecording:
    """A real recording, with measured poses or without."""

    def __init__(self, real: Real) -> None:
        self._real = real

    def frames(self) -> Iterator[tuple[DepthFrame, Array | None]]:
        yield from self._real.read(data_folder() / self._real.path)

    def visibility(self, stamp_ns: int) -> float:
        return 1.0

    def size_m(self) -> float:
        return float(np.ptp(self._surface(), axis=0).max())

    def write_surface(self, folder: Path) -> None:
        write_atomically(folder / 'truth_cloud.ply', cloud_ply(self._surface()))

    def _surface(self) -> NDArray[np.float32]:
        return self._real.surface((frame, inverse(T)) for frame, T in self.frames() if T is not None)


def open_recording(case: Case) -> Recording:
    """The recording of a case."""
    if case.target.kind == RECORDING:
        return RealRecording(REAL[case.target.name])
    return SimulatedRecording(case)
