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

"""The scorecard's tables as Markdown: classes, failures, every case; then tracking, the sensor's bound (true
poses), and the comparison of similarities.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.real_recordings import REAL
from benchmarks.scorecard.cases import BOUND, SIMILARITY, TRACKED, TUMBLES
from benchmarks.scorecard.outcome import (
    FALSE_REFUSAL,
    FALSE_REJECT,
    OUTCOMES,
    RIGHT,
    WRONG_MODEL,
    Scored,
)
from benchmarks.scorecard.similarity import ATTITUDE, MEASURES
from benchmarks.scorecard.targets import RECORDING
from debris_scanner.sim.sensors import KINECT1

Row = Sequence[str]
Figure = tuple[str, tuple[str, ...], int]  # title, where the figure is in a record, digits

_WRONG = (FALSE_REJECT, FALSE_REFUSAL, WRONG_MODEL)  # the columns of what went wrong

FIGURES: tuple[Figure, ...] = (
    ('attitude median, deg', ('metrics', 'attitude_deg', 'median'), 2),
    ('attitude max, deg', ('metrics', 'attitude_deg', 'max'), 2),
    ('position median, mm', ('metrics', 'position_mm', 'median'), 2),
    ('model RMSE, mm', ('metrics', 'model_mm', 'rmse'), 2),
    ('completeness', ('metrics', 'completeness'), 3),
    ('drift, deg', ('metrics', 'drift', 'deg'), 2),
)
_ATTITUDES = (('attitude_deg', 'median'), ('attitude_untilted_deg', 'median'))
_TRACKING = (
    ('attitude rms, deg', 'attitude_rms_deg', 2),
    ('max, deg', 'attitude_max_deg', 2),
    ('position rms, mm', 'position_rms_mm', 2),
    ('frames', 'frames', 0),
    ('missed', 'missed', 0),
    ('lost', 'lost', 0),
    ('wrong', 'wrong', 0),
    ('re-acquired within, s', 'reacquired_s', 2),
    ('never', 'never_reacquired', 0),
)


def markdown(header: Row, rows: Iterable[Row]) -> str:
    """A Markdown table without empty columns: first column to the left, the others to the right."""
    lines = [[_cell(c) for c in row] for row in rows]
    kept = [k for k in range(len(header)) if not lines or any(line[k] for line in lines)]
    marks = ['---', *['---:'] * (len(header) - 1)]
    chosen = ([row[k] for k in kept] for row in (header, marks, *lines))
    return '\n'.join('| ' + ' | '.join(row) + ' |' for row in chosen) + '\n'


def number(value: float | None, digits: int = 2) -> str:
    """The figure, or a dash where there is none."""
    return '-' if value is None or not np.isfinite(value) else f'{value:.{digits}f}'


def values(rows: Iterable[Scored], *path: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A figure of all rows that have it."""
    found = [row.figure(*path) for row in rows]
    return np.array([v for v in found if v is not None], np.float64)


def group_table(rows: Sequence[Scored]) -> str:
    """One line for each class of targets: outcomes, and median / worst figures of the published models."""
    groups: dict[str, list[Scored]] = {}
    for row in rows:
        groups.setdefault(row.case.target.kind, []).append(row)
    lines = [
        [
            kind,
            f'{sum(r.outcome == RIGHT for r in group)}/{len(group)}',
            *(str(sum(r.outcome == o for r in group) or '') for o in _WRONG),
            *(_spread([r for r in group if r.modelled], path, digits) for _, path, digits in FIGURES),
        ]
        for kind, group in groups.items()
    ]
    return markdown(['class', 'right', *_WRONG, *_titles(FIGURES)], lines)


def outcome_line(rows: Sequence[Scored]) -> str:
    """The outcomes counted, in words."""
    counts = [f'{n} {o}' for o in OUTCOMES if (n := sum(r.outcome == o for r in rows))]
    return f'{len(rows)} cases: {", ".join(counts)}'


