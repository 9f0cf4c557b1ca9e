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

"""Picture of a scan for the README: one input frame, then the model from four sides.

python docs/draw_scan.py OUT_DIR PICTURE.png [--simulate TARGET]
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from debris_scanner.report.model_picture import BACKGROUND, SIDES, SIZE, draw_side
from debris_scanner.sim.session import Simulation, SimulationSettings

INK = (70, 74, 84)


def depth_panel(target: str) -> NDArray[np.uint8]:
    """First simulated depth frame, near bright and far dark, cut to the target."""
    depth = Simulation(SimulationSettings(target=target)).frame(0).depth_mm.astype(float)
    v, u = np.nonzero(depth)
    half = max(np.ptp(v), np.ptp(u)) // 2 + 12
    cv, cu = (v.max() + v.min()) // 2, (u.max() + u.min()) // 2
    window = np.pad(depth, half)[cv : cv + 2 * half, cu : cu + 2 * half]
    near, far = np.percentile(window[window > 0], [1, 99])
    grey = 235 - 190 * np.clip((window - near) / (far - near), 0, 1)
    image = np.where(window[..., None] > 0, grey[..., None] * np.array([0.75, 0.9, 1.0]), [24, 26, 34])
    return np.asarray(Image.fromarray(image.astype(np.uint8)).resize((SIZE, SIZE), Image.Resampling.NEAREST))


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scan', type=Path)
    parser.add_argument('picture', type=Path)
    parser.add_argument('--simulate', default='shuttle_stack')
    args = parser.parse_args()
    panels = [depth_panel(args.simulate), *(draw_side(args.scan / 'mesh.ply', *side) for side in SIDES)]
    captions = ['one of the depth frames', 'the mesh', 'turned', 'and turned again']
    sheet = Image.new('RGB', (SIZE * len(panels), SIZE + 34), tuple(BACKGROUND))
    draw = ImageDraw.Draw(sheet)
    for k, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        sheet.paste(Image.fromarray(panel), (k * SIZE, 0))
        draw.text((k * SIZE + 12, SIZE + 8), caption, fill=INK, font_size=16)
    sheet.save(args.picture, optimize=True)


if __name__ == '__main__':
    main()
