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

"""The tables of docs/scorecard.md, which says what they mean; held-out cases apart."""

from collections import Counter
from collections.abc import Sequence

from benchmarks.real_recordings import REAL
from benchmarks.scorecard.acceptance_criteria import acceptance_table
from benchmarks.scorecard.cases import all_cases
from benchmarks.scorecard.outcome import RIGHT, Scored
from benchmarks.scorecard.tables import (
    bound_table,
    case_table,
    failure_table,
    group_table,
    outcome_line,
    real_table,
    sensor_table,
    similarity_table,
    tracking_table,
)
from benchmarks.scorecard.targets import RECORDING


def summary(rows: Sequence[Scored]) -> str:
    """For a terminal: every case, what true poses reach, then the acceptance criteria."""
    tables = (
        case_table(rows),
        real_table(rows),
        bound_table(rows),
        acceptance_table(rows),
        outcome_line(rows),
    )
    return '\n'.join(t for t in tables if t is not None)


def scorecard(rows: Sequence[Scored], command: str) -> str:
    """All tables.

    Args:
        rows: all cases that have a result.
        command: that leads to these results.
    """
    sources = Counter(str(r.record.get('source')) for r in rows)
    ran = ', '.join(f'{source} ({cases} cases)' for source, cases in sources.most_common())
    parts = [
        f'`{command}`, sources {ran}.\n',
    ]
    for title, chosen in (
        ('Developed on', [r for r in rows if not r.case.held_out]),
        ('Held out', [r for r in rows if r.case.held_out]),
    ):
        if chosen:
            parts += [f'## {title}\n', _extent(chosen), *_section(chosen)]
    return '\n'.join(parts)


def _extent(rows: Sequence[Scored]) -> str:
    matrix = sum(c.held_out == rows[0].case.held_out for c in all_cases())
    done = 'all' if len(rows) == matrix else str(len(rows))
    return f'Of {matrix} cases in the matrix {done} have been run.\n'


def _section(rows: Sequence[Scored]) -> list[str]:
    # the criteria's bounds are those of a Kinect
    of_kinect = [r for r in rows if 'sensor' not in r.case.options]
    parts = [
        outcome_line(rows) + '.\n',
        '### Acceptance criteria: Kinect v1\n',
        outcome_line(of_kinect) + '.\n',
    ]
    parts.append(acceptance_table(of_kinect))
    if any(r.case.target.kind == RECORDING for r in rows):
        parts += ['### Real recordings, beside the simulated ones\n', real_table(rows)]
        if missing := sorted(name for name in REAL if name not in {r.case.target.name for r in rows}):
            parts.append(f'Not at hand: {", ".join(missing)}.\n')
    if (table := sensor_table(rows)) is not None:
        parts += ['### Other sensors and sizes\n', table]
    parts += ['### By class, all sensors\n', group_table(rows)]
    if any(r.outcome != RIGHT for r in rows):
        parts += ['### Failures\n', failure_table(rows)]
    for title, table in (
        ('Tracking', tracking_table(rows)),
        ('Which similarity', similarity_table(rows)),
    ):
        if table is not None:
            parts += [f'### {title}\n', table]
    return parts
