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

"""Figures over time: rotation rate, drift, and time per stage.

`rate_plot` shows the rates with their uncertainty. `drift_plot` shows how far the odometry drifted, and its
error and that of the final poses where the truth is known. `timing_plot` shows where the time went.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go

from debris_scanner.core.geometry import Array, inverse, log_so3
from debris_scanner.evaluation.trajectory_errors import by_stamp
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import (
    BLUE,
    GREEN,
    GRID,
    INK,
    ORANGE,
    RED,
    Plot,
    figure,
    mark_first_closure,
    thinned,
    time_axis,
)
from debris_scanner.report.truth import Errors, Truth

_AXES = tuple(zip('xyz', (BLUE, ORANGE, GREEN), strict=True))


class _Curve(NamedTuple):
    """One line of the drift figure."""

    name: str
    colour: str
    seconds: Array
    degrees: Array
    mm: Array


def rate_plot(scan: ScanOutput, truth: Truth | None) -> Plot | None:
    """Rate over time with 3σ and the gate's verdicts; None without at least two frames."""
    if len(scan.rates.stamps_ns) < 2:
        return None
    rates = scan.rates
    rejected = ~rates.accepted
    shown = thinned(len(rates.stamps_ns), rejected)
    t = scan.seconds(rates.stamps_ns)[shown]
    omega, band = rates.omega[shown], 3 * rates.sigma[shown]
    fig = figure()
    for k, (axis, colour) in enumerate(_AXES):
        _add_rate(fig, t, omega[:, k], band[:, k], axis, colour)
    if truth is not None:
        _add_true_rates(scan, truth, fig)
    if rejected.any():
        at = np.flatnonzero(rejected[shown])
        fig.add_scatter(
            x=np.tile(t[at], 3),
            y=omega[at].T.ravel(),
            mode='markers',
            name=f'rejected by the gate ({len(at)})',
            marker={'color': RED, 'symbol': 'x', 'size': 7},
        )
    fig.update_yaxes(title={'text': 'rate in the target frame, rad/s'}, range=_usual_range(omega, band))
    fig.update_layout(hovermode='x unified')
    time_axis(fig)
    mark_first_closure(scan, fig)
    n, bad = len(rejected), int(rejected.sum())
    return Plot(
        'rate',
        'Rate of rotation with 3σ',
        fig,
        f'The angular rate that the filter held at every frame, and three standard deviations to either '
        f'side. <b>Look for</b> bands that narrow within the first second and then stay narrow, and lines '
        f'without steps. A frame whose pose contradicted the prediction is marked <b>×</b>: the gate '
        f'rejected {bad} of {n} frames. The very first band is wide, and cut off here, because nothing is '
        'known yet.' + (' The dotted lines are the truth.' if truth is not None else ''),
    )


def _add_rate(fig: go.Figure, t: Array, omega: Array, band: Array, axis: str, colour: str) -> None:
    """The rate (n,) about one axis, in its band."""
    fig.add_scatter(
        x=np.concatenate([t, t[::-1]]),
        y=np.concatenate([omega + band, (omega - band)[::-1]]),
        fill='toself',
        mode='none',
        fillcolor=colour,
        opacity=0.18,
        hoverinfo='skip',
        showlegend=False,
        legendgroup=axis,
    )
    fig.add_scatter(
        x=t,
        y=omega,
        mode='lines',
        line={'color': colour, 'width': 1.8},
        name=f'ω<sub>{axis}</sub>',
        legendgroup=axis,
        customdata=band,
        hovertemplate='%{y:.4f} ± %{customdata:.4f} rad/s',
    )


def drift_plot(scan: ScanOutput, truth: Truth | None) -> Plot | None:
    """Attitude and position drift over time; None without a closed loop and without truth."""
    curves = []
    modelled = scan.summary['result'] == 'model'  # only then do the final poses differ from the odometry
    if modelled and len(by_stamp(scan.odometry).keys() & by_stamp(scan.poses).keys()) > 1:
        curves.append(_against_final(scan))
    if truth is not None:
        curves.append(
            _against_truth(scan, 'odometry against truth', ORANGE, truth.errors(scan.odometry, True))
        )
        if modelled:
            curves.append(_against_truth(scan, 'final against truth', GREEN, truth.errors(scan.poses)))
    if not curves:
        return None
    fig = figure(grid={'rows': 2, 'columns': 1, 'pattern': 'independent', 'ygap': 0.16})
    for c in curves:
        style = {
            'mode': 'lines',
            'name': c.name,
            'legendgroup': c.name,
            'line': {'color': c.colour, 'width': 1.8},
        }
        fig.add_scatter(x=c.seconds, y=c.degrees, **style)
        fig.add_scatter(x=c.seconds, y=c.mm, **style, showlegend=False, xaxis='x2', yaxis='y2')
    grid = {'gridcolor': GRID, 'zerolinecolor': GRID, 'linecolor': GRID}
    fig.update_layout(
        xaxis={'showticklabels': False},
        xaxis2={'title': {'text': 'time since the first frame, s'}, 'matches': 'x', **grid},
        yaxis={'title': {'text': 'attitude, deg'}, 'rangemode': 'tozero'},
        yaxis2={'title': {'text': 'position, mm'}, 'rangemode': 'tozero', **grid},
        hovermode='x unified',
    )
    mark_first_closure(scan, fig)
    return Plot('drift', 'Drift', fig, _caption(modelled, truth is not None), 460)


