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

"""Records a scan's estimates and closures while it runs, for the result that is written at its end."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from debris_scanner.core.frames import Model
from debris_scanner.core.geometry import Array, compose, hat, inverse
from debris_scanner.core.results import (
    CAMERA_INFO,
    NO_TARGET,
    TOO_FEW_FRAMES,
    ClosureRecord,
    Descriptions,
    Forecast,
    GraphEdge,
    RateSample,
    StampedPose,
    commonest,
)
from debris_scanner.faults import Faults
from debris_scanner.io.result_files import ScanResult
from debris_scanner.modelling.generation import Generation
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.modelling.symmetry import rotational_symmetry
from debris_scanner.sensing.hints import joined
from debris_scanner.sensing.isolation import SETTLING
from debris_scanner.tracking.dynamics import fit_dynamics
from debris_scanner.tracking.forecast import predict
from debris_scanner.tracking.odometry import NOT_REGISTERED, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath

# Why no frame showed a target, by the commonest rejection; frames settle for the first second or so.
NOTHING_SEEN = {CAMERA_INFO: CAMERA_INFO, SETTLING: TOO_FEW_FRAMES}
STILL = 0.01  # rad/s: a slower target counts as not rotating


class FrameCounts(NamedTuple):
    """Frames that never reached the back end, and the timing of all stages."""

    rejected: dict[str, int]  # by reason
    timing: dict[str, dict[str, float]]
    descriptions: Descriptions | None = None  # of the key frames; None if another process has them
    errors: Mapping[str, int] = MappingProxyType({})  # exceptions of other processes, by type
    hint: str = ''  # what is odd about the input, where most of it is of no use
    units: str = ''  # what is odd about its unit


class ScanRecorder:
    """Estimates, rates and closure decisions in order of time, and how many frames were of use."""

    def __init__(self) -> None:
        self.odometry: list[StampedPose] = []
        self.rates: list[RateSample] = []
        self.closures: list[ClosureRecord] = []
        self.used = 0  # frames whose pose was accepted
        self.rejected: Counter[str] = Counter()  # frames that came here and are not used, by reason
        self.descriptions: Descriptions | None = None  # of the key frames, where no detector has them
        self._submaps: list[int] = []  # of each pose in odometry
        self._omega_sensor: list[Array] = []  # rad/s, of accepted frames

    def add_estimate(self, estimate: OdometryEstimate, T_model_scan: Array | None) -> None:
        """Add the estimate of a frame.

        Args:
            estimate: of the frame.
            T_model_scan: (4, 4), from the scan's target frame to the model's; None while there is no model.
        """
        e = estimate
        self.rates.append(RateSample(e.stamp_ns, e.omega_target, e.omega_sigma, e.accepted))
        if e.accepted:
            T = e.T_sensor_target
            if e.tracked and T_model_scan is not None:
                T = compose(T, T_model_scan)
            self.odometry.append(StampedPose(e.stamp_ns, T))
            self._submaps.append(e.submap)
            self._omega_sensor.append(e.T_sensor_target[:3, :3] @ e.omega_target)
            self.used += 1
        else:
            self.rejected[e.rejected or NOT_REGISTERED] += 1

    @property
    def taken(self) -> int:
        """Frames that came here, used or not."""
        return self.used + self.rejected.total()

    def result(
        self,
        builder: ModelBuilder,
        generation: Generation,
        counts: FrameCounts,
        interrupted: str | None = None,
        sensor_path: SensorPath | None = None,
        faults: Faults | None = None,
    ) -> ScanResult:
        """The scan's result after the last generation.

        Args:
            builder: holds the key frames and all accepted frames.
            generation: the last one.
            counts: of what did not come here.
            interrupted: overrides the reason of an interrupted scan without a model.
            sensor_path: how the sensor moved, where that is known.
            faults: of this process; a figure that raises is left out, and counted.
        """
        faults = faults or Faults()
        rejected = dict(Counter(counts.rejected) + self.rejected)
        frames_read = self.used + sum(rejected.values())
        # a known model that is given up takes the stored frames with it
        seen = bool(builder.store.frames or builder.keyframes)
        reason = _reason(generation, seen or not frames_read, rejected, interrupted)
        own = reason == generation.reason  # else its words and checks are about something else
        keyframes, frames = builder.comparable(with_model=generation.model is not None)
        poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
        final = [StampedPose(f.stamp_ns, inverse(f.pose(poses))) for f in frames]
        figures = _figures(builder, generation, final, sensor_path or SensorPath(), faults)
        # what did not turn at all may be no target
        still = len(builder.keyframes) == 1
        useless = generation.model is None and (2 * self.used < frames_read or still)
        return ScanResult(
            reason=reason,
            why=generation.why if own else '',
            checks=generation.checks if own else (),
            model=generation.model,
            tracked=generation.model is not None and builder.known is not None,
            poses=final,
            odometry=self._odometry_of({f.stamp_ns for f in frames}),
            rates=self.rates,
            keyframe_poses=[
                StampedPose(k.stamp_ns, inverse(k.T_target_sensor)) for k in keyframes if not k.added
            ],
            closures=self.closures,
            frames_read=frames_read,
            frames_rejected=rejected,
            errors=dict(Counter(counts.errors) + faults.counts.copy()),  # those of the figures, too
            timing=counts.timing,
            descriptions=counts.descriptions or self.descriptions,
            hint=joined(counts.hint if useless else '', counts.units),
            **self._rotation(),
            **figures,
        )

    def _odometry_of(self, stamps: set[int]) -> list[StampedPose]:
        """The odometry of the latest submap that has some of these frames: merging did not move it."""
        of_submap = list(zip(self.odometry, self._submaps, strict=True))
        submap = max((s for p, s in of_submap if p.stamp_ns in stamps), default=0)
        return [p for p, s in of_submap if s == submap]

    def _rotation(self) -> dict[str, Any]:
        """Mean axis (3,) in the sensor frame and period, s, of the rates of accepted frames."""
        omega = self._omega_sensor
        if len(omega) < 2:
            return {}
        speed = float(np.median(np.linalg.norm(omega, axis=1)))
        mean = np.mean(omega, axis=0)
        if speed < STILL or np.linalg.norm(mean) < STILL:
            return {}
        axis = mean / np.linalg.norm(mean)
        return {'rotation_axis_sensor': axis, 'rotation_period_s': 2 * np.pi / speed}


def _reason(
    generation: Generation, seen: bool, rejected: dict[str, int], interrupted: str | None
) -> str | None:
    """Why there is no model; None with one. ``seen``: a frame showed a target, or there was no frame."""
    reason = generation.reason
    if reason is not None and not seen:
        reason = NOTHING_SEEN.get(commonest(rejected), NO_TARGET)
    # a camera_info that was wrong until then would have been so for longer
    return interrupted if interrupted is not None and reason not in (None, CAMERA_INFO) else reason


def _figures(
    builder: ModelBuilder,
    generation: Generation,
    poses: list[StampedPose],
    sensor_path: SensorPath,
    faults: Faults,
) -> dict[str, Any]:
    """Figures of a result, by name; one that raises is left out."""
    beside = builder.answer.beside
    figures: dict[str, Any] = {
        'edges': [],
        'sensor': _sensor(builder),
        'model_disagreement': None if beside is None else beside.told(),
    }
    with faults.contained('the mass properties'):
        told, ahead = _dynamics(builder, generation.model, poses, sensor_path)
        figures |= {'mass_properties': told, 'forecast': ahead}
    with faults.contained('the symmetry'):
        figures['symmetry'] = None if generation.model is None else rotational_symmetry(generation.model)
    with faults.contained('the graph'):
        figures['edges'] = _edges(builder, generation)
    return figures


def _sensor(builder: ModelBuilder) -> dict[str, Any] | None:
    """The sensor's measured noise, for summary.json."""
    measured = builder.measure_sensor()
    return None if measured is None else asdict(measured)


