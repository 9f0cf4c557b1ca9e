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

"""How every figure is drawn and saved: with matplotlib, off screen, named by the thesis's number."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from debris_scanner.core.geometry import Array

# After Okabe and Ito: apart also for those who do not see red from green.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = '#0072b2', '#e69f00', '#009e73', '#c1121f', '#cc79a7', '#56b4e9'
GREY, INK = '#8c8c8c', '#222222'
AXES = 'xyz'
DPI = 100
MOST_POINTS = 12_000  # drawn of a model


@dataclass(frozen=True)
class Drawn:
    """A figure on disk; ``number`` is that of the thesis's figure it corresponds to."""

    number: str
    file: str  # relative to the folder it was drawn into
    caption: str

    @property
    def order(self) -> tuple[int, int, str]:
        """Chapter and number, for sorting."""
        chapter, n = self.number.split('.')
        return int(chapter), int(n), self.file


def axes(
    rows: int = 1, columns: int = 1, width: float = 7.5, height: float = 3.2, share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """An empty figure and its axes, row by row; inches."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout='constrained')
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=share_x)
    flat = [a for row in grid for a in row]
    for a in flat:
        a.grid(True, color='#e4e4e4', linewidth=0.6)
        a.set_axisbelow(True)
        for side in ('top', 'right'):
            a.spines[side].set_visible(False)
    return figure, flat


def save(figure: Figure, folder: Path, number: str, name: str, caption: str) -> Drawn:
    """Write ``figure_4.05_name.png`` and return what the index needs of it."""
    chapter, n = number.split('.')
    file = f'figure_{chapter}.{int(n):02d}_{name}.png'
    figure.savefig(folder / file)
    return Drawn(number, file, caption)


def seconds(stamps_ns: Sequence[int], start_ns: int) -> Array:
    """Time since a stamp."""
    return np.asarray((np.array(stamps_ns, np.int64) - start_ns) * 1e-9, np.float64)


def draw_cloud(axis: Axes, points: Array, across: int, up: int, colour: str = INK, size: float = 1.0) -> None:
    """Points (n, 3), metres, looked at along the third axis; what is nearer hides nothing."""
    shown = thinned(points)
    axis.scatter(shown[:, across] * 1e3, shown[:, up] * 1e3, s=size, c=colour, linewidths=0, rasterized=True)
    axis.set_aspect('equal')
    axis.set_xlabel(f'{AXES[across]}, mm')
    axis.set_ylabel(f'{AXES[up]}, mm')


def thinned(points: Array) -> Array:
    """At most ``MOST_POINTS`` of them, evenly."""
    return points[:: max(1, len(points) // MOST_POINTS)]


def draw_surface(axis: Axes, points: Array, normals: Array, across: int, up: int) -> None:
    """What of a surface faces a viewer on the positive third axis, shaded; points and normals (n, 3)."""
    towards = {(1, 2): 0, (2, 0): 1, (0, 1): 2}[across, up]
    step = max(1, len(points) // MOST_POINTS // 2)
    points, normals = points[::step], normals[::step]
    seen = np.flatnonzero(normals[:, towards] > 0)
    seen = seen[np.argsort(points[seen, towards])]  # the nearer drawn last
    n = normals[seen]
    light = np.clip(0.25 + 0.55 * n[:, towards] + 0.25 * n[:, up] - 0.1 * n[:, across], 0.05, 1.0)
    axis.scatter(
        points[seen, across] * 1e3,
        points[seen, up] * 1e3,
        s=3.0,
        c=light,
        cmap='bone',
        vmin=0,
        vmax=1.1,
        linewidths=0,
        rasterized=True,
    )
    axis.set_aspect('equal')
    axis.set_xlabel(f'{AXES[across]}, mm')
    axis.set_ylabel(f'{AXES[up]}, mm')
