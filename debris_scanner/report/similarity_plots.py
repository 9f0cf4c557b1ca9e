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

"""Likeness of the key frames: probabilities over time and over all pairs."""

import numpy as np
import plotly.graph_objects as go

from debris_scanner.mapping.closure_matrices import MEASURES, ClosureMatrices
from debris_scanner.report.discrimination_plots import discrimination_plots
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import (
    MEASURE_COLOURS,
    MEASURE_NAMES,
    MUTED,
    Choice,
    Plot,
    figure,
    mark_time,
    time_axis,
)
from debris_scanner.report.truth import Truth

_MARK = '#ff4f86'  # stands out from every colour of the map


def similarity_plots(scan: ScanOutput, truth: Truth | None) -> list[Plot]:
    """Empty unless at least two key frames were described."""
    matrices = scan.matrices
    if matrices is None or len(matrices.stamps_ns) < 2:
        return []
    row = closing_row(scan, matrices)
    plots = [_over_frames(scan, matrices, row), _all_pairs(scan, matrices)]
    return plots + discrimination_plots(scan, matrices, truth)


def closing_row(scan: ScanOutput, matrices: ClosureMatrices) -> int:
    """Index of the key frame that closed the loop, else that of the most likely hypothesis, else the last."""
    known = {int(s): k for k, s in enumerate(matrices.stamps_ns)}
    tried = [c for c in scan.closures if c.to_stamp_ns in known]
    closure = scan.first_closure
    if closure is None or closure.to_stamp_ns not in known:
        closure = max(tried, key=lambda c: np.nan_to_num(c.probability), default=None)
    return len(known) - 1 if closure is None else known[closure.to_stamp_ns]


def _over_frames(scan: ScanOutput, matrices: ClosureMatrices, row: int) -> Plot:
    t = scan.seconds(matrices.stamps_ns)
    fig = figure(hovermode='x unified')
    for name in MEASURES:
        main = name == 'joint'
        fig.add_scatter(
            x=t,
            y=matrices.by_measure[name][row],
            name=MEASURE_NAMES[name],
            mode='lines+markers',
            line={
                'color': MEASURE_COLOURS[name],
                'width': 2.8 if main else 1.5,
                'dash': 'dot' if name == 'attitude' else 'solid',
            },
            marker={'size': 6 if main else 4},
            hovertemplate='%{y:.3f}',
        )
    fig.update_yaxes(title={'text': 'probability'}, range=[-0.03, 1.12])  # room for the mark's name
    time_axis(fig)
    mark_time(fig, float(t[row]), f'key frame {row}')
    return Plot(
        'likeness',
        'Probability over the frames',
        fig,
        f'How alike key frame <b data-row>{row}</b> is to every other one, by each measure; its own column '
        'is at the dashed line, where every measure is 1. Select another key frame by a click into the map '
        'below. <b>Look for</b> a second peak one turn away from the dashed line: that is the face coming '
        'round again. The joint P, the geometric mean of per-bin likeness and attitude, is what candidates '
        'are ranked by; a measure that hardly falls in between could not have found them alone.',
        420,
    )


def _all_pairs(scan: ScanOutput, matrices: ClosureMatrices) -> Plot:
    n = len(matrices.stamps_ns)
    fig = figure()
    for name in MEASURES:
        fig.add_heatmap(
            z=matrices.by_measure[name],
            colorscale='Viridis',
            visible=name == 'joint',
            name=MEASURE_NAMES[name],
            colorbar={'thickness': 12, 'outlinewidth': 0, 'tickfont': {'color': MUTED}},
            hovertemplate='key frames %{x} and %{y}: %{z:.3f}<extra></extra>',
        )
    _mark_closures(fig, scan, matrices)
    fig.update_xaxes(title={'text': 'key frame'}, constrain='domain', range=[-0.5, n - 0.5], showgrid=False)
    fig.update_yaxes(
        title={'text': 'key frame'},
        scaleanchor='x',
        constrain='domain',
        range=[n - 0.5, -0.5],
        showgrid=False,
    )
    marks = (len(MEASURES), len(MEASURES) + 1)
    order = ('joint', 'attitude', 'per_bin', 'binary', 'normalised', 'float')
    choices = tuple(Choice(_plain(MEASURE_NAMES[m]), (MEASURES.index(m), *marks)) for m in order)
    return Plot(
        'pairs',
        'Every pair of key frames',
        fig,
        'The same for all pairs; the diagonal is a key frame with itself. <b>Look for</b> a bright stripe '
        'beside the diagonal and parallel to it, one turn away: the target comes back to the same faces in '
        'the same order. A bright patch off any stripe is a look-alike, and a trap. Circles are closures '
        'that were accepted, crosses those that were tried and refused. Click a row to see it above.',
        540,
        choices,
        shape='side',
    )


def _mark_closures(fig: go.Figure, scan: ScanOutput, matrices: ClosureMatrices) -> None:
    known = {int(s): k for k, s in enumerate(matrices.stamps_ns)}
    for accepted, name, symbol in ((False, 'refused', 'x-thin-open'), (True, 'accepted', 'circle-open')):
        ends = [
            (known[c.from_stamp_ns], known[c.to_stamp_ns])
            for c in scan.closures
            if c.accepted == accepted and c.from_stamp_ns in known and c.to_stamp_ns in known
        ]
        fig.add_scatter(
            x=[a for a, _ in ends],
            y=[b for _, b in ends],
            mode='markers',
            name=f'{name} closure',
            marker={'symbol': symbol, 'size': 13 if accepted else 9, 'color': _MARK, 'line': {'width': 2.5}},
            hovertemplate=f'{name}: %{{x}} and %{{y}}<extra></extra>',
            showlegend=bool(ends),
        )


def _plain(text: str) -> str:
    return text.replace('<sub>β</sub>', 'β')
