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

"""Picture of the data flow and of the scan's states, for README.md and docs/design.md.

python docs/draw_data_flow.py docs/data_flow.svg    (or .png)
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

mpl.use('Agg')
mpl.rcParams |= {'font.family': 'DejaVu Sans', 'svg.hashsalt': 'debris_scanner'}

WIDTH, HEIGHT = 12.4, 7.9  # inches, and the units of all that is drawn
CARD, BORDER = '#161921', '#3a4152'
INK, SOFT, LINE = '#e8ecf3', '#a9b4c6', '#7d8aa3'
BLUE, GREEN, AMBER, RED, GREY = '#2f5d86', '#2c6e4f', '#8a5a12', '#8a3440', '#343b4b'
TOPIC = '#ffc26b'
GRAPH = 'relaxes the key frames, fuses the frames into a model,\nand checks the model against the frames'


def box(
    axes: Axes, x: float, y: float, size: tuple[float, float], face: str, title: str, text: str = ''
) -> None:
    """A box with its lower left corner at (x, y)."""
    w, h = size
    patch = FancyBboxPatch(
        (x, y), w, h, boxstyle='round,pad=0,rounding_size=0.12', facecolor=face, edgecolor=LINE, linewidth=1
    )
    axes.add_patch(patch)
    middle = y + h / 2
    if text:
        axes.text(x + w / 2, y + h - 0.14, title, color=INK, size=12.5, weight='bold', ha='center', va='top')
        axes.text(x + w / 2, y + h - 0.46, text, color=INK, size=9, ha='center', va='top', linespacing=1.35)
    else:
        axes.text(x + w / 2, middle, title, color=INK, size=11.5, weight='bold', ha='center', va='center')


def group(
    axes: Axes, x: float, y: float, size: tuple[float, float], title: str, at_top: bool = False
) -> None:
    """A dashed frame around boxes, its title inside."""
    patch = FancyBboxPatch(
        (x, y), *size, boxstyle='round,pad=0,rounding_size=0.18', facecolor='none', edgecolor=BORDER,
        linewidth=1.3, linestyle=(0, (5, 3)),
    )  # fmt: skip
    axes.add_patch(patch)
    line = y + size[1] - 0.3 if at_top else y + 0.23
    axes.text(x + 0.22, line, title, color=SOFT, size=9.5, style='italic', va='center')


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], bend: float = 0.0, colour: str = LINE
) -> None:
    """From start to end; a bend of 0 is straight."""
    patch = FancyArrowPatch(
        start, end, arrowstyle='-|>', mutation_scale=15, linewidth=1.7, color=colour, shrinkA=0, shrinkB=0,
        connectionstyle=f'arc3,rad={bend}',
    )  # fmt: skip
    axes.add_patch(patch)


def topic(axes: Axes, x: float, y: float, text: str, side: str = 'center', soft: str = '') -> None:
    """Names of topics beside an arrow, and a remark below them."""
    axes.text(
        x, y, text, color=TOPIC, size=9, ha=side, va='center', linespacing=1.3, family='DejaVu Sans Mono'
    )
    if soft:
        lines = text.count('\n') + 1
        axes.text(x, y - 0.13 - 0.1 * lines, soft, color=SOFT, size=8.5, ha=side, va='center')


def data_flow(axes: Axes) -> None:
    """Sensor to model, and the model back to odometry."""
    group(axes, 2.62, 5.45, (9.48, 1.95), 'front end: every frame', at_top=True)
    group(axes, 2.62, 2.62, (9.48, 1.75), 'back end: when a loop closes, or enough of the surface is new')
    size = (2.2, 1.08)
    box(axes, 0.3, 5.65, (1.6, 1.08), GREY, 'sensor', 'driver, bag,\nor simulator')
    box(axes, 2.82, 5.65, size, BLUE, 'preprocess', 'finds the target,\nfits normals')
    box(axes, 6.35, 5.65, size, BLUE, 'odometry', 'pose and rates,\nkey frames, tracking')
    box(axes, 9.7, 5.65, size, BLUE, 'closure', 'descriptors, search,\ngeometric check')
    box(axes, 2.82, 3.09, (9.08, 1.08), GREEN, 'graph', GRAPH)
    box(axes, 0.3, 3.09, (1.6, 1.08), GREY, 'results', 'model, mesh,\nposes, summary')
    arrow(axes, (1.9, 6.19), (2.82, 6.19))
    topic(axes, 1.1, 7.0, 'points\ndepth/image_raw')
    arrow(axes, (5.02, 6.19), (6.35, 6.19))
    topic(axes, 5.68, 6.38, 'target_points')
    arrow(axes, (8.55, 6.19), (9.7, 6.19))
    topic(axes, 9.12, 6.43, 'keyframe_\npoints')
    arrow(axes, (3.5, 5.65), (3.5, 4.17))
    topic(axes, 3.6, 4.92, 'target_points', 'left')
    arrow(axes, (8.0, 5.65), (8.0, 4.17))
    topic(axes, 8.1, 4.92, 'odometry\nkeyframe_points', 'left')
    arrow(axes, (10.8, 5.65), (10.8, 4.17))
    topic(axes, 10.9, 4.92, 'closures', 'left')
    arrow(axes, (6.95, 4.17), (6.95, 5.65), colour=TOPIC)
    topic(axes, 6.85, 5.02, 'model\nkeyframe_poses', 'right', soft='latched: tracking begins')
    arrow(axes, (2.82, 3.63), (1.9, 3.63))


def states(axes: Axes) -> None:
    """What topic `state` says."""
    axes.text(0.3, 2.28, 'states', color=SOFT, size=9.5, style='italic', va='center')
    axes.plot([0.95, 12.1], [2.28, 2.28], color=BORDER, linewidth=1)
    note(axes, 2.2, 1.98, 'from anywhere, no frames come: waiting')
    note(axes, 10.8, 1.98, 'from anywhere, results are written: finished')
    y, h = 0.85, 0.58
    for x, face, name in ((0.9, BLUE, 'scanning'), (4.25, GREEN, 'generating'), (7.6, AMBER, 'tracking')):
        box(axes, x, y, (1.75, h), face, name)
    box(axes, 10.6, y, (1.2, h), RED, 'lost')
    middle = y + h / 2
    arrow(axes, (2.65, middle + 0.1), (4.25, middle + 0.1))
    note(axes, 3.45, middle + 0.31, 'loop closed')
    arrow(axes, (4.25, middle - 0.12), (2.65, middle - 0.12))
    note(axes, 3.45, middle - 0.32, 'model refused')
    arrow(axes, (6.0, middle), (7.6, middle))
    note(axes, 6.8, middle + 0.2, 'model adopted')
    arrow(axes, (9.35, middle + 0.1), (10.6, middle + 0.1))
    note(axes, 9.98, middle + 0.31, 'no match')
    arrow(axes, (10.6, middle - 0.12), (9.35, middle - 0.12))
    note(axes, 9.98, middle - 0.32, 'found again')
    arrow(axes, (11.2, y), (1.78, y), bend=-0.1)
    note(axes, 6.5, 0.21, 'before the first model: found again, or a new submap begins')
    arrow(axes, (1.78, y + h), (11.2, y + h), bend=-0.06)
    note(axes, 6.5, 1.9, 'before the first model: no match')


def note(axes: Axes, x: float, y: float, text: str) -> None:
    """A remark beside an arrow."""
    axes.text(x, y, text, color=SOFT, size=8.5, ha='center', va='center')


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('picture', type=Path)
    args = parser.parse_args()
    figure = plt.figure(figsize=(WIDTH, HEIGHT), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT), aspect='equal')
    axes.axis('off')
    card = FancyBboxPatch(
        (0.04, 0.04), WIDTH - 0.08, HEIGHT - 0.08, boxstyle='round,pad=0,rounding_size=0.25', facecolor=CARD,
        edgecolor=BORDER, linewidth=1.2,
    )  # fmt: skip
    axes.add_patch(card)
    data_flow(axes)
    states(axes)
    metadata = {'Date': None} if args.picture.suffix == '.svg' else None
    figure.savefig(args.picture, transparent=True, metadata=metadata)


if __name__ == '__main__':
    main()
