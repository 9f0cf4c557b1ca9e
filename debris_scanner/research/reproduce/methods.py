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

"""The three methods on one recording, each with its result in the form that a scan has.

Wall times are each method's own: what odometry-only and the thesis's method share, preprocessing and
frame-to-frame alignment, counts in both. Simulating the frames counts in none.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from debris_scanner.core.frames import DepthFrame, FrameRejected, TargetFrame
from debris_scanner.core.results import RateSample, StampedPose
from debris_scanner.io.result_files import ScanResult
from debris_scanner.research.reproduce.experiments import searching_greedily
from debris_scanner.research.thesis import odometry, pipeline
from debris_scanner.research.thesis.odometry import Odometry
from debris_scanner.research.thesis.pipeline import OdometryModel, ThesisResult
from debris_scanner.research.thesis.settings import ThesisSettings
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.preprocessing import Preprocessor

ODOMETRY_ONLY, THESIS, OURS = 'odometry_only', 'thesis', 'ours'
METHODS = (ODOMETRY_ONLY, THESIS, OURS)
OTHER_SEARCH = 'thesis_other_search'  # only where the thesis compared the two
METHOD_NAMES = {
    ODOMETRY_ONLY: 'odometry only',
    THESIS: "thesis's method",
    OTHER_SEARCH: 'thesis, greedy',
    OURS: 'ours',
}

Progress = Callable[[float, str], None]  # share done of the whole experiment, what is being done


@dataclass(frozen=True)
class Runs:
    """Everything the three methods said of one recording."""

    batch: OdometryModel
    thesis: ThesisResult
    ours: ScanResult
    results: dict[str, ScanResult]  # by method
    wall_s: dict[str, float]  # by method


def run_all(
    depth: list[DepthFrame], settings: ThesisSettings, progress: Progress, greedy_too: bool = False
) -> Runs:
    """All three on the same depth frames, in order of time.

    Args:
        depth: the recording.
        settings: of the thesis's method.
        progress: told of every step.
        greedy_too: run the thesis's method with greedy search as well.

    Raises:
        ValueError: too few frames show a target for any of them.
    """
    wall: dict[str, float] = {}
    start = time.perf_counter()
    frames = preprocess(depth, settings)
    motion = odometry.estimate(frames, settings, _share(progress, 0.1, 0.3))
    shared = time.perf_counter() - start

    start = time.perf_counter()
    batch = pipeline.odometry_only(frames, settings, motion=motion)
    wall[ODOMETRY_ONLY] = shared + time.perf_counter() - start
    progress(0.35, 'relaxation')

    start = time.perf_counter()
    split = 0.5 if greedy_too else 0.75
    thesis = pipeline.run(frames, settings, _share(progress, 0.35, split), motion=motion)
    wall[THESIS] = shared + time.perf_counter() - start
    more = {}
    if greedy_too:
        start = time.perf_counter()
        rule = searching_greedily(settings)
        greedy = pipeline.run(frames, rule, _share(progress, split, 0.75), motion=motion)
        wall[OTHER_SEARCH] = shared + time.perf_counter() - start
        more[OTHER_SEARCH] = _of_thesis(greedy, len(depth), len(depth) - len(frames))

    start = time.perf_counter()
    ours = _ours(depth, progress)
    wall[OURS] = time.perf_counter() - start
    rejected = len(depth) - len(frames)
    results = {
        ODOMETRY_ONLY: _of_batch(batch, len(depth), rejected),
        THESIS: _of_thesis(thesis, len(depth), rejected),
        **more,
        OURS: ours,
    }
    return Runs(batch, thesis, ours, results, wall)


def preprocess(depth: Iterable[DepthFrame], settings: ThesisSettings) -> list[TargetFrame]:
    """Target frames of the depth frames in which a target shows."""
    stage = Preprocessor(settings.isolation, NormalSettings())
    frames = []
    for frame in depth:
        try:
            frames.append(stage.process(frame))
        except FrameRejected:
            continue
    return frames


def _ours(depth: list[DepthFrame], progress: Progress) -> ScanResult:
    scanner = Scanner()
    for k, frame in enumerate(depth):
        scanner.process(frame)
        progress(0.75 + 0.15 * (k + 1) / len(depth), 'our scan')
    return scanner.finish()


def _of_batch(batch: OdometryModel, read: int, rejected: int) -> ScanResult:
    """Nothing is ever closed, and a model always comes of it."""
    reason = None if batch.model is not None else 'inconsistent_model'
    sigma = batch.batch.covariance.diagonal()[4:] ** 0.5
    return ScanResult(
        reason,
        batch.model,
        poses=batch.poses,
        odometry=batch.poses,
        rates=[RateSample(s, batch.batch.state[4:], sigma, True) for s in batch.batch.stamps],
        keyframe_poses=_kept(batch.odometry, batch.poses),
        frames_read=read,
        frames_rejected={'no_target': rejected} if rejected else {},
    )


def _of_thesis(thesis: ThesisResult, read: int, rejected: int) -> ScanResult:
    motion = thesis.odometry
    assert motion is not None
    return ScanResult(
        thesis.reason,
        thesis.model,
        poses=thesis.poses if thesis.model is not None else thesis.odometry_poses,
        odometry=thesis.odometry_poses,
        rates=motion.rates,
        # all frames that were compared, so that recall asks of those that pruning took away too
        keyframe_poses=_kept(motion, thesis.odometry_poses),
        closures=thesis.closures,
        frames_read=read,
        frames_rejected={'no_target': rejected} if rejected else {},
        timing=thesis.timing,
    )


def _kept(motion: Odometry, poses: list[StampedPose]) -> list[StampedPose]:
    kept = {motion.clouds[k].stamp_ns for k in motion.kept}
    return [replace(p) for p in poses if p.stamp_ns in kept]


def _share(progress: Progress, low: float, high: float) -> odometry.Progress:
    """Progress of a step that is a part of the whole."""
    return lambda what, done, total: progress(low + (high - low) * done / max(total, 1), what)