def timing_plot(timing: Mapping[str, Mapping[str, float]]) -> Plot | None:
    """Median and 99th percentile of every stage that ran, the costliest on top."""
    stages = sorted(timing, key=lambda s: timing[s]['count'] * timing[s]['p50_ms'])
    if not stages:
        return None
    names = [s.replace('_', ' ') for s in stages]
    counts = np.array([timing[s]['count'] for s in stages])
    fig = figure(hovermode='closest')
    for key, title, colour, symbol in (
        ('p50_ms', 'median', BLUE, 'circle'),
        ('p99_ms', '99 %', ORANGE, 'diamond'),
    ):
        fig.add_scatter(
            x=[max(timing[s][key], 1e-3) for s in stages],
            y=names,
            mode='markers',
            name=title,
            marker={'color': colour, 'size': 10, 'symbol': symbol},
            customdata=counts,
            hovertemplate=f'%{{y}}: {title} %{{x:.3~f}} ms, %{{customdata}} times<extra></extra>',
        )
    for name, s in zip(names, stages, strict=True):
        fig.add_shape(
            type='line',
            x0=max(timing[s]['p50_ms'], 1e-3),
            x1=max(timing[s]['p99_ms'], 1e-3),
            y0=name,
            y1=name,
            line={'color': 'var(--line)', 'width': 4},
            layer='below',
        )
    fig.update_xaxes(type='log', title={'text': 'milliseconds a call'}, dtick=1)
    return Plot(
        'timing',
        'Time per stage',
        fig,
        'How long each stage took, a point for the usual case and one for the slowest in a hundred; the '
        'costliest in all, by count and median, on top. <b>Look for</b> the stages that run at every frame '
        '(isolate, normals, view, registration or tracking): their sum must stay below the time between two '
        'frames for a live scan to keep pace. Generation, with relaxation, refinement and fusion inside it, '
        'runs only when a model is made.',
        max(260, 60 + 26 * len(stages)),
    )


def _add_true_rates(scan: ScanOutput, truth: Truth, fig: object) -> None:
    stamps, omega = truth.rates()
    shown = thinned(len(stamps))
    for k, (axis, _) in enumerate(_AXES):
        fig.add_scatter(  # type: ignore[attr-defined]
            x=scan.seconds(stamps[shown]),
            y=omega[shown, k],
            mode='lines',
            name='truth',
            legendgroup='truth',
            line={'color': INK, 'width': 1.2, 'dash': 'dot'},
            showlegend=axis == 'x',
            hoverinfo='skip',
        )


def _usual_range(omega: Array, band: Array) -> list[float]:
    """Limits that contain all but the extremes: the first bands are far wider than all others."""
    low = float(min(np.percentile(omega - band, 10), np.percentile(omega, 0.5)))
    high = float(max(np.percentile(omega + band, 90), np.percentile(omega, 99.5)))
    margin = 0.08 * max(high - low, 1e-3)
    return [low - margin, high + margin]


def _against_final(scan: ScanOutput) -> _Curve:
    odometry, final = by_stamp(scan.odometry), by_stamp(scan.poses)
    stamps = np.array(sorted(odometry.keys() & final.keys()), dtype=np.int64)
    stamps = stamps[thinned(len(stamps))]
    first = int(stamps[0])
    constant = inverse(odometry[first]) @ final[first]  # the two target frames have different origins
    live = np.array([odometry[int(s)] @ constant for s in stamps])
    later = np.array([final[int(s)] for s in stamps])
    turns = [np.linalg.norm(log_so3(a[:3, :3].T @ b[:3, :3])) for a, b in zip(live, later, strict=True)]
    shifts = np.linalg.norm(live[:, :3, 3] - later[:, :3, 3], axis=1)
    return _Curve('odometry against final', BLUE, scan.seconds(stamps), np.degrees(turns), shifts * 1e3)


def _against_truth(scan: ScanOutput, name: str, colour: str, errors: Errors) -> _Curve:
    k = thinned(len(errors.stamps_ns))
    seconds = scan.seconds(errors.stamps_ns[k])
    return _Curve(name, colour, seconds, np.degrees(errors.attitude_rad[k]), errors.position_m[k] * 1e3)


def _caption(modelled: bool, with_truth: bool) -> str:
    said = []
    if modelled:
        said.append(
            'How far the pose that was known live lies from the one after the loop was closed and everything '
            'was optimised, both tied together at the first frame. <b>Look for</b> a slow rise until the '
            'loop closes, which is drift, and a level line after it, which is tracking against the model: '
            'what remains there is the drift that the first model froze. Steps are lost frames.'
        )
    if with_truth:
        said.append('Against the truth, the odometry is tied at its first frame.')
    if with_truth and modelled:
        said.append('The final estimate is tied by one constant alignment over all frames.')
    if not modelled:
        said.append(
            'Without a model nothing was optimised, so that this is all the error there is. <b>Look for</b> '
            'a line as steep as the target turns: its rotation was not seen at all.'
        )
    return ' '.join(said)
