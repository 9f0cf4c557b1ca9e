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

"""Plots of what comes after the last frame: how well it is known, and the polhode."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from debris_scanner.core.geometry import Array
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import BLUE, GREEN, GRID, MUTED, ORANGE, Plot, figure
from debris_scanner.tracking.dynamics import NOT_OBSERVABLE, NOT_TORQUE_FREE, TORQUE_FREE

_KINDS = {
    TORQUE_FREE: 'The target turns as a body free of torque, whose inertia is known.',
    NOT_OBSERVABLE: 'The target turns about one principal axis, which tells nothing of its inertia.',
    NOT_TORQUE_FREE: 'Something drives or brakes the target, or the sensor itself turns. It is taken to go '
    'on about the same axis, with as much doubt as such forecasts deserved earlier in the scan.',
}
MOST_RATES = 300  # of tracked frames, drawn


def forecast_plot(scan: ScanOutput) -> Plot | None:
    """Standard deviations of attitude and position over the time ahead; None without a forecast."""
    forecast = scan.forecast
    if forecast is None:
        return None
    last_ns = scan.poses[-1].stamp_ns if scan.poses else forecast.stamps_ns[0] - 1_000_000_000
    ahead = (np.array(forecast.stamps_ns) - last_ns) * 1e-9
    fig = figure(grid={'rows': 2, 'columns': 1, 'pattern': 'independent', 'ygap': 0.16})
    rows: tuple[tuple[Array, dict[str, str]], ...] = (
        (np.degrees(forecast.attitude_sigma), {}),
        (1e3 * forecast.position_sigma, {'xaxis': 'x2', 'yaxis': 'y2'}),
    )
    for k, colour in enumerate((BLUE, ORANGE, GREEN)):
        for sigmas, where in rows:
            for sign in (1, -1):
                fig.add_scatter(
                    x=ahead,
                    y=sign * sigmas[:, k],
                    mode='lines',
                    name='xyz'[k],
                    legendgroup='xyz'[k],
                    line={'color': colour, 'width': 1.6},
                    showlegend=sign > 0 and not where,
                    hoverinfo='x+y+name' if sign > 0 else 'skip',
                    **where,
                )
    grid = {'gridcolor': GRID, 'zerolinecolor': GRID, 'linecolor': GRID}
    fig.update_layout(
        xaxis={'showticklabels': False},
        xaxis2={'title': {'text': 'time after the last frame, s'}, 'matches': 'x', **grid},
        yaxis={'title': {'text': 'attitude ± 1 sigma, deg'}},
        yaxis2={'title': {'text': 'position ± 1 sigma, mm'}, **grid},
    )
    told = scan.summary.get('mass_properties') or {}
    caption = (
        f"{_KINDS.get(told.get('why', ''), '')} The tube that the attitude, about the target's axes, and the "
        "origin, along the sensor's, will keep to in two of three cases. The poses are in "
        '<code>forecast.csv</code>. <b>Look for</b> how soon it is wider than what you plan allows.'
    )
    return Plot('forecast', 'Forecast', fig, caption, 460)


def polhode_plot(scan: ScanOutput) -> Plot | None:
    """Path of the rate on the ellipsoid of equal energy; None unless the inertia is known."""
    told: dict[str, Any] = scan.summary.get('mass_properties') or {}
    if scan.forecast is None or not told.get('observable'):
        return None
    axes = np.array(told['principal_axes'])  # rows
    moments = np.array([*told['inertia_ratios'], 1.0])
    ahead = np.degrees(scan.forecast.rates @ axes.T)
    semi = np.sqrt(np.mean(ahead**2 @ moments) / moments)
    names = dict(zip('xyz', ('least moment', 'middle', 'largest moment'), strict=True))
    style = {'color': MUTED, 'gridcolor': GRID, 'showbackground': False}
    fig = figure(
        scene={'aspectmode': 'data'} | {f'{a}axis': {'title': {'text': n}} | style for a, n in names.items()},
        margin={'l': 0, 'r': 0, 't': 12, 'b': 0},
    )
    fig.add_scatter3d(
        **_xyz(_ellipsoid(semi)),
        mode='lines',
        name='equal energy',
        line={'color': GRID, 'width': 1},
        hoverinfo='skip',
    )
    fig.add_scatter3d(
        **_xyz(ahead.T.tolist()),
        mode='lines+markers',
        name='the next minute',
        line={'color': BLUE, 'width': 5},
        marker={'color': BLUE, 'size': 2},
    )
    used = scan.rates.omega[scan.rates.accepted]
    seen = np.degrees(used[:: max(1, len(used) // MOST_RATES)] @ axes.T)
    fig.add_scatter3d(
        **_xyz(seen.T.tolist()), mode='markers', name='as tracked', marker={'color': ORANGE, 'size': 2}
    )
    caption = (
        'Rates about the principal axes, deg/s. Without torque they stay on this ellipsoid and on one closed '
        'curve, the polhode. <b>Look for</b> rates of the tracked frames, with their noise, along the same '
        'curve. Near the middle axis it bends sharply, and the target turns over.'
    )
    return Plot('polhode', 'Polhode', fig, caption, 480)


def _xyz(columns: Sequence[Any]) -> dict[str, Any]:
    return dict(zip('xyz', columns, strict=True))


def _ellipsoid(semi: Array) -> list[list[float | None]]:
    """x, y, z of its circles of latitude and longitude, parted by None."""
    round_, steps = np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 13)
    sine, cosine, level = np.sin(round_), np.cos(round_), np.ones(49)
    circles = [np.array([np.sin(s) * cosine, np.sin(s) * sine, np.cos(s) * level]) for s in steps[1:-1]]
    circles += [np.array([sine * np.cos(s), sine * np.sin(s), cosine]) for s in steps[:-1]]
    return [[v for circle in circles for v in (*(semi[k] * circle[k]).tolist(), None)] for k in range(3)]
