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

"""The pose graph before and after pruning, as a spiral over the rotation travelled."""

import numpy as np
import plotly.graph_objects as go

from debris_scanner.core.geometry import Array
from debris_scanner.mapping.frame_graph import FrameGraph
from debris_scanner.report.scan_output import ScanOutput
from debris_scanner.report.style import BAD, GOOD, INK, MUTED, SURFACE, TEAL, Plot, figure

_PER_TURN = 0.28  # how far one winding of the spiral lies outside the one before


def graph_plots(scan: ScanOutput) -> list[Plot]:
    """Before and after, or nothing where there are not two key frames."""
    if len(scan.keyframes.stamps_ns) < 2:
        return []
    graph = frame_graph(scan)
    xy = spiral(scan.keyframes.path_rad)
    return [_before(scan, graph, xy), _after(scan, graph.prune(), xy)]


def frame_graph(scan: ScanOutput) -> FrameGraph:
    """Key frames, their succession and the accepted closures, as the scan's first optimisation got them."""
    graph = FrameGraph()
    for stamp in scan.keyframes.stamps_ns.tolist():
        graph.add_frame(stamp, linked=True)
    for c in scan.closures:
        if c.accepted and c.from_stamp_ns in graph and c.to_stamp_ns in graph:
            graph.add_closure(c.from_stamp_ns, c.to_stamp_ns, c.probability)
    return graph


def spiral(path_rad: Array) -> Array:
    """Positions (n, 2): one turn of the target is one winding, clockwise from the top."""
    radius = 1 + _PER_TURN * path_rad / (2 * np.pi)
    return np.stack([radius * np.sin(path_rad), radius * np.cos(path_rad)], axis=1)


def _before(scan: ScanOutput, graph: FrameGraph, xy: Array) -> Plot:
    index = {int(s): k for k, s in enumerate(scan.keyframes.stamps_ns)}
    tried = [c for c in scan.closures if c.from_stamp_ns in index and c.to_stamp_ns in index]
    refused = [(index[c.from_stamp_ns], index[c.to_stamp_ns]) for c in tried if not c.accepted]
    accepted = [(index[c.from_stamp_ns], index[c.to_stamp_ns]) for c in tried if c.accepted]
    fig = _canvas()
    _lines(fig, xy, [(k, k + 1) for k in range(len(xy) - 1)], MUTED, 1.5, 'succession')
    _lines(fig, xy, refused, BAD, 1.3, f'refused ({len(refused)})', 'dot')
    _lines(fig, xy, accepted, GOOD, 3.0, f'accepted ({len(accepted)})')
    _nodes(fig, scan, xy, np.ones(len(xy), bool))
    return Plot(
        'graph-before',
        'Before pruning',
        fig,
        'Key frames wound up by how far the target had turned, clockwise from the top, one winding a turn. '
        'Thin links join each to the next. <b>Look for</b> closures that run straight between neighbouring '
        'windings: they join equal attitudes. A chord across the middle would join a face with another.',
        440,
        shape='half',
    )


def _after(scan: ScanOutput, pruned: FrameGraph, xy: Array) -> Plot:
    stamps = scan.keyframes.stamps_ns.tolist()
    index = {s: k for k, s in enumerate(stamps)}
    kept = np.array([s in pruned for s in stamps])
    edges = [(index[e.earlier_ns], index[e.later_ns], e.probability is None) for e in pruned.edges()]
    final = [(int(a), int(b)) for a, b in scan.keyframes.edges if abs(int(a) - int(b)) > 1]
    fig = _canvas()
    _lines(fig, xy, final, TEAL, 0.8, f'final pairs ({len(final)})')
    _lines(fig, xy, [(a, b) for a, b, follows in edges if follows], MUTED, 1.5, 'succession')
    _lines(fig, xy, [(a, b) for a, b, follows in edges if not follows], GOOD, 3.0, 'closures')
    _nodes(fig, scan, xy, kept)
    n = int(kept.sum())
    left = len(kept) - n
    if n == 0:
        said = (
            'No closure holds, so no cycle is left and every key frame is pruned: there is nothing to relax.'
        )
    else:
        said = (
            f'Only key frames on a cycle can share out the drift: {n} stay and {left} hang loose (hollow). '
            'The cycle is relaxed first; the loose ones ride along.'
        )
    if final:
        said += (
            f' Then all pairs that look from nearby and agree, {len(final)} here, are relaxed together with '
            'the succession: those are the final pairs. <b>Look for</b> pairs all around: each stiffens the '
            'model.'
        )
    return Plot('graph-after', 'After pruning', fig, said, 440, shape='half')


def _canvas() -> go.Figure:
    fig = figure(margin={'l': 8, 'r': 8, 't': 8, 'b': 8}, hovermode='closest')
    hidden = {'visible': False, 'showgrid': False, 'zeroline': False}
    fig.update_xaxes(**hidden)
    fig.update_yaxes(scaleanchor='x', **hidden)
    return fig


def _lines(
    fig: go.Figure,
    xy: Array,
    pairs: list[tuple[int, int]],
    colour: str,
    width: float,
    name: str,
    dash: str = 'solid',
) -> None:
    ends = np.full((len(pairs), 3, 2), np.nan)
    if pairs:
        ends[:, :2] = xy[np.array(pairs)]
    x, y = ends.reshape(-1, 2).T
    fig.add_scatter(
        x=x,
        y=y,
        mode='lines',
        line={'color': colour, 'width': width, 'dash': dash},
        name=name,
        hoverinfo='skip',
        showlegend=bool(pairs),
        connectgaps=False,
    )


def _nodes(fig: go.Figure, scan: ScanOutput, xy: Array, kept: Array) -> None:
    t = scan.seconds(scan.keyframes.stamps_ns)
    turned = np.degrees(scan.keyframes.path_rad)
    fig.add_scatter(
        x=xy[:, 0],
        y=xy[:, 1],
        mode='markers',
        showlegend=False,
        marker={
            'size': 9,
            'color': [INK if k else SURFACE for k in kept],
            'line': {'width': 1.5, 'color': INK},
        },
        customdata=np.stack([np.arange(len(t)), t, turned], axis=1),
        hovertemplate='key frame %{customdata[0]:.0f}<br>%{customdata[1]:.2f} s, '
        'turned %{customdata[2]:.0f}°<extra></extra>',
    )
