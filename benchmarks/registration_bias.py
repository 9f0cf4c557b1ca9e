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

"""Bias of the pairwise registration: its mean error over many pairs, started at the truth.

A mean error is worse than a spread: the spread averages out over a turn, the mean adds up to drift. Of a real
recording with a truth, the share of the true turn is shown that pairs near and far apart come out with.

python -m benchmarks.registration_bias [TARGET ...] [--pairs 50] [--no-noise]
python -m benchmarks.registration_bias --real tiger superman berrybox [--relief 0.8]
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from benchmarks.real_recordings import REAL
from debris_scanner.core.frames import DepthFrame, TargetFrame
from debris_scanner.core.geometry import Array, apply, compose, inverse, log_so3
from debris_scanner.registration.projective import register
from debris_scanner.sensing.depth_offset import NO_OFFSET
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

STEP = 2  # frames between the views of a pair: 5.7 degrees at 0.5 rad/s and 10 Hz
APART = (1, 3, 6)  # frames of a real recording between the views of a pair


def errors(target: str, pairs: int, noise: bool) -> np.ndarray:
    """Error twists (pairs, 6) in the sensor frame about the target: degrees, then millimetres."""
    settings = SimulationSettings(target=target, noise=noise, seconds=(2 * pairs + STEP + 1) / 10)
    preprocessor = make_preprocessor(Settings())
    views, poses = [], []
    for f in Simulation(settings):
        depth = f.depth_mm.astype(np.float32) / np.float32(1000)
        views.append(View(preprocessor.process(DepthFrame(f.stamp_ns, depth, f.camera))))
        poses.append(f.T_sensor_target)
    rows = []
    for k in tqdm(range(0, 2 * pairs, 2), desc=target, leave=False):
        i, j = k + STEP, k
        found = register(views[i], inverse(poses[i]), views[j], inverse(poses[j]))
        if found is None:
            continue
        error = compose(poses[i], found[0])
        centre = poses[i][:3, 3]
        shift = (apply(error, centre) - centre) * 1e3
        rows.append(np.concatenate([np.degrees(log_so3(error[:3, :3])), shift]))
    return np.array(rows)


def deepened(frame: TargetFrame, relief: float) -> View:
    """A view whose depths differ from their median by 1 / relief times as much as they were measured."""
    depth = frame.measured.copy()
    seen = depth > 0
    median = np.median(depth[seen])
    depth[seen] = median + (depth[seen] - median) / relief
    return View(NO_OFFSET.target_frame(frame.stamp_ns, frame.camera, depth, Settings().normals))


def shares(
    recording: Iterable[tuple[DepthFrame, Array | None]], relief: float
) -> list[tuple[float, float, float]]:
    """Of pairs :data:`APART`: mean true turn, deg, mean share of it that is found, and its deviation."""
    preprocessor = make_preprocessor(Settings())
    posed = [
        (deepened(target, relief), inverse(T))
        for frame, T in recording
        if T is not None and (target := preprocessor.process(frame)) is not None
    ]
    rows = []
    for apart in APART:
        found = list[tuple[float, float]]()
        for (a, T_a), (b, T_b) in zip(posed, posed[apart:], strict=False):
            registered = register(b, T_b, a, T_a)
            if registered is not None:
                turn = log_so3(T_a[:3, :3].T @ T_b[:3, :3])
                come_out = log_so3(T_a[:3, :3].T @ registered[0][:3, :3])
                found.append((float(np.linalg.norm(turn)), float(come_out @ turn / (turn @ turn))))
        if not found:  # so far apart, they show no common side
            continue
        turns, share = np.array(found).T
        deviation = float(share.std() / np.sqrt(len(share)))
        rows.append((float(np.degrees(turns.mean())), float(share.mean()), deviation))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('targets', nargs='*', default=['shuttle_stack', 'asteroid', 'upper_stage', 'prism'])
    parser.add_argument('--pairs', type=int, default=50)
    parser.add_argument('--no-noise', action='store_true')
    parser.add_argument('--real', action='store_true', help='the targets are real recordings with a truth')
    parser.add_argument(
        '--relief', type=float, default=1.0, help='share of the true relief that was measured'
    )
    parser.add_argument('--data', type=Path, default=Path('../shared/data'), help='folder of the recordings')
    args = parser.parse_args()
    if args.real:
        for name in args.targets:
            recording = REAL[name]
            rows = shares(recording.read(args.data / recording.path), args.relief)
            print(f'{name:16s}', '   '.join(f'of {t:4.1f} deg: {s:.3f} +- {d:.3f}' for t, s, d in rows))
        return
    print('target             turn about the vertical, deg    sideways, mm')
    print('                   mean      spread                mean      spread')
    for target in args.targets:
        e = errors(target, args.pairs, not args.no_noise)
        print(
            f'{target:18s} {e[:, 1].mean():+.3f}    {e[:, 1].std():.3f}                 '
            f'{e[:, 3].mean():+.3f}    {e[:, 3].std():.3f}'
        )


if __name__ == '__main__':
    main()
