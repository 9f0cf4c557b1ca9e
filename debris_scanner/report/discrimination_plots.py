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

"""How well each measure distinguishes the same face from others: distribution, entropy and ROC."""

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.evaluation.trajectory_errors import TRUE_CLOSURE_RAD
from debris_scanner.mapping.closure_matrices import ClosureMatrices
from debris_scanner.report.discrimination import area_under, entropy_bits, roc
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import INK, MEASURE_COLOURS, MEASURE_NAMES, Plot, figure
from debris_scanner.report.truth import Truth

HALF_TURN = np.pi  # pairs with less rotation in between are alike merely because they are near
FEWEST_PAIRS = 10
_SIMILARITIES = ('float', 'binary', 'normalised', 'per_bin', 'joint')


def discrimination_plots(scan: ScanOutput, matrices: ClosureMatrices, truth: Truth | None) -> list[Plot]:
    """Distribution and ROC over the pairs with at least half a turn in between."""
    R = _attitudes(scan, matrices, truth)
    frames = scan.keyframes
    path = dict(zip(frames.stamps_ns.tolist(), frames.path_rad.tolist(), strict=True))
    use = [k for k, s in enumerate(matrices.stamps_ns.tolist()) if s in path and s in R]
    paths = np.array([path[int(matrices.stamps_ns[k])] for k in use])
    i, j = np.nonzero(paths[:, None] - paths[None] >= HALF_TURN) if use else (np.zeros(0, int),) * 2
    if len(i) < FEWEST_PAIRS:
        return []
    rotations = np.array([R[int(matrices.stamps_ns[k])] for k in use])
    cosine = (np.einsum('nij,nij->n', rotations[i], rotations[j]) - 1) / 2
    same = np.arccos(np.clip(cosine, -1, 1)) <= TRUE_CLOSURE_RAD
    index = np.array(use)
    values = {
        m: matrices.by_measure[m][index[i], index[j]].astype(np.float64) for m in (*_SIMILARITIES, 'attitude')
    }
    plots = [_distribution(values)]
    if same.any() and not same.all():
        plots.append(_roc(values, same, truth is not None))
    return plots


def _attitudes(scan: ScanOutput, matrices: ClosureMatrices, truth: Truth | None) -> dict[int, Array]:
    """Rotations by stamp, which decide the pairs that show the same face."""
    if truth is not None:
        return {s: T[:3, :3] for s, T in truth.T_sensor_target.items()}
    frames = scan.keyframes
    rotations = np.swapaxes(frames.T_target_sensor[:, :3, :3], 1, 2)
    return dict(zip(frames.stamps_ns.tolist(), rotations, strict=True))


def _distribution(values: dict[str, Array]) -> Plot:
    fig = figure(violingap=0.15)
    for name in reversed(_SIMILARITIES):
        v = values[name]
        fig.add_violin(
            x=v,
            name=f'{MEASURE_NAMES[name]}<br>{entropy_bits(v):.2f} bit',
            orientation='h',
            side='positive',
            width=1.7,
            line={'color': MEASURE_COLOURS[name], 'width': 1.5},
            points=False,
            spanmode='hard',
            showlegend=False,
            hoverinfo='skip',
            meanline={'visible': True},
        )
    fig.update_xaxes(title={'text': 'probability'}, range=[0, 1])
    n = len(next(iter(values.values())))
    return Plot(
        'spread',
        'How much each measure says',
        fig,
        f'How the probabilities of {n} pairs, those with at least half a turn in between, are spread, and '
        'their Shannon entropy in 64 bins. <b>Look for</b> a long tail to the right that stands clear of the '
        'bulk. A narrow hump near 1 finds everything alike and says little: few bits.',
        400,
        shape='half',
    )


def _roc(values: dict[str, Array], same: NDArray[np.bool_], by_truth: bool) -> Plot:
    fig = figure()
    for name in (*_SIMILARITIES, 'attitude'):
        false, true = roc(values[name], same)
        fig.add_scatter(
            x=false,
            y=true,
            mode='lines',
            line={'color': MEASURE_COLOURS[name], 'width': 1.8, 'shape': 'vh'},
            name=f'{MEASURE_NAMES[name]}: {area_under(false, true):.3f}',
        )
    fig.add_scatter(
        x=[0, 1],
        y=[0, 1],
        mode='lines',
        line={'color': INK, 'width': 1, 'dash': 'dot'},
        opacity=0.4,
        showlegend=False,
        hoverinfo='skip',
    )
    fig.update_xaxes(title={'text': 'other faces taken for the same'}, range=[-0.02, 1.02])
    fig.update_yaxes(title={'text': 'same faces found'}, range=[-0.02, 1.03])
    judge = 'the truth' if by_truth else "this scan's own final attitudes"
    return Plot(
        'roc',
        'Telling the same face from others',
        fig,
        f'As the threshold falls: the share of same faces found against the share of others mistaken for '
        f'them, with the area under each curve. The same face means attitudes within 10°, judged by {judge}: '
        f'{int(same.sum())} of {len(same)} pairs. <b>Look for</b> curves that hug the upper left corner; '
        'with few pairs of the same face they are coarse.',
        400,
        shape='half',
    )
