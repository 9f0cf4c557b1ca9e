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

A mean error is worse than a spread: the spread averages out over a turn, the mean adds up to drift.

python benchmarks/registration_bias.py [TARGET ...] [--pairs 50] [--no-noise]
"""

import argparse

import numpy as np
from tqdm import tqdm

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import apply, compose, inverse, log_so3
from debris_scanner.registration.projective import register
from debris_scanner.sensing.views import View
from debris_scanner.settings import Settings
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.stages import make_preprocessor

STEP = 2  # frames between the views of a pair: 5.7 degrees at 0.5 rad/s and 10 Hz


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('targets', nargs='*', default=['shuttle_stack', 'asteroid', 'upper_stage', 'prism'])
    parser.add_argument('--pairs', type=int, default=50)
    parser.add_argument('--no-noise', action='store_true')
    args = parser.parse_args()
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
