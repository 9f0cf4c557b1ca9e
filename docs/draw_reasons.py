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

"""Frames of scans that end without a model, three for each reason: docs/no_model.png.

python docs/draw_reasons.py docs/no_model.png
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from debris_scanner.sim.session import Simulation, SimulationSettings

SIZE, CAPTION, GAP = 150, 24, 12  # pixels: one frame, the line of text above, between columns
BACKGROUND, INK = (250, 250, 252), (70, 74, 84)
NEAR, FAR = 0.5, 1.3  # m: bright and dark
HALF = 160  # pixels of the sensor, cut out around its middle
STACK, TANK, CUBESAT, PRISM, CYLINDER = (
    {'target': name} for name in ('shuttle_stack', 'tank_boosters', 'cubesat', 'prism', 'cylinder')
)
# Reason and words, and the three frames that are shown: what is simulated, and the time in it, s.
Shown = tuple[tuple[dict[str, object], float], ...]
PICTURES: tuple[tuple[str, Shown], ...] = (
    ('no_target: nothing stands before the sensor', (({'target': 'empty'}, 0.0),) * 3),
    ('inconsistent_model: one side taken for another', ((CUBESAT, 0.0), (CUBESAT, 3.1), (CUBESAT, 6.3))),
    ('no_closure: a quarter of a turn was shown', ((STACK, 0.0), (STACK, 1.5), (STACK, 3.0))),
    ('not_rigid: a part was taken off', ((STACK, 0.0), (STACK, 1.5), (TANK, 3.0))),
    ('too_few_frames: 115 degrees from frame to frame', ((STACK, 0.0), (STACK, 4.0), (STACK, 8.0))),
    ('no_match: the model is a cubesat (left)', ((CUBESAT, 0.0), (STACK, 0.0), (STACK, 1.5))),
    ('unobservable_rotation: all views are the same', ((CYLINDER, 0.0), (CYLINDER, 1.5), (CYLINDER, 3.0))),
    ('ambiguous: which side is it, of six?', ((PRISM, 0.0), (PRISM, 2.1), (PRISM, 4.2))),
)


def panel(depth_mm: NDArray[np.uint16]) -> Image.Image:
    """The middle of a depth image, near bright and far dark."""
    v, u = (n // 2 for n in depth_mm.shape)
    window = depth_mm[v - HALF : v + HALF, u - HALF : u + HALF] / 1000
    grey = 235 - 190 * np.clip((window - NEAR) / (FAR - NEAR), 0, 1)
    image = np.where(window[..., None] > 0, grey[..., None] * np.array([0.75, 0.9, 1.0]), [24, 26, 34])
    return Image.fromarray(image.astype(np.uint8)).resize((SIZE, SIZE), Image.Resampling.NEAREST)


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('picture', type=Path)
    args = parser.parse_args()
    columns, rows = 2, len(PICTURES) // 2
    wide, high = 3 * SIZE + GAP, SIZE + CAPTION
    sheet = Image.new('RGB', (columns * wide - GAP, rows * high), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for k, (words, shown) in enumerate(PICTURES):
        left, top = k % columns * wide, k // columns * high
        draw.text((left + 6, top + 4), words, fill=INK, font_size=14)
        for column, (settings, seconds) in enumerate(shown):
            simulation = Simulation(SimulationSettings(**settings))
            frame = simulation.frame(round(seconds * simulation.settings.rate_hz))
            sheet.paste(panel(frame.depth_mm), (left + column * SIZE, top + CAPTION))
    sheet.save(args.picture, optimize=True)


if __name__ == '__main__':
    main()
