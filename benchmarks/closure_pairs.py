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

"""``python -m benchmarks.closure_pairs``: are wrong closures refused, and right ones believed?

Each scan is followed by the front end, and its key frames are paired by the truth. A right pair shows one
face a turn apart, a wrong one two faces that look alike (of a prism, a box, a cube). Both are registered from
where they look alike, and their correction is from there to where odometry put the key frame.
A sensor that shows less relief than there is (``RELIEF``) has odometry drift, as a Kinect v2 does with toys.
"""

import argparse
import csv
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from benchmarks.real_recordings import REAL
from benchmarks.scorecard.tables import markdown
from benchmarks.scorecard.targets import data_folder
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    exp_so3,
    inverse,
    rotation_angle,
    transform,
)
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import ClosureDetector
from debris_scanner.scanner import FrontEnd
from debris_scanner.settings import Settings
from debris_scanner.sim.sensors import SENSORS, find_sensor
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import Target, make_target

FOLDS = {'hexagon': 6, 'octagon': 8, 'box': 4, 'cube': 4}  # faces about the axis of the spin that look alike
UNLIKE = ('shuttle_stack', 'asteroid')
RELIEF = (1.0, 0.85)  # of the depth's differences within an image, this share is shown
TURNS, SPIN_RAD_S = 1.6, 0.5
NEAR_DEG = 10.0  # between the directions from which a pair looks
SAME_DEG, SAME_SHARE = 2.0, 0.02  # a right closure's error at most: of attitude, and of the target's extent
FLAT_DEG = 0.25  # more, for each degree between the directions: flattened views turn by less
MOST = 4  # pairs of a kind in a scan


@dataclass(frozen=True)
class Pair:
    """A pair of key frames that was put to the checks."""

    scan: str
    right: bool  # it shows one face, and registration found so
    believed: bool
    drift: float  # of odometry between the two, share of the turn
    asked: float  # of a step, nats a point
    may_ask: float
    nearer: bool  # to where odometry put it than the right one is: nothing that a step says can tell it
    off_deg: float  # the closure's error
    shifted: float  # likewise of the target's centre, share of its extent


def shape(name: str, size: float) -> Target:
    """A prism of equal faces about its z axis, or a target of the simulator."""
    if name in UNLIKE:
        return make_target(name, size)
    if name in ('hexagon', 'octagon'):
        mesh = trimesh.creation.cylinder(0.45, 1.0, sections=FOLDS[name])
    else:
        mesh = trimesh.creation.box((0.6, 0.6, 1.0) if name == 'box' else (0.6, 0.6, 0.6))
    vertices = mesh.vertices * (size / np.ptp(mesh.vertices, axis=0).max())
    return Target(name, vertices.astype(np.float32), np.asarray(mesh.faces, np.int32))


def flattened(depth: NDArray[np.float32], relief: float) -> NDArray[np.float32]:
    """An image whose depths are so many times as far from their median."""
    seen = depth > 0
    if relief == 1.0 or not seen.any():
        return depth
    median = np.median(depth[seen])
    return np.where(seen, median + np.float32(relief) * (depth - median), np.float32(0)).astype(np.float32)


def simulated(name: str, sensor: str, relief: float) -> Iterator[tuple[DepthFrame, Array]]:
    """Frames of a spin with their true poses (4, 4) of the sensor in the target's frame."""
    settings = SimulationSettings(
        sensor=sensor, spin_rad_s=SPIN_RAD_S, seconds=TURNS * 2 * np.pi / SPIN_RAD_S, seed=len(name)
    )
    for f in Simulation(settings, shape(name, find_sensor(sensor).size_m or 0.3)):
        yield DepthFrame(f.stamp_ns, flattened(f.depth, relief), f.camera), inverse(f.T_sensor_target)


def recorded(name: str) -> Iterator[tuple[DepthFrame, Array]]:
    """Frames of a real recording with the poses of its truth."""
    real = REAL[name]
    for frame, T in real.read(data_folder() / real.path):
        assert T is not None
        yield frame, T


def followed(frames: Iterator[tuple[DepthFrame, Array]]) -> tuple[ClosureDetector, list[Array]]:
    """What the front end makes of a recording: its key frames, and their true poses."""
    front, truth = FrontEnd(Settings(), StageTimer()), dict[int, Array]()
    for frame, T in frames:
        truth[frame.stamp_ns] = T
        front.process(frame)
    return front.detector, [truth[f.stamp_ns] for f in front.detector.keyframes.frames]


