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

"""The acceptance criteria, line by line: the figure reached, its bound, and whether it is met."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill

import numpy as np

from benchmarks.scorecard.cases import TRACKED, TUMBLES, Case
from benchmarks.scorecard.outcome import RIGHT, WRONG_MODEL, Scored
from benchmarks.scorecard.tables import markdown, number, values
from benchmarks.scorecard.targets import CURVED, FLAT, NEAR_AXISYMMETRIC, NOTHING, RECORDING, UNOBSERVABLE

_WIDTH = 110  # of a line of text

# Cases in which no model is possible, line by line.
_IMPOSSIBLE: dict[str, Callable[[Case], bool]] = {
    'cylinder about its axis': lambda c: c.target.kind == UNOBSERVABLE,
    'still target': lambda c: c.motion == 'still' and c.target.kind != NOTHING,
    'empty scene': lambda c: c.target.kind == NOTHING,
    'target that leaves for good': lambda c: c.motion == 'leaves',
}


@dataclass(frozen=True)
class Criterion:
    """One acceptance criterion; ``holds`` is None where no case applies to it."""

    case: str
    what: str
    reached: str
    bound: str
    holds: bool | None
    possible: str = '-'  # what the same fusion reaches with true poses


def acceptance_criteria(rows: Sequence[Scored]) -> list[Criterion]:
    """All criteria over the cases given."""
    usual = [r for r in rows if r.modelled and r.case.condition != 'mli' and r.case.target.kind != RECORDING]
    return [
        *_verdicts(rows),
        *_class(usual, CURVED, (0.3, 0.5), 0.15, 1.0),
        *_class(usual, NEAR_AXISYMMETRIC, (0.3, 0.5), 0.15, 1.0),
        *_class(usual, FLAT, (0.8, 0.8), 0.25, 1.5),
        _bounded(usual, 'completeness', 'each', ('metrics', 'completeness'), 0.97, 3, np.min, least=True),
        *_gaps(rows),
        *_shiny(rows),
        *_no_model(rows),
        *_bunny(rows),
        _bounded(
            usual, 'drift before closure', 'median, deg', ('metrics', 'drift', 'deg'), 1.0, 2, np.median
        ),
        *_tracking(rows),
    ]


def acceptance_table(rows: Sequence[Scored]) -> str:
    """The criteria as Markdown; those without a case are named below."""
    criteria = acceptance_criteria(rows)
    table = markdown(
        ['case', 'figure', 'worst / median, within', 'bound', 'holds', 'true poses'],
        [
            [x.case, x.what, x.reached, x.bound, 'yes' if x.holds else '**no**', x.possible]
            for x in criteria
            if x.holds is not None
        ],
    )
    absent = dict.fromkeys(x.case for x in criteria if x.holds is None)
    if not absent:
        return table
    named = fill(f'Without a case, or with none for some figure: {"; ".join(absent)}.', _WIDTH)
    return f'{table}\n{named}\n'


def _bounded(
    rows: Sequence[Scored],
    case: str,
    what: str,
    path: tuple[str, ...],
    bound: float,
    digits: int,
    of: Callable[..., np.floating],
    least: bool = False,
) -> Criterion:
    """A statistic of a figure over all cases that have it, against an upper or a lower bound."""
    v = values(rows, *path)
    sign = '>=' if least else '<='
    if not len(v):
        return Criterion(case, what, '-', f'{sign} {bound:g}', None)
    reached = float(of(v))
    within = v >= bound if least else v <= bound
    text = f'{number(reached, digits)}'
    if of is not np.median:
        middle = number(float(np.median(v)), digits)
        text = f'{text} / {middle}, {int(within.sum())} of {len(v)}'
    possible = values(rows, 'bound', *path[1:])
    return Criterion(
        case,
        what,
        text,
        f'{sign} {bound:g}',
        reached >= bound if least else reached <= bound,
        number(float(of(possible)), digits) if len(possible) else '-',
    )


def _verdicts(rows: Sequence[Scored]) -> list[Criterion]:
    right = sum(r.outcome == RIGHT for r in rows)
    wrong = sum(r.outcome == WRONG_MODEL for r in rows)
    share = right / len(rows) if rows else 0.0
    return [
        Criterion(
            'verdicts',
            'right',
            f'{share:.1%} ({right} of {len(rows)})',
            '>= 98 %',
            share >= 0.98 if rows else None,
        ),
        Criterion('verdicts', 'wrong models published', str(wrong), '0', wrong == 0 if rows else None),
    ]


def _class(
    rows: Sequence[Scored],
    name: str,
    rmse: tuple[float, float],
    median: float,
    largest: float,
) -> list[Criterion]:
    """Criteria of a class of targets; ``rmse`` in spins and in tumbles, mm; attitudes in degrees."""
    own = [r for r in rows if r.case.target.kind == name]
    spins = [r for r in own if r.case.motion not in TUMBLES]
    tumbles = [r for r in own if r.case.motion in TUMBLES]
    path = ('metrics', 'model_mm', 'rmse')
    return [
        _bounded(spins, name, 'model RMSE in spins, mm', path, rmse[0], 2, np.max),
        _bounded(tumbles, name, 'model RMSE in tumbles, mm', path, rmse[1], 2, np.max),
        _bounded(own, name, 'attitude median, deg', ('metrics', 'attitude_deg', 'median'), median, 2, np.max),
        _bounded(own, name, 'attitude max, deg', ('metrics', 'attitude_deg', 'max'), largest, 2, np.max),
    ]


def _gaps(rows: Sequence[Scored]) -> list[Criterion]:
    """Of the simulator's observable targets all but one are modelled, whatever the seed."""
    lines = []
    for condition, title in (('', 'tumble with gaps'), ('patchy', 'tumble with gaps, patchy')):
        of_targets = [r for r in rows if r.case.motion == 'gaps' and r.case.target.mesh is None]
        own = [r for r in of_targets if r.case.condition == condition]
        if not own:
            lines.append(Criterion(title, 'modelled', '-', '6 of 7', None))
            continue
        seeds = sorted({r.case.seed for r in own})
        counts = [
            (sum(r.modelled for r in own if r.case.seed == s), sum(r.case.seed == s for r in own))
            for s in seeds
        ]
        wrong = sum(r.outcome == WRONG_MODEL for r in own)
        holds = wrong == 0 and all(done >= total - 1 for done, total in counts)
        text = ', '.join(f'{done} of {total}' for done, total in counts) + (
            f', {wrong} wrong' if wrong else ''
        )
        lines.append(Criterion(title, 'modelled, seed by seed', text, '6 of 7', holds))
    return lines


