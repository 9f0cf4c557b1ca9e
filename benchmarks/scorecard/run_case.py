"""One case: simulate, scan and evaluate, in memory but for the files that ``evaluate`` reads.

The same as ``debris-scan simulate``, ``scan`` and ``evaluate`` without the bag in between: depth travels in
whole millimetres there and here.
"""

import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scorecard.cases import Case
from benchmarks.scorecard.recordings import Recording, open_recording
from debris_scanner.camera import Camera
from debris_scanner.evaluation import evaluate
from debris_scanner.frames import DepthFrame
from debris_scanner.geometry import Array
from debris_scanner.result_files import summary, write_results
from debris_scanner.results import ScanResult, StampedPose
from debris_scanner.scanner import Scanner, Step
from debris_scanner.trajectory_files import write_tum

Progress = Callable[[int], None]  # frames done


@dataclass
class Frames:
    """The depth frames of a recording, kept small for the second look that ``evaluate`` takes."""

    camera: Camera
    stamps_ns: list[int] = field(default_factory=list)
    truth: list[Array] = field(default_factory=list)  # T_sensor_target (4, 4)
    _packed: list[bytes] = field(default_factory=list)

    def add(self, frame: DepthFrame, T_sensor_target: Array) -> None:
        """Keep one frame with its true pose."""
        self.stamps_ns.append(frame.stamp_ns)
        self.truth.append(T_sensor_target)
        self._packed.append(zlib.compress(np.rint(frame.depth * 1000).astype(np.uint16).tobytes(), 1))

    def __iter__(self) -> Iterator[DepthFrame]:
        """All frames in order."""
        shape = (self.camera.height, self.camera.width)
        for stamp, packed in zip(self.stamps_ns, self._packed, strict=True):
            depth = np.frombuffer(zlib.decompress(packed), np.uint16).reshape(shape)
            yield DepthFrame(stamp, depth * np.float32(0.001), self.camera)


def run_case(case: Case, bound: bool = False, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Figures of one case, ready for JSON.

    Args:
        case: what to scan.
        bound: also fuse the frames at their true poses, to see what the sensor leaves possible.
        progress: told the number of frames done.
    """
    wall, cpu = time.perf_counter(), time.process_time()
    recording = open_recording(case)
    scanner = Scanner()
    frames, steps = Frames(recording.camera), []
    for frame, T_sensor_target in recording.frames():
        step = scanner.process(frame)
        steps.append(_lean(step))
        frames.add(frame, T_sensor_target)
        progress(len(steps))
    result = scanner.finish()
    scanned = time.perf_counter() - wall
    record: dict[str, Any] = {
        'scan': _scan_figures(result, scanner),
        'metrics': judge(result, frames, recording, scanned),
    }
    record['cost'] = {
        'wall_s': round(time.perf_counter() - wall, 2),
        'scan_s': round(scanned, 2),
        'cpu_s': round(time.process_time() - cpu, 2),
    }
    return record


def judge(result: ScanResult, frames: Frames, recording: Recording, wall_s: float) -> dict[str, Any]:
    """What ``evaluate`` says of a result."""
    with tempfile.TemporaryDirectory(prefix='scorecard-') as name:
        folder = Path(name)
        write_results(folder, result, wall_s)
        poses = [StampedPose(s, T) for s, T in zip(frames.stamps_ns, frames.truth, strict=True)]
        write_tum(folder / 'truth.tum', poses)
        recording.write_surface(folder)
        return evaluate(folder, folder, frames)


def _lean(step: Step) -> Step:
    """The step without its images."""
    return Step(step.rejected, None, step.estimate, (), None)


def _scan_figures(result: ScanResult, scanner: Scanner) -> dict[str, Any]:
    """What summary.json says, the long lists aside, and the judge's numbers in words."""
    said = summary(result, 0.0)
    last = scanner.builder.last
    accepted = [c for c in result.closures if c.accepted]
    first_ns = accepted[0].to_stamp_ns if accepted else None
    return {
        'result': said['result'],
        'reason': result.reason,
        'why': last.why if last is not None else '',
        'frames': said['frames'],
        'keyframes': said['keyframes'],
        'closures': {'tried': len(result.closures), 'accepted': len(accepted), 'first_ns': first_ns},
        'symmetry': result.symmetry,
        'model': said['model'],
        'timing': result.timing,
    }
