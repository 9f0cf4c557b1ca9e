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

"""``python -m benchmarks.sensitivity``: each tunable at half and at double its value.

What hangs on the exact value of a number was tuned to the cases it was chosen by. Verdicts should not.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from benchmarks.scorecard.cases import Case, all_cases
from benchmarks.scorecard.outcome import RIGHT, score
from benchmarks.scorecard.run_case import run_case
from debris_scanner.core.parameters import field_of, flatten, updated
from debris_scanner.settings import Settings, tunables

DEFAULT_CASES = 'shuttle_stack-spin-s0,prism-spin-s0,asteroid-spin-d435-s0,cubesat-gaps-s0'
FACTORS = (0.5, 2.0)
DEFAULT_OUT = Path('out/sensitivity.json')

Change = tuple[str, float]  # name of the tunable and factor; ('', 1.0) for none


def changes() -> Iterator[Change]:
    """All that is tried; first of all no change."""
    yield '', 1.0
    for name in tunables():
        for factor in FACTORS:
            yield name, factor


def changed(change: Change) -> Settings:
    """The settings with one tunable changed, within its range."""
    name, factor = change
    settings = Settings()
    if not name:
        return settings
    value, field = flatten(settings)[name], field_of(settings, name)
    new = min(max(value * factor, field.metadata['low']), field.metadata['high'])
    return updated(settings, {name: round(new) if isinstance(value, int) else float(new)})


def outcome_of(case: Case, change: Change) -> str:
    """The outcome of a case with a change."""
    try:
        record = run_case(case, settings=changed(change))
    except Exception as error:  # the table names it, and the other cases go on
        return f'error: {error}'
    return score(case, record).outcome


def table(found: dict[str, dict[str, str]], cases: Sequence[str]) -> str:
    """Markdown: a row for each tunable, what changed at half and at double its value."""
    base = found['*1']
    right = sum(outcome == RIGHT for outcome in base.values())
    lines = [
        f'{right} of {len(cases)} right with no change.\n',
        '| tunable | value | at half | at double |',
        '|---|---|---|---|',
    ]
    values = flatten(Settings())
    for name in tunables():
        cells = []
        for factor in FACTORS:
            outcomes = found.get(f'{name}*{factor:g}', {})
            differ = [f'{c}: {outcomes[c]}' for c in cases if c in outcomes and outcomes[c] != base.get(c)]
            cells.append('; '.join(differ) or ('as before' if outcomes else ''))
        lines.append(f'| `{name}` | {values[name]} | {" | ".join(cells)} |')
    runs = [(k, c) for k in found if k != '*1' for c in found[k]]
    count = sum(found[k][c] != base.get(c) for k, c in runs)
    lines.append(f'\n{count} of {len(runs)} verdicts differ ({100 * count / max(1, len(runs)):.1f} %).')
    return '\n'.join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Exit codes: 0 done, 2 wrong usage."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.sensitivity', description=__doc__)
    parser.add_argument('--cases', default=DEFAULT_CASES, metavar='LIST', help=f'by name ({DEFAULT_CASES})')
    parser.add_argument('--jobs', type=int, default=2, metavar='N', help='cases at a time (2)')
    parser.add_argument('--out', type=Path, default=DEFAULT_OUT, metavar='FILE', help=f'({DEFAULT_OUT})')
    args = parser.parse_args(argv)
    cases = {c.name: c for c in all_cases()}
    wanted = args.cases.split(',')
    if unknown := [name for name in wanted if name not in cases]:
        print(f'sensitivity: there is no case {", ".join(unknown)}', file=sys.stderr)
        return 2
    found: dict[str, dict[str, str]] = json.loads(args.out.read_text()) if args.out.exists() else {}
    os.environ['NUMBA_NUM_THREADS'] = os.environ['OMP_NUM_THREADS'] = '1'
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(args.jobs, mp_context=get_context('spawn')) as pool:
        running = {
            pool.submit(outcome_of, cases[name], change): (f'{change[0]}*{change[1]:g}', name)
            for change in changes()
            for name in wanted
            if name not in found.get(f'{change[0]}*{change[1]:g}', {})
        }
        for n, future in enumerate(as_completed(running), 1):
            key, name = running[future]
            found.setdefault(key, {})[name] = future.result()
            args.out.write_text(json.dumps(found, indent=1))
            print(f'{n} of {len(running)}: {key} {name}: {found[key][name]}', file=sys.stderr, flush=True)
    print(table(found, wanted))
    return 0


if __name__ == '__main__':
    sys.exit(main())