def failure_table(rows: Sequence[Scored]) -> str:
    """Every case that is not right, the worst kind first; of a refusal the reason without its figures."""
    failed = [r for outcome in reversed(OUTCOMES) for r in rows if r.outcome == outcome != RIGHT]
    refused = (FALSE_REJECT, FALSE_REFUSAL)
    return _cases(
        [replace(r, why=r.why.split(':')[0]) if r.outcome in refused else r for r in failed], FIGURES[:2]
    )


def case_table(rows: Sequence[Scored]) -> str:
    """Every case with its figures."""
    return _cases(rows, FIGURES)


def real_table(rows: Sequence[Scored]) -> str:
    """Every real recording, what a person expects and what came; then simulated spins, by sensor.

    Drift is how far odometry alone turned, over how far the target did; of the spins median and largest.
    """
    lines: list[Row] = []
    for r in rows:
        if r.case.target.kind != RECORDING:
            continue
        real = REAL[r.case.target.name]
        angle, true = r.figure('turned', 'deg'), r.figure('turned', 'true_deg')
        told = [number(angle, 1), number(true, 1), _per_cent([r])]
        errors = [number(r.figure('metrics', 'attitude_deg', k)) for k in ('median', 'max')]
        lines.append([real.name, real.sensor, real.expected, r.outcome, r.why, *told, ' / '.join(errors)])
    spins: dict[str, list[Scored]] = {}
    for r in rows:
        if r.case.target.kind != RECORDING and r.case.motion == 'spin' and r.modelled:
            spins.setdefault(str(r.case.options.get('sensor', KINECT1)), []).append(r)
    for sensor, group in spins.items():
        said = f'{len(group)} simulated spins'
        spread = _spread(group, ('metrics', 'attitude_deg', 'median'), 2)
        lines.append([said, sensor, 'models', RIGHT, '', '', '', _per_cent(group), spread])
    header = ['recording', 'sensor', 'expected', 'outcome', 'why', 'turned, deg', 'of', 'drift, %']
    return markdown([*header, 'attitude, deg'], lines)


def _per_cent(group: Sequence[Scored]) -> str:
    """Drift of odometry, per cent of the turn; of several the median and the largest."""
    shares = [
        100 * (angle / true - 1)
        for r in group
        if (angle := r.figure('turned', 'deg')) is not None and (true := r.figure('turned', 'true_deg'))
    ]
    if len(shares) > 1:
        return f'{number(float(np.median(shares)), 1)} / {number(max(shares, key=abs), 1)}'
    return number(shares[0], 1) if shares else '-'


def tracking_table(rows: Sequence[Scored]) -> str | None:
    """One line a tracking case; None without any."""
    own = [r for r in rows if r.case.motion in TRACKED]
    if not own:
        return None
    return markdown(
        ['case', *(title for title, _, _ in _TRACKING)],
        [[r.case.name, *(number(r.figure('tracking', k), d) for _, k, d in _TRACKING)] for r in own],
    )


def bound_table(rows: Sequence[Scored]) -> str | None:
    """Model error and completeness, reached and with true poses; a line for each target and motion."""
    groups: dict[str, list[Scored]] = {}
    for r in rows:
        if r.case.may_be_modelled and r.record.get(BOUND):
            motion = 'tumbles' if r.case.motion in TUMBLES else 'spins'
            condition = r.case.condition if r.case.condition in ('mli', 'correlated') else ''
            groups.setdefault(f'{r.case.target.name}, {motion} {condition}'.strip(), []).append(r)
    if not groups:
        return None
    lines: list[Row] = []
    for title, group in groups.items():
        modelled = [r for r in group if r.modelled]
        line = [title, f'{len(modelled)}/{len(group)}']
        for path, digits in ((('model_mm', 'rmse'), 2), (('completeness',), 3)):
            line.append(number(_median(values(modelled, 'metrics', *path)), digits))
            line.append(number(_median(values(group, BOUND, *path)), digits))
        lines.append(line)
    figures = ('model RMSE, mm', 'completeness')
    titles = [title for figure in figures for title in (figure, 'true poses')]
    return markdown(['target, motion', 'modelled', *titles], lines)


