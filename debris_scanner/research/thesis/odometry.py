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

"""From target frames to attitudes: thinning, voxel clouds, ICP, rates, estimator, kept frames.

Trowbridge 2014, section 3.2, figs. 3.4 and 3.5; thesis parts T3-T9.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse, transform
from debris_scanner.core.results import RateSample
from debris_scanner.core.voxel_grid import voxel_grid_with_normals
from debris_scanner.mapping.closure_search import relative_angle
from debris_scanner.research.thesis import attitude_ekf, batch_processor
from debris_scanner.research.thesis.euler_parameters import RateObservation, angular_rate, rotation_matrix
from debris_scanner.research.thesis.frame_registration import register_points
from debris_scanner.research.thesis.settings import ThesisSettings

MIN_POINTS = 100  # a frame with fewer cannot be aligned
Progress = Callable[[str, int, int], None]  # stage, steps done, steps in all


@dataclass(frozen=True)
class Cloud:
    """A frame on the voxel grid: points (n, 3) metres, unit normals (n, 3) towards the sensor or zero."""

    frame: TargetFrame
    points: NDArray[np.float32]
    normals: NDArray[np.float32]

    @property
    def stamp_ns(self) -> int:
        """The frame's identity."""
        return self.frame.stamp_ns


@dataclass
class Odometry:
    """What is known of the motion before any loop is closed; lists run over ``clouds``."""

    clouds: list[Cloud]
    observations: list[RateObservation]  # from the second frame on
    alignments: list[Array | None]  # T_previous_current (4, 4), from the second frame on
    attitudes: list[Array]  # R_sensor_target (3, 3) of the estimator
    poses: list[Array]  # T_sensor_target (4, 4), alignments chained (eq. 2.32)
    path: Array  # rotation travelled, radians
    rates: list[RateSample]  # from the second frame on
    kept: list[int]  # indices of the frames a model is made from
    ekf: list[attitude_ekf.EkfStep] | None = None
    batch: batch_processor.BatchResult | None = None


def thin_out(frames: Sequence[TargetFrame], rate: float) -> list[TargetFrame]:
    """Frames at no more than ``rate`` a second, the first of each period."""
    period_ns = 1e9 / rate
    kept: list[TargetFrame] = []
    for frame in frames:
        # a tenth of a period of jitter must not cost every second frame
        if not kept or frame.stamp_ns - kept[-1].stamp_ns >= 0.9 * period_ns:
            kept.append(frame)
    return kept


def to_cloud(frame: TargetFrame, voxel: float) -> Cloud:
    """Voxel cloud of a frame's measured points."""
    seen = frame.depth > 0
    points = frame.camera.back_project(frame.depth)[seen]
    return Cloud(frame, *voxel_grid_with_normals(points, frame.normals[seen], voxel))


def estimate(
    frames: Sequence[TargetFrame], settings: ThesisSettings, progress: Progress | None = None
) -> Odometry:
    """Align every frame with the one before, estimate attitude and rate, and choose the frames to keep.

    Raises:
        ValueError: if fewer than two frames carry enough points, or the batch processor has no rate.
    """
    s = settings.odometry
    clouds = [to_cloud(f, s.voxel) for f in thin_out(frames, s.sample_rate)]
    clouds = [c for c in clouds if len(c.points) >= MIN_POINTS]
    if len(clouds) < 2:
        raise ValueError(f'{len(clouds)} usable frames are no sequence')
    observations: list[RateObservation] = []
    alignments: list[Array | None] = []
    fitness = 0.0
    for k in range(1, len(clouds)):
        dt = (clouds[k].stamp_ns - clouds[k - 1].stamp_ns) * 1e-9
        aligned = None
        if dt <= s.max_gap / s.sample_rate + 1e-9:
            aligned = register_points(
                clouds[k].points, clouds[k - 1].points, s.max_distance, s.iterations, s.tolerance
            )
        if aligned is None:
            observations.append(RateObservation(clouds[k].stamp_ns, None, fitness))
            alignments.append(None)
        else:
            fitness = aligned.fitness
            omega = angular_rate(aligned.T_target_source[:3, :3], dt)
            observations.append(RateObservation(clouds[k].stamp_ns, omega, fitness))
            alignments.append(aligned.T_target_source)
        if progress:
            progress('registration', k, len(clouds) - 1)
    return _estimated(clouds, observations, alignments, settings)


def _estimated(
    clouds: list[Cloud],
    observations: list[RateObservation],
    alignments: list[Array | None],
    settings: ThesisSettings,
) -> Odometry:
    start_ns = clouds[0].stamp_ns
    s = settings.odometry
    ekf, batch = None, None
    if s.estimator == 'ekf':
        ekf = attitude_ekf.run(start_ns, observations, settings.ekf)
        first = rotation_matrix(np.array(settings.ekf.prior_state[:4]))
        attitudes = [first] + [step.R_sensor_target for step in ekf]
        rates = [
            RateSample(
                e.stamp_ns, _in_target(e.omega, e.R_sensor_target, settings), e.three_sigma / 3, e.accepted
            )
            for e in ekf
        ]
    else:
        batch = batch_processor.estimate(
            start_ns,
            observations,
            np.array(settings.ekf.prior_state),
            np.diag(settings.ekf.prior_variance),
            s.planar,
        )
        attitudes = [batch.attitude(c.stamp_ns) for c in clouds]
        sigma = np.sqrt(np.diag(batch.covariance)[4:])
        omega = batch.state[4:] * ([0, 1, 0] if s.planar else [1, 1, 1])
        rates = [RateSample(o.stamp_ns, omega, sigma, o.omega is not None) for o in observations]
    # the target frame is the first frame's attitude, whatever attitude the prior gives to it
    first = attitudes[0].T
    body = s.estimator == 'batch' or settings.ekf.rate_axes == 'body'
    attitudes = [first @ R if body else R @ first for R in attitudes]
    steps = np.array([relative_angle(a, b[None])[0] for a, b in pairwise(attitudes)])
    poses = _chain(clouds, alignments, attitudes)
    kept = keep_by_angle([T[:3, :3] for T in poses], s.keyframe_angle_deg)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    return Odometry(clouds, observations, alignments, attitudes, poses, path, rates, kept, ekf, batch)


def keep_by_angle(rotations: Sequence[Array], angle_deg: float) -> list[int]:
    """Indices of frames that have turned by ``angle_deg`` since the last one kept; 0 keeps all (T8)."""
    if angle_deg == 0:
        return list(range(len(rotations)))
    kept = [0]
    for k in range(1, len(rotations)):
        if relative_angle(rotations[k], rotations[kept[-1]][None])[0] >= np.radians(angle_deg):
            kept.append(k)
    return kept


def _chain(clouds: list[Cloud], alignments: list[Array | None], attitudes: list[Array]) -> list[Array]:
    """T_sensor_target (4, 4): alignments chained; over a gap the estimator turns it about the centroid."""
    chain = [np.eye(4)]  # T_first_current, eq. 2.32
    for k, aligned in enumerate(alignments, start=1):
        step = aligned
        if step is None:
            R = attitudes[k - 1] @ attitudes[k].T
            before, after = (clouds[m].points.mean(axis=0, dtype=np.float64) for m in (k - 1, k))
            step = transform(R, before - R @ after)
        chain.append(compose(chain[-1], step))
    return [inverse(T) for T in chain]


def _in_target(omega: Array, R_sensor_target: Array, settings: ThesisSettings) -> Array:
    return R_sensor_target.T @ omega if settings.ekf.rate_axes == 'sensor' else omega