def _shiny(rows: Sequence[Scored]) -> list[Criterion]:
    own = [r for r in rows if r.case.condition == 'mli']
    models = [r for r in own if r.published]
    missed = sorted({r.case.target.name for r in own if not r.modelled})
    wrong = sum(r.outcome == WRONG_MODEL for r in own)
    text = f'{len(models)} of {len(own)}' + (f'; no model of {", ".join(missed)}' if missed else '')
    return [
        _bounded(
            models, 'shiny insulation', 'model RMSE, mm', ('metrics', 'model_mm', 'rmse'), 1.5, 2, np.max
        ),
        Criterion(
            'shiny insulation',
            'modelled',
            text,
            'refused on at most one target',
            wrong == 0 and len(missed) <= 1 if own else None,
        ),
    ]


def _no_model(rows: Sequence[Scored]) -> list[Criterion]:
    lines = []
    for title, chosen in _IMPOSSIBLE.items():
        own = [r for r in rows if chosen(r.case)]
        right = sum(r.outcome == RIGHT for r in own)
        lines.append(
            Criterion(
                title,
                'right reason',
                f'{right} of {len(own)}',
                'every time',
                right == len(own) if own else None,
            )
        )
    return lines


def _bunny(rows: Sequence[Scored]) -> list[Criterion]:
    own = [r for r in rows if r.case.target.name == 'bunny']
    name = 'real bunny recording'
    return [
        _bounded(own, name, 'attitude median, deg', ('metrics', 'attitude_deg', 'median'), 0.6, 2, np.max),
        _bounded(own, name, 'model median, mm', ('metrics', 'model_mm', 'median'), 0.6, 2, np.max),
    ]


def _tracking(rows: Sequence[Scored]) -> list[Criterion]:
    name = 'tracking a tumble'
    own = [r for r in rows if r.case.motion in TRACKED]
    found = [r for r in own if r.record.get('tracking')]
    gaps = [r for r in own if r.case.motion == 'tracking_gaps']
    steady = [r for r in own if r.case.motion == 'tracking']
    at_all = Criterion(
        name,
        'tracked at all',
        f'{len(found)} of {len(own)}',
        'every time',
        len(found) == len(own) if own else None,
    )
    return [
        at_all,
        *(
            _bounded(group, name, what, ('tracking', key), bound, digits, np.max)
            for group, what, key, bound, digits in (
                (own, 'attitude rms, deg', 'attitude_rms_deg', 0.15, 2),
                (own, 'position rms, mm', 'position_rms_mm', 1.0, 2),
                (steady, 'frames lost', 'lost', 0, 0),
                (own, 'accepted estimates more than 5 deg off', 'wrong', 0, 0),
                (gaps, 'gaps after which it was not found again', 'never_reacquired', 0, 0),
                (gaps, 'longest re-acquisition after a gap, s', 'reacquired_s', 1.0, 2),
            )
        ),
    ]