def sensor_table(rows: Sequence[Scored]) -> str | None:
    """One line for each other sensor and size: verdicts, attitudes, model errors over the bound's."""
    groups: dict[tuple[str, str], list[Scored]] = {}
    for r in rows:
        if 'sensor' in r.case.options:
            size = r.case.options.get('size')
            groups.setdefault((r.case.options['sensor'], f'{size:g} m' if size else ''), []).append(r)
    if not groups:
        return None
    lines: list[Row] = []
    for (sensor, size), group in groups.items():
        modelled = [r for r in group if r.modelled and r.outcome == RIGHT]
        over = [
            found / bound
            for r in modelled
            if (found := r.figure('metrics', 'model_mm', 'rmse')) is not None
            and (bound := r.figure(BOUND, 'model_mm', 'rmse'))
        ]
        line = [sensor, size, f'{sum(r.outcome == RIGHT for r in group)} of {len(group)}']
        line += [str(sum(r.outcome == o for r in group) or '') for o in _WRONG]
        line += [_spread(modelled, ('metrics', *path), 2) for path in _ATTITUDES]
        line.append(f'{np.median(over):.2f} / {max(over):.2f}' if over else '-')
        lines.append(line)
    header = [
        'sensor',
        'size',
        'right',
        *_WRONG,
        'attitude median, deg',
        'without the tilt',
        'RMSE over bound',
    ]
    return markdown(header, lines)


def similarity_table(rows: Sequence[Scored]) -> str | None:
    """Median, least and number of areas under the ROC over the cases, for each measure alone and joined."""
    own = [r for r in rows if r.record.get(SIMILARITY)]
    if not own:
        return None
    groups = {
        'spins': [r for r in own if r.case.motion not in TUMBLES],
        'tumbles': [r for r in own if r.case.motion in TUMBLES],
        'all': own,
    }
    lines: list[Row] = []
    measures = {**MEASURES, ATTITUDE: 'attitude'}
    measures |= {f'{k}_joint': f'{name}, joined with the attitude' for k, name in MEASURES.items()}
    for key, name in measures.items():
        areas = {title: values(group, SIMILARITY, 'area', key) for title, group in groups.items()}
        lines.append(
            [
                name,
                *(f'{number(_median(a), 3)} / {number(_least(a), 3)} ({len(a)})' for a in areas.values()),
                f'{_wins(own, key)}',
            ]
        )
    header = ['similarity', *groups, 'best in']
    return markdown(header, lines)


def _cell(text: str) -> str:
    return ' '.join(text.split()).replace('|', '/')


def _spread(group: Sequence[Scored], path: tuple[str, ...], digits: int) -> str:
    v = values(group, *path)
    if not len(v):
        return '-'
    worst = v.min() if path[-1] == 'completeness' else v.max()
    return f'{number(float(np.median(v)), digits)} / {number(float(worst), digits)}'


def _titles(figures: Sequence[Figure]) -> list[str]:
    return [title for title, _, _ in figures]


def _cases(rows: Sequence[Scored], figures: Sequence[Figure]) -> str:
    header = ['case', 'outcome', 'why', 'used / read', *_titles(figures)]
    return markdown(header, [_detail(r, figures) for r in rows])


def _detail(row: Scored, figures: Sequence[Figure]) -> Row:
    frames = row.record['scan']['frames'] if 'scan' in row.record else None
    return [
        row.case.name,
        row.outcome,
        row.why,
        f'{frames["used"]}/{frames["read"]}' if frames else '-',
        *(number(row.figure(*path), digits) for _, path, digits in figures),
    ]


def _wins(rows: Sequence[Scored], key: str) -> str:
    """Number of cases in which the measure is the best of its kind, alone or joined; ties count for all."""
    if key == ATTITUDE:
        return ''
    competitors = [
        k
        for k in (*MEASURES, *(f'{m}_joint' for m in MEASURES))
        if k.endswith('_joint') == key.endswith('_joint')
    ]
    best = 0
    for r in rows:
        areas = {k: r.figure(SIMILARITY, 'area', k) for k in competitors}
        known = [a for a in areas.values() if a is not None]
        best += bool(known) and areas[key] == max(known)
    return str(best)


def _median(v: np.ndarray) -> float | None:
    return float(np.median(v)) if len(v) else None


def _least(v: np.ndarray) -> float | None:
    return float(v.min()) if len(v) else None
