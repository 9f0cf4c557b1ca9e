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

"""One case: simulate, scan and evaluate, in memory but for the files that ``evaluate`` reads.

The same as ``debris-scan simulate``, ``scan`` and ``evaluate`` without the bag in between: depth travels in
whole millimetres there and here.
"""

import tempfile
import time
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.forecast_errors import forecast_figures
from benchmarks.scorecard.bound import true_pose_attitude, true_pose_result
from benchmarks.scorecard.cases import BOUND, SIMILARITY, Case
from benchmarks.scorecard.recordings import Recording, SimulatedRecording, open_recording
from benchmarks.scorecard.similarity import SimilarityRun
from benchmarks.scorecard.tracking import Tracked, tracking_figures
from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, FrameRejected
from debris_scanner.core.geometry import Array, log_so3
from debris_scanner.core.results import StampedPose
from debris_scanner.evaluation.metrics import evaluate
from debris_scanner.evaluation.trajectory_errors import Poses, align, by_stamp, pose_errors
from debris_scanner.io.result_files import ScanResult, summary, write_results
from debris_scanner.io.trajectories import write_tum
from debris_scanner.scanner import Scanner, Step
from debris_scanner.settings import Settings
from debris_scanner.stages import make_preprocessor

Progress = Callable[[int], None]  # frames done


@dataclass
class Frames:
    """The depth frames of a recording, kept small for the second look that ``evaluate`` takes."""

    stamps_ns: list[int] = field(default_factory=list)
    truth: list[Array] = field(default_factory=list)  # T_sensor_target (4, 4); empty where none is known
    _packed: list[tuple[Camera, bytes]] = field(default_factory=list)

    def add(self, frame: DepthFrame, T_sensor_target: Array | None) -> None:
        """Keep one frame with its true pose, if that is known."""
        self.stamps_ns.append(frame.stamp_ns)
        if T_sensor_target is not None:
            self.truth.append(T_sensor_target)
        self._packed.append((frame.camera, zlib.compress(frame.depth.astype(np.float32).tobytes(), 1)))

    @property
    def poses(self) -> dict[int, Array]:
        """True T_sensor_target (4, 4) by stamp; empty where none is known."""
        return dict(zip(self.stamps_ns, self.truth, strict=True)) if self.truth else {}

    def __iter__(self) -> Iterator[DepthFrame]:
        """All frames in order."""
        for stamp, (camera, packed) in zip(self.stamps_ns, self._packed, strict=True):
            depth = np.frombuffer(zlib.decompress(packed), np.float32)
            yield DepthFrame(stamp, depth.reshape(camera.height, camera.width), camera)


def run_case(
    case: Case,
    extras: Collection[str] = (),
    progress: Progress = lambda _: None,
    settings: Settings | None = None,
) -> dict[str, Any]:
    """Figures of one case, ready for JSON.

    Args:
        case: what to scan.
        extras: of ``cases.EXTRAS``, what to find out besides.
        progress: told the number of frames done.
        settings: of the scanner; None for the defaults.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    recording = open_recording(case)
    settings = settings or Settings()
    scanner = Scanner(settings)
    frames, tracked = Frames(), list[Tracked]()
    for frame, T_sensor_target in recording.frames():
        has_model = scanner.front_end.odometry.model is not None
        step = scanner.process(frame)
        frames.add(frame, T_sensor_target)
        if has_model:
            tracked.append(_tracked(frame.stamp_ns, scanner.state, step))
        progress(len(frames.stamps_ns))
    result = scanner.finish()
    cost = {
        'scan_s': round(time.perf_counter() - wall, 2),  # rendering included
        'cpu_s': round(time.process_time() - cpu, 2),
    }
    truth = frames.poses
    record: dict[str, Any] = {
        'scan': _scan_figures(result, scanner),
        'keyframe_error': _keyframe_error(result, truth, recording),
        'metrics': judge(result, frames, recording) if truth else None,
        'turned': turned(by_stamp(result.odometry), truth),
        'tracking': tracking_figures(tracked, truth, recording.visibility),
        'forecast': forecast_figures(result, truth, recording)
        if isinstance(recording, SimulatedRecording)
        else None,
        'cost': cost,
        'extras': sorted(extras),
    }
    if extras and truth:
        record |= _extra_figures(extras, frames, recording, settings)
    cost['wall_s'] = round(time.perf_counter() - wall, 2)
    return record


def turned(odometry: Poses, truth: Poses) -> dict[str, float | None]:
    """How far odometry alone turned the target, and how far it did between the same frames, degrees.

    Sums of the steps as vectors in the sensor's frame: the whole turn of a spin, whatever each step's noise.
    """
    stamps = sorted(odometry)

    def total(poses: Poses) -> float:
        steps = [log_so3(poses[b][:3, :3] @ poses[a][:3, :3].T) for a, b in pairwise(stamps)]
        return round(float(np.degrees(np.linalg.norm(np.sum(steps, axis=0)))), 3) if steps else 0.0

    return {'deg': total(odometry), 'true_deg': total(truth) if truth else None}


def _keyframe_error(
    result: ScanResult, truth: dict[int, Array], recording: Recording
) -> dict[str, float] | None:
    """Largest errors of a refused scan's optimised key frames; None if there is a model or no key frame."""
    poses = by_stamp(result.keyframe_poses)
    if not poses or not truth or result.reason is None:
        return None
    attitude, position = pose_errors(truth, poses, align(truth, poses))
    return {
        'attitude_deg': round(float(np.degrees(attitude.max())), 3),
        'position_share': round(float(position.max() / recording.size_m()), 5),
    }


