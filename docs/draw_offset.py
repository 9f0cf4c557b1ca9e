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

"""What a simulated sensor does to its images, and what a scan before it finds of that.

python docs/draw_offset.py docs/offset.png
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.scanner import Scanner
from debris_scanner.settings import Settings
from debris_scanner.sim.modelled_sensor import ModelledSensor
from debris_scanner.sim.sensors import find_sensor
from debris_scanner.sim.session import Simulation, SimulationSettings

SENSOR = 'flexx'
SIMULATION = SimulationSettings(target='prism', motion='tumble', sensor=SENSOR, seconds=60.0)
LARGEST = 0.8  # per cent of the depth


def main() -> None:
    """Scan, and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('picture', type=Path)
    args = parser.parse_args()
    scanner, simulation = Scanner(Settings()), Simulation(SIMULATION)
    camera: Camera | None = None
    seen: NDArray[np.float64] | None = None
    for f in simulation:
        scanner.process(DepthFrame(f.stamp_ns, f.depth, f.camera))
        camera = f.camera
        near = (f.depth > 0).astype(float)
        seen = near if seen is None else seen + near
    scanner.finish()
    assert camera is not None
    assert seen is not None
    put_in = ModelledSensor(find_sensor(SENSOR), simulation.target, SIMULATION.seed).offset
    found = scanner.back_end.builder.graph.keyframes.views.offset.share(camera)
    shown = seen > 0.02 * seen.max()
    put_in = put_in - put_in[shown].mean()  # an equal share everywhere does not show
    images = {'put in': put_in, 'found': found, 'left': put_in - found}
    figure, panels = plt.subplots(1, 3, figsize=(9.0, 2.7), layout='constrained')
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    for axes, (name, image) in zip(panels, images.items(), strict=True):
        drawn = axes.imshow(np.where(shown, 100 * image, np.nan), cmap='RdBu_r', vmin=-LARGEST, vmax=LARGEST)
        axes.set(xlim=columns[[0, -1]], ylim=rows[[-1, 0]], xticks=[], yticks=[])
        axes.set_title(f'{name}: {100 * image[shown].std():.2f} %', fontsize=10)
    figure.colorbar(drawn, ax=panels, label='% of the depth', shrink=0.9)
    figure.savefig(args.picture, dpi=110)


if __name__ == '__main__':
    main()
