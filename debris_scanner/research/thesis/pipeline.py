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

"""The thesis's method from target frames to model, as it was published (fig. 3.5; T7, T8, T14-T21).

Each frame is aligned with the next, and the rates are filtered. Views are compared; a loop is closed where
similarity and attitude agree. The frame graph is pruned; the clouds are prealigned, relaxed in the nested
loop, merged and refined. There is no geometric verification: the best surviving hypothesis makes the model.
Where the thesis gave up after one, the next is tried: when the loop does not survive pruning, the spring
network starts unstable, or it is not connected in the relaxation.

``odometry_only`` is the method of section 4.1, which the thesis improves upon.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from debris_scanner.core import results
from debris_scanner.core.frames import KeyFrame, Model, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse, transform
from debris_scanner.core.results import ClosureRecord, StampedPose
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.frame_graph import FrameEdge, FrameGraph
from debris_scanner.modelling.refinement import colour
from debris_scanner.research.thesis import batch_processor, lum, odometry
from debris_scanner.research.thesis.loop_closures import (
    ClosureProbabilities,
    closed_graphs,
    hypotheses,
    open_graph,
    probabilities,
)
from debris_scanner.research.thesis.lum import pose_matrix
from debris_scanner.research.thesis.network import network
from debris_scanner.research.thesis.odometry import Odometry, Progress
from debris_scanner.research.thesis.refiner import merge, refine
from debris_scanner.research.thesis.settings import ThesisSettings
from debris_scanner.research.thesis.spring_stability import Stability, assess


@dataclass
class ThesisResult:
    """Everything that the thesis plots of a run; ``model`` is None exactly when ``reason`` is set."""

    reason: str | None = None  # as in results
    detail: str = ''  # what happened, in words
    model: Model | None = None
    poses: list[StampedPose] = field(default_factory=list)  # of the model's frames, relaxed
    odometry_poses: list[StampedPose] = field(default_factory=list)  # of all frames, before closure
    odometry: Odometry | None = None  # rates, residuals, covariances, kept frames
    probabilities: ClosureProbabilities | None = None
    closures: list[ClosureRecord] = field(default_factory=list)
    graph_before: FrameGraph | None = None  # with the closures of the hypothesis that was used
    graph_after: FrameGraph | None = None  # pruned
    stability: Stability | None = None
    relaxed: lum.RelaxedNetwork | None = None  # None too where ELCH stands alone
    timing: dict[str, dict[str, float]] = field(default_factory=dict)


def run(
    frames: Sequence[TargetFrame],
    settings: ThesisSettings | None = None,
    progress: Progress | None = None,
    motion: Odometry | None = None,
) -> ThesisResult:
    """The published method on a recording's target frames.

    Args:
        frames: in order of time.
        settings: as :class:`ThesisSettings`.
        progress: called with stage, steps done and steps in all.
        motion: what :func:`odometry.estimate` made of the same frames and settings, to compare ways of
            closing the loop without aligning everything again.
    """
    settings = settings or ThesisSettings()
    timer = StageTimer()
    result = ThesisResult(results.TOO_FEW_FRAMES)
    try:
        with timer.stage('odometry'):
            motion = motion or odometry.estimate(frames, settings, progress)
    except ValueError as error:
        result.detail = str(error)
        return result
    result.odometry = motion
    result.odometry_poses = [
        StampedPose(c.stamp_ns, T) for c, T in zip(motion.clouds, motion.poses, strict=True)
    ]
    with timer.stage('probabilities'):
        result.probabilities = probabilities(motion, settings)
        proposed = hypotheses(result.probabilities, motion, settings)
    graph = open_graph(motion, settings)
    result.graph_before = graph
    result.reason = results.NO_CLOSURE
    result.detail = f'none of {len(proposed)} closures leaves a loop after pruning'
    used: list[FrameEdge] = []
    refused: dict[FrameEdge, str] = {}
    for before, after, closures in closed_graphs(graph, proposed, settings.closure.search):
        result.graph_before, result.graph_after = before, after
        why = _modelled(result, after, motion, settings, timer, progress)
        if not why:
            used = closures
            break
        refused |= dict.fromkeys(closures, why)
    result.closures = _records(proposed, used, refused)
    result.timing = timer.summary()
    return result


def _modelled(
    result: ThesisResult,
    graph: FrameGraph,
    motion: Odometry,
    settings: ThesisSettings,
    timer: StageTimer,
    progress: Progress | None,
) -> str:
    """Relax a closed graph and make the model; why it cannot be relaxed, or nothing."""
    try:
        with timer.stage('relaxation'):
            moved = _relax(result, graph, motion, settings, progress)
    except lum.RelaxationError as error:
        result.reason, result.detail = results.INCONSISTENT_MODEL, str(error)
        return str(error)
    with timer.stage('refiner'):
        _refine(result, moved, motion, settings)
    return ''


def _relax(
    result: ThesisResult,
    graph: FrameGraph,
    motion: Odometry,
    settings: ThesisSettings,
    progress: Progress | None,
) -> dict[int, Array]:
    """T_target_sensor (4, 4), by index of cloud, of the frames in the pruned graph."""
    s = settings.relaxation
    net = network(graph, motion, s)
    if s.method == 'elch':
        return dict(zip(net.members, net.before, strict=True))
    if s.check_stability:
        at_rest = np.zeros((len(net.clouds), 6))
        springs = lum.springs_between(net.clouds, net.links, at_rest, s.max_distance)
        result.stability = assess(springs, at_rest)
        if not result.stability.stable:
            raise lum.RelaxationError(result.stability.reason)
    done = 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress:
            progress('relaxation', done, s.outer_iterations)

    result.relaxed = lum.relax(
        net.clouds, net.links, s.max_distance, s.outer_iterations, s.inner_iterations, s.tolerance, step
    )
    return {
        k: compose(pose_matrix(p), T)
        for k, p, T in zip(net.members, result.relaxed.poses, net.before, strict=True)
    }


def _refine(
    result: ThesisResult, moved: dict[int, Array], motion: Odometry, settings: ThesisSettings
) -> None:
    model, origin = make_model(moved, motion, settings)
    if model is None:
        result.reason, result.detail = results.INCONSISTENT_MODEL, 'too few points are left to refine'
        return
    result.model, result.reason = model, None
    result.detail = f'{len(moved)} frames, {len(model.points)} points, {len(model.triangles)} triangles'
    result.poses = [
        StampedPose(motion.clouds[k].stamp_ns, inverse(compose(transform(np.eye(3), -origin), T)))
        for k, T in moved.items()
    ]


def make_model(
    poses: dict[int, Array], motion: Odometry, settings: ThesisSettings
) -> tuple[Model | None, Array]:
    """Model from frames by index with T_target_sensor (4, 4), and the point (3,) that became its origin."""
    clouds = [motion.clouds[k] for k in poses]
    points, towards = merge([c.points for c in clouds], list(poses.values()))
    surface = refine(points, towards, settings.refiner)
    if surface is None:
        return None, np.zeros(3)
    keyframes = [KeyFrame(c.frame, T, 0.0) for c, T in zip(clouds, poses.values(), strict=True)]
    rgb = colour(surface.points.astype(np.float64), surface.normals.astype(np.float64), keyframes)
    origin = surface.points.mean(axis=0, dtype=np.float64)
    placed = (surface.points - origin).astype(np.float32)
    return Model(placed, surface.normals, placed, surface.triangles, rgb), origin


def _records(
    proposed: Sequence[FrameEdge], used: Sequence[FrameEdge], refused: dict[FrameEdge, str]
) -> list[ClosureRecord]:
    accepted = set(used)
    return [
        ClosureRecord(
            e.earlier_ns,
            e.later_ns,
            e.probability or 0.0,
            e in accepted,
            'in the pruned graph' if e in accepted else refused.get(e, 'not needed, or pruned away'),
        )
        for e in proposed
    ]


@dataclass
class OdometryModel:
    """Result of section 4.1: poses and model by the batch processor alone."""

    poses: list[StampedPose]  # T_sensor_target
    model: Model | None
    batch: batch_processor.BatchResult
    outliers: list[int]  # stamps of frames whose translation was interpolated
    odometry: Odometry


def odometry_only(
    frames: Sequence[TargetFrame],
    settings: ThesisSettings | None = None,
    progress: Progress | None = None,
    motion: Odometry | None = None,
) -> OdometryModel:
    """Batch processor, translations of ICP without their outliers, eq. 4.1-4.3; no loop is closed (T7).

    Arguments as of :func:`run`.

    Raises:
        ValueError: if fewer than two frames are usable or no two of them could be aligned.
    """
    settings = settings or ThesisSettings()
    motion = motion or odometry.estimate(frames, settings, progress)
    batch = motion.batch or batch_processor.estimate(
        motion.clouds[0].stamp_ns,
        motion.observations,
        np.array(settings.ekf.prior_state),
        np.diag(settings.ekf.prior_variance),
        settings.odometry.planar,
    )
    missing = np.full(3, np.nan)
    steps = np.array([missing if T is None else T[:3, 3] for T in motion.alignments])
    translations, outlier = batch_processor.replace_outliers(steps)
    rotations = [batch.attitude(c.stamp_ns).T for c in motion.clouds]
    chain = batch_processor.odometry_poses(rotations, translations)
    model, origin = make_model({k: chain[k] for k in motion.kept}, motion, settings)
    shift = transform(np.eye(3), -origin)
    poses = [
        StampedPose(c.stamp_ns, inverse(compose(shift, T))) for c, T in zip(motion.clouds, chain, strict=True)
    ]
    stamps = [c.stamp_ns for c, bad in zip(motion.clouds[1:], outlier, strict=True) if bad]
    return OdometryModel(poses, model, batch, stamps, motion)