def _dynamics(
    builder: ModelBuilder, model: Model | None, poses: list[StampedPose], sensor_path: SensorPath
) -> tuple[dict[str, Any] | None, Forecast | None]:
    """What the motion tells of the target's mass, and how it goes on; None without a model."""
    if model is None or builder.attitude_noise is None:
        return None, None
    extent = float(np.ptp(model.points, axis=0).max())
    placed = sensor_path.place(poses)
    noise = float(np.hypot(builder.attitude_noise, placed.sigma_rad))
    dynamics = fit_dynamics(placed.poses, noise, extent, mean_motion=builder.settings.motion.mean_motion)
    if dynamics is None:
        return None, None
    told = dynamics.mass_properties(placed.T_sensor_frame[:3, :3]) | {'frame': placed.frame}
    if placed.why_not:
        told['odometry_unused'] = placed.why_not
    return told, predict(dynamics, placed.poses, noise, extent, placed.T_sensor_frame).ahead()


def _edges(builder: ModelBuilder, generation: Generation) -> list[GraphEdge]:
    """Edges between the scan's own key frames, earlier to later, with the registration's information."""
    optimised = generation.optimised
    if optimised is None or generation.model is None:
        return []
    motion = builder.settings.motion
    scale = motion.information_scale / builder.graph.keyframes.resolution**2
    known = {k.stamp_ns: k for k in builder.keyframes}
    members = [known[stamp] for stamp in optimised.stamps]
    poses = [k.T_target_sensor for k in members]
    own = {n: position for position, n in enumerate(n for n, k in enumerate(members) if not k.added)}
    translation_first = [3, 4, 5, 0, 1, 2]
    edges = []
    for edge, H, weight in zip(
        optimised.edges, optimised.relaxed.information, optimised.relaxed.weights, strict=True
    ):
        if edge.i not in own or edge.j not in own:
            continue
        T = poses[edge.i]
        # left twist in the target frame, for which H holds, per right twist in the later view's frame
        adjoint = np.zeros((6, 6))
        adjoint[:3, :3] = adjoint[3:, 3:] = T[:3, :3]
        adjoint[3:, :3] = hat(T[:3, 3]) @ T[:3, :3]
        local = adjoint.T @ (H * weight * scale) @ adjoint
        local = local[np.ix_(translation_first, translation_first)]
        edges.append(GraphEdge(own[edge.j], own[edge.i], compose(inverse(poses[edge.j]), T), local))
    return edges
