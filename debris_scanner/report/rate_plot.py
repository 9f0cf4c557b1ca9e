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

"""How the target turned: its rates with their uncertainty."""

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    RED,
    Plot,
    figure,
    mark_first_closure,
    thinned,
    time_axis,
)
from debris_scanner.report.truth import Truth

_AXES = tuple(zip('xyz', (BLUE, ORANGE, GREEN), strict=True))


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
        edge = np.concatenate([omega[:, k] + band[:, k], (omega[:, k] - band[:, k])[::-1]])
        fig.add_scatter(
            x=np.concatenate([t, t[::-1]]),
            y=edge,
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
            y=omega[:, k],
            mode='lines',
            line={'color': colour, 'width': 1.8},
            name=f'ω<sub>{axis}</sub>',
            legendgroup=axis,
            customdata=band[:, k],
            hovertemplate='%{y:.4f} ± %{customdata:.4f} rad/s',
        )
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
    """Limits that hold all but the extremes: the first bands are far wider than all others."""
    low = float(min(np.percentile(omega - band, 10), np.percentile(omega, 0.5)))
    high = float(max(np.percentile(omega + band, 90), np.percentile(omega, 99.5)))
    margin = 0.08 * max(high - low, 1e-3)
    return [low - margin, high + margin]
