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

"""How far the odometry drifted, and how far it and the final poses are from the truth where that is known."""

from typing import NamedTuple

import numpy as np

from debris_scanner.core.geometry import Array, inverse, log_so3
from debris_scanner.evaluation.trajectory_errors import by_stamp
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import BLUE, GREEN, GRID, ORANGE, Plot, figure, mark_first_closure, thinned
from debris_scanner.report.truth import Errors, Truth


class _Curve(NamedTuple):
    name: str
    colour: str
    seconds: Array
    degrees: Array
    mm: Array


def drift_plot(scan: ScanOutput, truth: Truth | None) -> Plot | None:
    """None where there is nothing to compare: no closed loop, and no truth."""
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
