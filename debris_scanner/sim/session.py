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

"""A simulated recording: settings in, frames with their true poses out."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.geometry import Array
from debris_scanner.core.results import StampedPose
from debris_scanner.io.mesh_files import write_mesh_ply
from debris_scanner.io.trajectories import write_tum
from debris_scanner.sim.clutter import make_clutter
from debris_scanner.sim.depth_sensor import KINECT, DepthSensor, SensorSettings
from debris_scanner.sim.motions import SPIN, TUMBLE, MotionSettings, make_motion
from debris_scanner.sim.paint import paint
from debris_scanner.sim.targets import Target, make_target

FIRST_STAMP_NS = 1_000_000_000
TRUTH_POSES = 'truth.tum'
TRUTH_MESH = 'truth_mesh.ply'

_SECONDS = 25.0
_SECONDS_TUMBLE = 60.0


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a recording. Equal settings give equal frames, bit for bit."""

    target: str = 'shuttle_stack'
    motion: str = SPIN
    seed: int = 0  # of the motion and of the noise
    rate_hz: float = 10.0  # frames a second
    seconds: float | None = None  # None: 25, or 60 for a tumble
    size: float | None = None  # largest extent of the target, metres; None: the target's own
    spin_rad_s: float = 0.5  # negative turns the other way
    axis_sensor: tuple[float, float, float] | None = None  # None: 15 to 25 degrees off the vertical, by seed
    range_m: float = 0.8
    gaps: bool = False  # out of sight for 1 to 3 s now and then
    gaps_from_s: float = 0.0  # no gap begins before
    patchy: bool = False  # now and then partially occluded
    leaves_s: float | None = None  # out of sight for good from then on
    mli: bool = False  # shiny insulation
    noise: bool = True
    correlated: bool = False  # noise correlated over 4 pixels
    clutter: str | None = None  # wall, table or object
    colour: bool = False  # beside the depth

    @property
    def duration_s(self) -> float:
        """Length of the recording."""
        if self.seconds is not None:
            return self.seconds
        return _SECONDS_TUMBLE if self.motion == TUMBLE else _SECONDS


@dataclass(frozen=True)
class SimulatedFrame:
    """One frame and its truth: depth (480, 640) in millimetres, 0 invalid; T_sensor_target (4, 4)."""

    stamp_ns: int
    depth_mm: NDArray[np.uint16]
    camera: Camera
    T_sensor_target: Array
    rgb: NDArray[np.uint8] | None = None  # (480, 640, 3)


class Simulation:
    """The frames of one recording, made on demand; iterates any number of times, in any order."""

    def __init__(self, settings: SimulationSettings) -> None:
        """Build target, motion and sensor.

        Raises:
            ValueError: unknown target, motion or clutter, or numbers that make no recording.
        """
        self.settings = settings
        duration = settings.duration_s
        if not (0 < settings.rate_hz < np.inf and 0 < duration < np.inf):
            raise ValueError(
                f'rate and length must be positive, not {settings.rate_hz!r} Hz and {duration!r} s'
            )
        if not (0.3 <= settings.range_m <= 5 and np.isfinite(settings.spin_rad_s)):
            raise ValueError(
                f'range must be 0.3 to 5 m and the spin finite, not {settings.range_m!r} m '
                f'and {settings.spin_rad_s!r} rad/s'
            )
        if settings.seed < 0:
            raise ValueError(f'the seed must not be negative: {settings.seed}')
        self.target: Target = make_target(settings.target, settings.size)
        self.motion = make_motion(
            MotionSettings(
                settings.motion,
                settings.spin_rad_s,
                settings.axis_sensor,
                settings.range_m,
                settings.seed,
                duration,
                settings.gaps,
                settings.gaps_from_s,
                settings.patchy,
                settings.leaves_s,
            )
        )
        self._sensor = DepthSensor(
            self.target,
            SensorSettings(noise=settings.noise, correlated=settings.correlated, mli=settings.mli),
            settings.seed,
            KINECT,
            make_clutter(settings.clutter) if settings.clutter else None,
        )
        self._count = max(1, round(duration * settings.rate_hz))

    @property
    def camera(self) -> Camera:
        """The camera of every frame."""
        return self._sensor.camera

    def __len__(self) -> int:
        """Number of frames."""
        return self._count

    def stamp_ns(self, index: int) -> int:
        """Stamp of a frame: exact multiples of the frame time, after a start that is not zero."""
        return FIRST_STAMP_NS + round(index * 1e9 / self.settings.rate_hz)

    def pose(self, index: int) -> Array:
        """True T_sensor_target (4, 4) of a frame."""
        return self.motion.T_sensor_target(self._time_s(index))

    def frame(self, index: int) -> SimulatedFrame:
        """The frame of an index in 0..len-1."""
        if not 0 <= index < self._count:
            raise IndexError(f'frame {index} of {self._count}')
        t = self._time_s(index)
        T_sensor_target = self.motion.T_sensor_target(t)
        depth = self._sensor.render(
            T_sensor_target, index, self.motion.visibility(t), self.motion.T_sensor_world(t)
        )
        rgb = paint(depth, self.camera, T_sensor_target) if self.settings.colour else None
        return SimulatedFrame(self.stamp_ns(index), depth, self.camera, T_sensor_target, rgb)

    def __iter__(self) -> Iterator[SimulatedFrame]:
        """All frames in order."""
        return (self.frame(i) for i in range(self._count))

    def _time_s(self, index: int) -> float:
        return (self.stamp_ns(index) - FIRST_STAMP_NS) * 1e-9


def simulate(settings: SimulationSettings) -> Simulation:
    """The recording of these settings: ``len()`` counts its frames, iterating renders them."""
    return Simulation(settings)


def write_truth(folder: Path, stamps_ns: Sequence[int], poses: Sequence[Array], target: Target) -> None:
    """Write ``truth.tum`` and ``truth_mesh.ply`` beside a recording; the mesh of an empty scene is empty.

    Args:
        folder: of the recording; made where missing.
        stamps_ns: of the frames.
        poses: T_sensor_target (4, 4) of the frames.
        target: its mesh is the truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_tum(folder / TRUTH_POSES, [StampedPose(s, T) for s, T in zip(stamps_ns, poses, strict=True)])
    write_mesh_ply(folder / TRUTH_MESH, target.vertices, target.triangles)
