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

"""The scorecard as Markdown: groups, failures, the worst, every case."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.scorecard.outcome import HONEST_NO, OUTCOMES, RIGHT, WRONG_MODEL, Scored

Row = Sequence[str]

# Title, where the figure is in a record, digits.
FIGURES: tuple[tuple[str, tuple[str, ...], int], ...] = (
    ('attitude median, deg', ('metrics', 'attitude_deg', 'median'), 2),
    ('attitude max, deg', ('metrics', 'attitude_deg', 'max'), 2),
    ('position median, mm', ('metrics', 'position_mm', 'median'), 2),
    ('model RMSE, mm', ('metrics', 'model_mm', 'rmse'), 2),
    ('completeness', ('metrics', 'completeness'), 3),
    ('drift, deg', ('metrics', 'drift', 'deg'), 2),
)
_WORST = 5


def markdown(header: Row, rows: Iterable[Row]) -> str:
    """A Markdown table: first column to the left, the others to the right."""
    marks = ['---', *['---:'] * (len(header) - 1)]
    return '\n'.join('| ' + ' | '.join(_cell(c) for c in row) + ' |' for row in (header, marks, *rows)) + '\n'


def _cell(text: str) -> str:
    return ' '.join(text.split()).replace('|', '/')


def number(value: float | None, digits: int = 2) -> str:
    """The figure, or a dash where there is none."""
    return '-' if value is None or not np.isfinite(value) else f'{value:.{digits}f}'


def values(rows: Iterable[Scored], *path: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A figure of all rows that have it."""
    found = [row.figure(*path) for row in rows]
    return np.array([v for v in found if v is not None], np.float64)


def group_table(rows: Sequence[Scored]) -> str:
    """One line a class and motion: outcomes, and median / worst of the figures of the models published."""

    def line(title: str, group: Sequence[Scored]) -> Row:
        right = sum(r.outcome == RIGHT for r in group)
        return [
            title,
            f'{right}/{len(group)}',
            *(str(sum(r.outcome == o for r in group) or '') for o in (HONEST_NO, WRONG_MODEL)),
            *(_spread([r for r in group if r.modelled], path, digits) for _, path, digits in FIGURES),
        ]

    groups: dict[tuple[str, str], list[Scored]] = {}
    for row in rows:
        groups.setdefault(
            (row.case.target.kind, f'{row.case.motion} {row.case.condition}'.strip()), []
        ).append(row)
    kinds = list(dict.fromkeys(kind for kind, _ in groups))
    lines = []
    for kind in kinds:
        every = [r for (k, _), g in groups.items() if k == kind for r in g]
        lines.append(line(f'**{kind}**', every))
        lines += [line(motion, group) for (k, motion), group in groups.items() if k == kind]
    return markdown(['class, motion', 'right', HONEST_NO, WRONG_MODEL, *_titles()], lines)


def _spread(group: Sequence[Scored], path: tuple[str, ...], digits: int) -> str:
    v = values(group, *path)
    if not len(v):
        return '-'
    worst = v.min() if path[-1] == 'completeness' else v.max()
    return f'{number(float(np.median(v)), digits)} / {number(float(worst), digits)}'


def outcome_line(rows: Sequence[Scored]) -> str:
    """The outcomes counted, in words."""
    counts = [f'{n} {o}' for o in OUTCOMES if (n := sum(r.outcome == o for r in rows))]
    return f'{len(rows)} cases: {", ".join(counts)}'


def failure_table(rows: Sequence[Scored]) -> str:
    """Every case that is not right, the worst kind first."""
    failed = [r for outcome in reversed(OUTCOMES) for r in rows if r.outcome == outcome != RIGHT]
    return markdown(['case', 'outcome', 'why', 'used / read', *_titles()], [_detail(r) for r in failed])


def worst_table(rows: Sequence[Scored], how_many: int = _WORST) -> str:
    """The published models that are farthest off, by each figure."""
    lines: list[Row] = []
    for title, path, digits in FIGURES:
        sign = 1 if path[-1] == 'completeness' else -1
        having = [r for r in rows if r.published and r.figure(*path) is not None]
        for r in sorted(having, key=_by(path, sign))[:how_many]:
            lines.append([title, r.case.name, number(r.figure(*path), digits), r.outcome])
    return markdown(['figure', 'case', 'value', 'outcome'], lines)


def _by(path: tuple[str, ...], sign: int) -> Callable[[Scored], float]:
    return lambda row: sign * (row.figure(*path) or 0.0)


def case_table(rows: Sequence[Scored]) -> str:
    """Every case with its figures."""
    return markdown(['case', 'outcome', 'why', 'used / read', *_titles()], [_detail(r) for r in rows])


def _titles() -> list[str]:
    return [title for title, _, _ in FIGURES]


def _detail(row: Scored) -> Row:
    frames = row.record['scan']['frames'] if 'scan' in row.record else None
    return [
        row.case.name,
        row.outcome,
        row.why,
        f'{frames["used"]}/{frames["read"]}' if frames else '-',
        *(number(row.figure(*path), digits) for _, path, digits in FIGURES),
    ]
