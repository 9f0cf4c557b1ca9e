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

"""What a reader opens: table.md, table.json and index.html over all experiments that are done."""

import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from debris_scanner.io.files import write_atomically
from debris_scanner.research.reproduce.drawing import Drawn
from debris_scanner.research.reproduce.experiments import DEPARTURES, EXPERIMENTS
from debris_scanner.research.reproduce.heuristic_figures import heuristic_figures
from debris_scanner.research.reproduce.heuristics import Pool, summary
from debris_scanner.research.reproduce.likeness import Likeness
from debris_scanner.research.reproduce.methods import METHOD_NAMES
from debris_scanner.research.reproduce.run import LIKENESS
from debris_scanner.research.reproduce.scores import COLUMNS

TABLE_MD, TABLE_JSON, INDEX = 'table.md', 'table.json', 'index.html'
HEURISTICS = 'heuristics'  # folder of the figures over all experiments

_NOTES = (
    'Drift is the error of the odometry, attitude and target centre, when the target has turned once. '
    'Precision and recall are those of the closures that were accepted: frugal search accepts one by design, '
    'and what it and greedy search would propose stands in table.json. Errors of attitude and model, '
    'completeness and verdict are those of `debris-scan evaluate`. Wall times leave the simulation out; two '
    'experiments run side by side.'
)
_STYLE = (
    'body{font:15px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#222}'
    'table{border-collapse:collapse;font-size:13px}td,th{padding:.2rem .6rem;border-bottom:1px solid #ddd;'
    'text-align:right}td:first-child,td:nth-child(2){text-align:left}figure{margin:2rem 0}img{max-width:100%}'
    'figcaption{max-width:50rem;color:#444}'
)


def write_tables(out: Path, done: Mapping[str, Mapping[str, Any]], quick: bool) -> None:
    """Write table, figures over all experiments, and the index.

    Args:
        out: folder that the experiments' folders are in.
        done: content of experiment.json by key, in order.
        quick: whether the sequences were short.

    Raises:
        OSError: if a file cannot be written.
    """
    shuttles = [k for k in done if EXPERIMENTS[k].simulation.target == 'shuttle_stack'] or list(done)
    likeness = [Likeness.read(out / EXPERIMENTS[k].folder / LIKENESS) for k in shuttles]
    (out / HEURISTICS).mkdir(exist_ok=True)
    pooled = heuristic_figures(likeness, out / HEURISTICS)
    similarities = summary(Pool.of(likeness, late=True), Pool.of(likeness, late=False))
    content = {
        'quick': quick,
        'departures': DEPARTURES,
        'experiments': {k: {n: v for n, v in d.items() if n != 'figures'} for k, d in done.items()},
        'similarities': similarities,
    }
    write_atomically(out / TABLE_JSON, (json.dumps(content, indent=2) + '\n').encode())
    write_atomically(out / TABLE_MD, _markdown(done, similarities, quick).encode())
    write_atomically(out / INDEX, _index(done, pooled, similarities, quick).encode())


def lines(done: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """The table's cells, head first."""
    table = [['experiment', 'method', *COLUMNS.values()]]
    for key, content in done.items():
        for method, row in content['methods'].items():
            table.append([key, METHOD_NAMES[method], *(cell(row[c]) for c in COLUMNS)])
    return table


def cell(value: Any) -> str:
    """A figure as readers see it."""
    if value is None:
        return '–'
    return f'{value:.2f}' if isinstance(value, float) else str(value)


def _similarity_lines(similarities: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    head = ['measure', 'mean', 'sigma', 'entropy, bit', 'area under ROC']
    keys = ('mean', 'sigma', 'entropy_bits', 'roc_area')
    return [head, *([name, *(cell_fine(row[k]) for k in keys)] for name, row in similarities.items())]


def cell_fine(value: float | None) -> str:
    """A probability, with a digit more."""
    return '–' if value is None else f'{value:.3f}'


def _markdown(
    done: Mapping[str, Mapping[str, Any]], similarities: Mapping[str, Mapping[str, Any]], quick: bool
) -> str:
    parts = ["# The thesis's experiments, simulated", '']
    if quick:
        parts += ['Short sequences and coarse clouds (`--quick`): they show that it runs, not how well.', '']
    for key, d in done.items():
        parts.append(
            f'- **{key}** {d["title"]} (section {d["section"]}, {d["preset"]}): {d["frames"]} frames of '
            f'{d["points_a_frame"]} points. Thesis: {d["outcome"]["thesis"]}.'
        )
    parts += ['', *_rows(lines(done)), '', _NOTES, '', *_departures(), '']
    parts += ['## Similarities over pairs of frames', '', *_rows(_similarity_lines(similarities)), '']
    return '\n'.join(parts)


def _departures() -> list[str]:
    return ['Departures from the printed presets:', '', *(f'- `{k}`: {why}' for k, why in DEPARTURES.items())]


def _rows(table: list[list[str]]) -> list[str]:
    head, *body = (f'| {" | ".join(row)} |' for row in table)
    return [head, '|' + '---|' * len(table[0]), *body]


def _index(
    done: Mapping[str, Mapping[str, Any]],
    pooled: list[Drawn],
    similarities: Mapping[str, Mapping[str, Any]],
    quick: bool,
) -> str:
    figures = [(Drawn(**f), EXPERIMENTS[k].folder, k) for k, d in done.items() for f in d['figures']]
    figures += [(d, HEURISTICS, 'all with the shuttle') for d in pooled]
    figures.sort(key=lambda f: (f[0].order, f[1]))
    parts = [
        '<!DOCTYPE html><html lang="en"><meta charset="utf-8">',
        f'<title>The thesis reproduced</title><style>{_STYLE}</style>',
        "<h1>The thesis's experiments, simulated</h1>",
        f'<p>{"Short sequences: they show that it runs, not how well. " if quick else ""}',
        f'{html.escape(_NOTES)}</p>',
        _html_table(lines(done)),
        _html_table(_similarity_lines(similarities)),
    ]
    for drawn, folder, key in figures:
        parts.append(
            f'<figure><img loading="lazy" src="{folder}/{drawn.file}" alt="{html.escape(drawn.caption)}">'
            f'<figcaption><b>Thesis {drawn.number}, experiment {key}.</b> {html.escape(drawn.caption)}'
            '</figcaption></figure>'
        )
    return '\n'.join([*parts, '</html>', ''])


def _html_table(table: list[list[str]]) -> str:
    head, *body = table
    rows = [''.join(f'<th>{html.escape(c)}</th>' for c in head)]
    rows += [''.join(f'<td>{html.escape(c)}</td>' for c in row) for row in body]
    return f'<table>{"".join(f"<tr>{r}</tr>" for r in rows)}</table>'
