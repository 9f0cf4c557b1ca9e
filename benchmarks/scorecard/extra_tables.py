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

"""Tables of what is found out besides: tracking, the bound of the sensor, which similarity."""

from collections.abc import Sequence

import numpy as np

from benchmarks.scorecard.cases import BOUND, SIMILARITY, TRACKED, TUMBLES
from benchmarks.scorecard.outcome import Scored
from benchmarks.scorecard.similarity import ATTITUDE, MEASURES
from benchmarks.scorecard.tables import Row, markdown, number, values

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
    """Model error and completeness reached, and with true poses, a line a target and kind of motion."""
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
        for path, digits in ((('model_mm', 'median'), 2), (('model_mm', 'rmse'), 2), (('completeness',), 3)):
            line.append(number(_median(values(modelled, 'metrics', *path)), digits))
            line.append(number(_median(values(group, BOUND, *path)), digits))
        lines.append(line)
    figures = ('model median, mm', 'model RMSE, mm', 'completeness')
    titles = [title for figure in figures for title in (figure, 'true poses')]
    return markdown(['target, motion', 'modelled', *titles], lines)


def similarity_table(rows: Sequence[Scored]) -> str | None:
    """Median, least and number of areas under the ROC over the cases, a line a measure, alone and joined."""
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


def _wins(rows: Sequence[Scored], key: str) -> str:
    """In how many cases the measure is the best of its kind, alone or joined; ties count for all."""
    if key == ATTITUDE:
        return ''
    rivals = [
        k
        for k in (*MEASURES, *(f'{m}_joint' for m in MEASURES))
        if k.endswith('_joint') == key.endswith('_joint')
    ]
    best = 0
    for r in rows:
        areas = {k: r.figure(SIMILARITY, 'area', k) for k in rivals}
        known = [a for a in areas.values() if a is not None]
        best += bool(known) and areas[key] == max(known)
    return str(best)


def _median(v: np.ndarray) -> float | None:
    return float(np.median(v)) if len(v) else None


def _least(v: np.ndarray) -> float | None:
    return float(v.min()) if len(v) else None
