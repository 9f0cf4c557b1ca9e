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

"""Common style of all figures: colours that follow the page's theme, axes, and their description."""

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from debris_scanner.report.scan_output import ScanOutput

# Names of the page's CSS colours; its script inserts their values for light or dark.
INK, MUTED, GRID, SURFACE = 'var(--ink)', 'var(--muted)', 'var(--line)', 'var(--card)'
BLUE, ORANGE, GREEN, PURPLE, RED, TEAL = (f'var(--c{k})' for k in range(1, 7))
GOOD, BAD = BLUE, ORANGE  # distinguishable also with red-green blindness

MEASURE_NAMES = {
    'float': 'float',
    'binary': 'binary (median)',
    'normalised': 'normalised binary',
    'per_bin': 'per-bin binary',
    'attitude': 'attitude P<sub>β</sub>',
    'joint': 'joint P',
}
MEASURE_COLOURS = {
    'float': ORANGE,
    'binary': GREEN,
    'normalised': PURPLE,
    'per_bin': TEAL,
    'attitude': RED,
    'joint': BLUE,
}

MOST_SAMPLES = 4000  # drawn of a line over time


@dataclass(frozen=True)
class Choice:
    """A button above a figure that shows some of its traces and hides the others."""

    label: str
    visible: tuple[int, ...]


@dataclass(frozen=True)
class View:
    """A button beside a scene that looks at it from one side."""

    label: str
    camera: dict[str, dict[str, float]]  # as plotly takes it


@dataclass(frozen=True)
class Plot:
    """A figure with its title, caption and buttons."""

    key: str  # id of its element
    title: str
    figure: go.Figure
    caption: str  # what it shows and what to look for; HTML
    height: int = 380  # pixels
    choices: tuple[Choice, ...] = ()
    shape: str = 'wide'  # wide, half, or side: the caption beside it
    views: tuple[View, ...] = ()  # of a scene


def figure(**layout: object) -> go.Figure:
    """An empty figure in the page's style."""
    fig = go.Figure()
    fig.update_layout(
        template='none',
        paper_bgcolor='rgba(0,0,0,0)',
        plot_bgcolor='rgba(0,0,0,0)',
        font={'color': MUTED, 'size': 12, 'family': 'inherit'},
        margin={'l': 56, 'r': 14, 't': 12, 'b': 46},
        legend={'orientation': 'h', 'x': 0, 'y': 1.02, 'yanchor': 'bottom', 'font': {'color': INK}},
        hoverlabel={'bgcolor': SURFACE, 'bordercolor': GRID, 'font': {'color': INK}},
    )
    axis = {'gridcolor': GRID, 'linecolor': GRID, 'zerolinecolor': GRID, 'automargin': True}
    fig.update_layout(**layout)
    fig.update_xaxes(**axis)
    fig.update_yaxes(**axis)
    return fig


def time_axis(fig: go.Figure, **options: object) -> None:
    """Name the horizontal axis."""
    fig.update_xaxes(title={'text': 'time since the first frame, s'}, **options)


def mark_time(fig: go.Figure, seconds: float, text: str) -> None:
    """A dashed vertical line through the whole plot, named at its top."""
    fig.add_shape(
        type='line',
        x0=seconds,
        x1=seconds,
        y0=0,
        y1=1,
        yref='paper',
        line={'color': MUTED, 'width': 1, 'dash': 'dash'},
    )
    fig.add_annotation(
        x=seconds,
        y=1,
        yref='paper',
        yanchor='top',
        xanchor='left',
        text=text,
        showarrow=False,
        font={'color': MUTED, 'size': 11},
        xshift=4,
    )


def mark_first_closure(scan: ScanOutput, fig: go.Figure) -> None:
    """Mark when the loop was closed, if it was."""
    closure = scan.first_closure
    if closure is not None:
        stamp = np.array([closure.to_stamp_ns], dtype=np.int64)
        mark_time(fig, float(scan.seconds(stamp)[0]), 'loop closed')


def thinned(n: int, keep: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """Indices of at most ``MOST_SAMPLES`` of n samples, evenly, and of all those to keep."""
    chosen = evenly(n, MOST_SAMPLES)
    return chosen if keep is None else np.union1d(chosen, np.flatnonzero(keep))


def evenly(n: int, most: int) -> NDArray[np.intp]:
    """Indices of at most ``most`` of n samples, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.intp))
