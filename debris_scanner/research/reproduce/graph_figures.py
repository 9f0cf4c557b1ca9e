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

"""Figures 4.16, 4.18, 5.1 and 5.2: the frame graph with its closures, before and after pruning."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from debris_scanner.core.geometry import Array
from debris_scanner.core.parameters import updated
from debris_scanner.core.results import ClosureRecord
from debris_scanner.evaluation.trajectory_errors import is_true
from debris_scanner.mapping.frame_graph import FrameEdge, FrameGraph
from debris_scanner.research.reproduce.drawing import BLUE, GREY, INK, ORANGE, RED, Drawn, axes, save
from debris_scanner.research.reproduce.methods import Runs
from debris_scanner.research.thesis.loop_closures import closed_graphs, hypotheses, open_graph
from debris_scanner.research.thesis.settings import ThesisSettings

_Truth = Mapping[int, Array]


def pruning_figure(runs: Runs, truth: _Truth, folder: Path, number: str, named: str) -> Drawn:
    """The graph of the hypothesis that was used, before and after pruning (4.16 or 5.2)."""
    thesis = runs.thesis
    assert thesis.graph_before is not None
    before, after = thesis.graph_before, thesis.graph_after
    figure, (left, right) = axes(1, 2, width=9, height=4.7)
    draw_graph(left, before, before, truth)
    left.set_title(f'before: {len(before)} frames, {len(before.edges())} edges')
    if after is None:
        right.axis('off')
        right.set_title('after: nothing is left')
    else:
        draw_graph(right, before, after, truth)
        right.set_title(f'after: {len(after)} frames, {len(after.edges())} edges')
    return save(
        figure,
        folder,
        number,
        f'graph_{named}',
        'Frame graph before and after pruning, frames clockwise in order of time. Closures between frames '
        'that truly show the same face are blue, false ones red; what pruning took away is orange.',
    )


def unpruned_figure(runs: Runs, settings: ThesisSettings, truth: _Truth, folder: Path, named: str) -> Drawn:
    """Every closure whose probability suffices, false ones in red (5.1)."""
    graph, proposed = _with_all(runs, settings)
    false = sum(not _true(truth, e) for e in proposed)
    figure, (axis,) = axes(width=5.2, height=4.9)
    draw_graph(axis, graph, graph, truth)
    return save(
        figure,
        folder,
        '5.1',
        f'unpruned_{named}',
        f'Unpruned graph with all {len(proposed)} closures at or above the least probability and half a turn '
        f'apart; {false} of them, red, join different faces.',
    )


def search_figure(runs: Runs, settings: ThesisSettings, truth: _Truth, folder: Path, named: str) -> Drawn:
    """What greedy and frugal search make of the same probabilities (4.18)."""
    thesis = runs.thesis
    assert thesis.odometry is not None and thesis.probabilities is not None
    figure, panels = axes(1, 2, width=9, height=4.7)
    words = []
    for axis, search in zip(panels, ('greedy', 'frugal'), strict=True):
        rule = updated(settings, {'closure.search': search})
        graph = open_graph(thesis.odometry, rule)
        closures = hypotheses(thesis.probabilities, thesis.odometry, rule)
        found = next(closed_graphs(graph, closures, search), None)
        if found is None:
            axis.axis('off')
            axis.set_title(f'{search}: no loop survives')
            continue
        _, pruned, _ = found
        draw_graph(axis, graph, pruned, truth)
        axis.set_title(f'{search}: {len(pruned)} frames, {len(pruned.edges())} edges')
        words.append(f'{search} {len(pruned.edges())} edges')
    return save(
        figure,
        folder,
        '4.18',
        f'greedy_and_frugal_{named}',
        f'Greedy and frugal closures on the same probabilities: {", ".join(words)}; '
        'the thesis had 1115 and 77.',
    )


def draw_graph(axis: Axes, frames: FrameGraph, graph: FrameGraph, truth: _Truth) -> None:
    """Draw ``graph`` on the circle of all ``frames``."""
    stamps = frames.stamps
    angle = 2 * np.pi * np.arange(len(stamps)) / max(len(stamps), 1)
    at = {s: (np.sin(a), np.cos(a)) for s, a in zip(stamps, angle, strict=True)}
    edges = graph.edges()
    many = len(edges) > 3 * len(stamps)
    closures = [e for e in edges if e.probability is not None]
    for some, colour, width in (
        ([e for e in edges if e.probability is None], GREY, 1.0),
        ([e for e in closures if _true(truth, e)], BLUE, 0.4 if many else 1.4),
        ([e for e in closures if not _true(truth, e)], RED, 0.4 if many else 1.4),
    ):
        lines = [(at[e.earlier_ns], at[e.later_ns]) for e in some]
        axis.add_collection(LineCollection(lines, colors=colour, linewidths=width))
    xy = np.array([at[s] for s in stamps]).reshape(-1, 2)
    kept = np.array([s in graph for s in stamps], bool)
    for nodes, colour in ((xy[kept], INK), (xy[~kept], ORANGE)):
        axis.scatter(nodes[:, 0], nodes[:, 1], s=12, c=colour, zorder=3)
    for k in range(0, len(stamps), max(1, len(stamps) // 10)):
        axis.text(1.1 * xy[k, 0], 1.1 * xy[k, 1], str(k), ha='center', va='center', fontsize=8)
    axis.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), aspect='equal')
    axis.axis('off')


def _with_all(runs: Runs, settings: ThesisSettings) -> tuple[FrameGraph, list[FrameEdge]]:
    thesis = runs.thesis
    assert thesis.odometry is not None and thesis.probabilities is not None
    rule = updated(settings, {'closure.search': 'frugal'})
    graph = open_graph(thesis.odometry, rule)
    proposed = hypotheses(thesis.probabilities, thesis.odometry, rule)
    for e in proposed:
        graph.add_closure(e.earlier_ns, e.later_ns, e.probability or 0.0)
    return graph, proposed


def _true(truth: _Truth, edge: FrameEdge) -> bool:
    record = ClosureRecord(edge.earlier_ns, edge.later_ns, edge.probability or 0.0, True, '')
    return bool(is_true(truth, record))