def directions(poses: list[Array], centre: Array) -> Array:
    """Unit vectors (n, 3) from the target's centre to the sensor."""
    rays = np.array([T[:3, 3] for T in poses]) - centre
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def judged(scan: str, frames: Iterator[tuple[DepthFrame, Array]], folds: int = 1) -> list[Pair]:
    """All pairs of a recording that show one face, and those of faces that look alike."""
    detector, truth = followed(frames)
    keyframes = detector.keyframes
    if len(truth) < 3:
        return []
    seen = [apply(T, keyframes.views[k].points) for k, T in enumerate(truth)]
    points = np.concatenate(seen)
    centre, extent = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    found: list[Pair] = []
    for m in range(folds):
        R = exp_so3(np.array([0.0, 0.0, 2 * np.pi * m / folds]))
        turn = transform(R, centre - R @ centre)
        turned = [compose(turn, T) for T in truth]
        cosines = directions(turned, centre) @ directions(truth, centre).T
        near = np.argwhere(cosines >= np.cos(np.radians(NEAR_DEG))).tolist()
        pairs = [(k, j) for j, k in near if k < j and may_close(detector, k, j)]
        for n in np.unique(np.linspace(0, len(pairs) - 1, min(MOST, len(pairs))).astype(int)):
            k, j = pairs[n]
            pair = tried(scan, detector, truth, k, j, turned[j] if m else None, (centre, extent))
            found += [] if pair is None else [pair]
    return found


def may_close(detector: ClosureDetector, k: int, j: int) -> bool:
    """Whether two key frames are of one submap, and far enough apart for a closure."""
    earlier, later = (detector.keyframes.frames[n] for n in (k, j))
    return earlier.submap == later.submap and later.path_rad - earlier.path_rad >= detector.search.min_path


def tried(
    scan: str,
    detector: ClosureDetector,
    truth: list[Array],
    k: int,
    j: int,
    turned: Array | None,
    target: tuple[Array, float],
) -> Pair | None:
    """Put key frames k and j to the checks; None where it fails, or a wrong start finds the right place.

    Args:
        scan: its name.
        detector: with the key frames.
        truth: their true poses (4, 4).
        k: the earlier one.
        j: the later one.
        turned: its pose (4, 4) by the truth, turned to a face that looks alike; None: as it is.
        target: its centre (3,) and extent, m.
    """
    frames = detector.keyframes.frames
    now, path = frames[j].T_target_sensor, frames[j].path_rad - frames[k].path_rad
    T_scan_truth = compose(frames[k].T_target_sensor, inverse(truth[k]))
    true = compose(T_scan_truth, truth[j])
    outcome = detector.verify(k, j, true if turned is None else compose(T_scan_truth, turned))
    found = outcome.T_target_view
    if found is None:
        return None
    centre, extent = apply(T_scan_truth, target[0][None]), target[1]
    error = compose(found, inverse(true))
    shifted = float(np.linalg.norm(apply(error, centre) - centre)) / extent
    off_deg = float(np.degrees(rotation_angle(error[:3, :3])))
    apart_deg = np.degrees(np.arccos(np.clip(truth[k][:3, 2] @ truth[j][:3, 2], -1, 1)))
    right = bool(off_deg <= SAME_DEG + FLAT_DEG * apart_deg and shifted <= SAME_SHARE)
    if right and turned is not None:
        return None
    found_off, true_off = (rotation_angle(compose(inverse(T), now)[:3, :3]) for T in (found, true))
    asked = next((c for c in outcome.checks if c.name == 'asked_of_a_step'), None)
    values = (np.nan, np.nan) if asked is None or asked.bound is None else (asked.value, asked.bound)
    nearer = bool(found_off < true_off)
    return Pair(scan, right, outcome.accepted, float(true_off / path), *values, nearer, off_deg, shifted)


def work(case: tuple[str, str, float]) -> list[Pair]:
    """A scan's pairs."""
    name, sensor, relief = case
    if sensor == 'real':
        return judged(f'{name}, real', recorded(name))
    return judged(f'{name}, {sensor}, {relief}', simulated(name, sensor, relief), FOLDS.get(name, 1))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--sensors', default=','.join(SENSORS))
    parser.add_argument('--jobs', type=int, default=2)
    parser.add_argument('--out', type=Path, help='all pairs, as CSV')
    args = parser.parse_args()
    cases = [
        (name, sensor, relief)
        for sensor in args.sensors.split(',')
        for name in (*FOLDS, *UNLIKE)
        for relief in RELIEF
    ] + [(name, 'real', 1.0) for name in ('bunny', 'dragon_stand')]
    pairs: list[Pair] = []
    with ProcessPoolExecutor(args.jobs) as pool:
        for case, found in zip(cases, pool.map(work, cases), strict=True):
            pairs += found
            wrong = sum(p.believed and not p.right for p in found)
            refused = sum(p.right and not p.believed for p in found)
            print(*case, f'{len(found)} pairs, {wrong} wrong believed, {refused} right refused', flush=True)
    rows = []
    for low, high in ((0.0, 0.02), (0.02, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 9.0)):
        here = [p for p in pairs if low <= p.drift < high]
        kinds = (
            [p for p in here if p.right],
            [p for p in here if not p.right and not p.nearer],
            [p for p in here if not p.right and p.nearer],
        )
        cells = [f'{sum(p.believed for p in kind)} of {len(kind)}' for kind in kinds]
        rows.append([f'{low:.0%} to {high:.0%}', *cells])
    header = ['drift', 'right, believed', 'wrong, believed', 'wrong and nearer than the right one']
    print(markdown(header, rows))
    if args.out is not None:
        with args.out.open('w', newline='') as file:
            writer = csv.DictWriter(file, [f.name for f in fields(Pair)])
            writer.writeheader()
            writer.writerows(asdict(p) for p in pairs)


if __name__ == '__main__':
    main()
