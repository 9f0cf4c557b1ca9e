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

"""Frames of scans that end without a model, a row for each reason: docs/no_model.png.

python docs/draw_reasons.py docs/no_model.png
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from debris_scanner.sim.session import Simulation, SimulationSettings

SIZE, CAPTION = 170, 24  # pixels: one frame, and the line of text above a row
BACKGROUND, INK = (250, 250, 252), (70, 74, 84)
NEAR, FAR = 0.5, 1.3  # m: bright and dark
HALF = 160  # pixels of the sensor, cut out around its middle
# Reason and words, what is simulated, and the times of the frames that are shown, s.
ROWS = (
    ('no_target: nothing stands before the sensor', {'target': 'empty'}, (0, 1, 2)),
    ('no_closure: a quarter of a turn was shown', {'target': 'shuttle_stack'}, (0, 1.5, 3)),
    ('too_few_frames: 115 degrees from frame to frame', {'spin_rad_s': 2.0}, (0, 1, 2)),
    ('unobservable_rotation: each view is the same', {'target': 'cylinder'}, (0, 1.5, 3)),
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
    sheet = Image.new('RGB', (3 * SIZE, len(ROWS) * (SIZE + CAPTION)), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for row, (words, settings, times) in enumerate(ROWS):
        simulation = Simulation(SimulationSettings(**settings))
        top = row * (SIZE + CAPTION)
        draw.text((6, top + 4), words, fill=INK, font_size=14)
        for column, seconds in enumerate(times):
            frame = simulation.frame(round(seconds * simulation.settings.rate_hz))
            sheet.paste(panel(frame.depth_mm), (column * SIZE, top + CAPTION))
    sheet.save(args.picture, optimize=True)


if __name__ == '__main__':
    main()