def _extra_figures(
    extras: Collection[str], frames: Frames, recording: Recording, settings: Settings
) -> dict[str, Any]:
    """The bound and the similarities, from the same targets isolated anew."""
    preprocessor = make_preprocessor(settings)
    similarity = SimilarityRun(settings)
    fused = min(len(frames.truth), settings.fusion.max_frames)
    wanted = set(np.linspace(0, len(frames.truth) - 1, fused).astype(int))
    posed = []
    for k, (frame, T) in enumerate(zip(frames, frames.truth, strict=True)):
        try:
            target = preprocessor.process(frame)
        except FrameRejected:
            continue
        if BOUND in extras and k in wanted:
            posed.append((target, T))
        if SIMILARITY in extras:
            similarity.add(target)
    figures: dict[str, Any] = {}
    if BOUND in extras:
        ideal = true_pose_result(posed, settings)
        metrics = judge(ideal, frames, recording)
        figures[BOUND] = {k: metrics[k] for k in ('model_mm', 'mesh_mm', 'completeness')}
        figures[BOUND]['attitude_deg'] = true_pose_attitude(ideal, posed)
    if SIMILARITY in extras:
        figures[SIMILARITY] = similarity.areas(frames.poses)
    return figures


def judge(result: ScanResult, frames: Frames, recording: Recording) -> dict[str, Any]:
    """What ``evaluate`` says of a result."""
    with tempfile.TemporaryDirectory(prefix='scorecard-') as name:
        folder = Path(name)
        write_results(folder, result, 0.0)
        poses = [StampedPose(s, T) for s, T in zip(frames.stamps_ns, frames.truth, strict=True)]
        write_tum(folder / 'truth.tum', poses)
        recording.write_surface(folder)
        return evaluate(folder, folder, frames)


def _tracked(stamp_ns: int, state: str, step: Step) -> Tracked:
    accepted = step.estimate is not None and step.estimate.accepted
    return Tracked(stamp_ns, state, step.estimate.T_sensor_target if accepted and step.estimate else None)


def _scan_figures(result: ScanResult, scanner: Scanner) -> dict[str, Any]:
    """What summary.json says, the long lists aside, and the judge's numbers in words."""
    said = summary(result, 0.0)
    last = scanner.back_end.builder.last
    accepted = [c for c in result.closures if c.accepted]
    first_ns = accepted[0].to_stamp_ns if accepted else None
    return {
        'result': said['result'],
        'reason': result.reason,
        'why': last.why if last is not None else '',
        'hint': result.hint or '',
        'frames': said['frames'],
        'keyframes': said['keyframes'],
        'closures': {'tried': len(result.closures), 'accepted': len(accepted), 'first_ns': first_ns},
        'symmetry': result.symmetry,
        'model': said['model'],
        'timing': result.timing,
    }
