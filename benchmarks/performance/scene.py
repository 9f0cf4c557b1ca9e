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

"""Spinning targets as a Kinect sees them: the frames that ours and the peers are measured on."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame, TargetFrame
from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse, rotation_angle, transform
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

SPIN = 0.5  # rad/s; only the steps between frames matter here
PAIR_STEP_DEG = 8.0
FRAMES = 77  # of one turn
VOXEL = 0.002  # m: 12 000 points a frame


@dataclass(frozen=True)
class Shot:
    """A depth frame, its target and the true T_sensor_target (4, 4)."""

    depth: DepthFrame
    target: TargetFrame
    pose: Array

    @cached_property
    def view(self) -> View:
        """Prepared for registration."""
        return View(self.target)

    @cached_property
    def organised(self) -> NDArray[np.float32]:
        """Points of the target (n, 3) in the sensor frame, NaN off the target: what PCL's filters get."""
        return np.ascontiguousarray(self.target.camera.back_project(self.target.depth).reshape(-1, 3))

    @cached_property
    def cloud(self) -> NDArray[np.float32]:
        """Points of the target (n, 3), one a voxel of 2 mm."""
        points = self.organised[np.isfinite(self.organised[:, 2])].astype(np.float64)
        _, voxel = np.unique(np.floor(points / VOXEL).astype(np.int64), axis=0, return_inverse=True)
        count = np.bincount(voxel.ravel())
        mean = [np.bincount(voxel.ravel(), points[:, k]) / count for k in range(3)]
        return np.stack(mean, axis=1).astype(np.float32)


@lru_cache
def turn(
    step_deg: float, count: int, range_m: float = 0.8, target: str = 'shuttle_stack', colour: bool = False
) -> list[Shot]:
    """So many frames of a spinning target, turned by ``step_deg`` between them; striped, if in colour."""
    rate = SPIN / np.radians(step_deg)
    settings = SimulationSettings(
        target=target,
        rate_hz=float(rate),
        seconds=count / float(rate),
        spin_rad_s=SPIN,
        range_m=range_m,
        colour=colour,
    )
    preprocessor = make_preprocessor(Settings())
    shots = []
    for f in Simulation(settings):
        depth = DepthFrame(f.stamp_ns, f.depth_mm * np.float32(0.001), f.camera, f.rgb)
        shots.append(Shot(depth, preprocessor.process(depth), f.T_sensor_target))
    return shots[:count]


def pair_shots(count: int, target: str = 'shuttle_stack', colour: bool = False) -> list[Shot]:
    """Frames of which each and the next make a pair."""
    return turn(PAIR_STEP_DEG, count + 1, target=target, colour=colour)


def whole_turn() -> list[Shot]:
    """77 frames of one turn."""
    return turn(360.0 / FRAMES, FRAMES)


def pair_error(T_target_source: Array, target: Shot, source: Shot) -> tuple[float, float]:
    """Degrees and millimetres that a registered pair is off, the shift taken at the source's centroid."""
    true = compose(target.pose, inverse(source.pose))
    angle = rotation_angle(compose(inverse(true), T_target_source)[:3, :3])
    centre = source.view.centroid
    shift = np.linalg.norm(apply(T_target_source, centre) - apply(true, centre))
    return float(np.degrees(angle)), float(shift) * 1e3


def drifted(shots: list[Shot], degrees: float = 5.0, metres: float = 0.01) -> list[Array]:
    """Poses T_first_sensor that drift away from the truth over the turn, as an odometry's would."""
    first = shots[0].pose
    poses = []
    for k, shot in enumerate(shots):
        share = k / (len(shots) - 1)
        true = compose(first, inverse(shot.pose))
        off = exp_so3(np.radians(degrees) * share * np.array([0.6, 0.64, 0.48]))
        centre = first[:3, 3]  # the drift turns the frame about the target, not about the sensor
        drift = transform(off, centre - off @ centre + share * metres * np.array([0.48, 0.6, 0.64]))
        poses.append(compose(drift, true))
    return poses


def pose_errors(poses: list[Array], shots: list[Shot]) -> tuple[float, float]:
    """Median error of T_first_sensor: degrees, and millimetres at the target's centre."""
    first = shots[0].pose
    angles, shifts = [], []
    anchor = compose(first, inverse(shots[0].pose), inverse(poses[0]))  # the first pose is given
    for T, shot in zip(poses, shots, strict=True):
        found, true = compose(anchor, T), compose(first, inverse(shot.pose))
        angles.append(np.degrees(rotation_angle(found[:3, :3].T @ true[:3, :3])))
        centre = shot.view.centroid
        shifts.append(np.linalg.norm(apply(found, centre) - apply(true, centre)) * 1e3)
    return float(np.median(angles)), float(np.median(shifts))


def edges_of(shots: list[Shot], count: int) -> list[tuple[int, int]]:
    """Edges (later, earlier): the chain, its closure, then pairs ever further apart until enough."""
    n = len(shots)
    edges = [(k + 1, k) for k in range(n - 1)] + [(n - 1, 0)]
    step = 2
    while len(edges) < count:
        edges += [(max(k, (k + step) % n), min(k, (k + step) % n)) for k in range(n)]
        step += 1
    return edges[:count]
