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

"""``python -m benchmarks.forecasts``: mass properties and forecasts of scans, judged by what came after.

Each row of the table is a motion, over targets and seeds. Cases in the output file are not run again.
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.forecast_errors import AHEAD_S
from benchmarks.scorecard.cases import Case, all_cases
from benchmarks.scorecard.run_case import run_case
from debris_scanner.io.files import write_atomically
from debris_scanner.sim.motions import DECAYING_SPIN, DZHANIBEKOV, SPIN, SWING, TUMBLE

# Options of the simulator by the name of a row.
MOTIONS: dict[str, dict[str, Any]] = {
    'tumble': {'motion': TUMBLE, 'seconds': 60.0},
    'centre of mass 20 mm off': {
        'motion': TUMBLE,
        'seconds': 60.0,
        'centre_of_mass': (0.012, -0.012, 0.0106),
    },
    'dzhanibekov': {'motion': DZHANIBEKOV, 'seconds': 60.0},
    'spin about x': {'motion': SPIN, 'seconds': 25.0, 'spin_about': 'x'},
    'spin about y': {'motion': SPIN, 'seconds': 25.0, 'spin_about': 'y'},
    'spin about z': {'motion': SPIN, 'seconds': 25.0},
    'decaying spin': {'motion': DECAYING_SPIN, 'seconds': 25.0},
    'damped tumble': {'motion': TUMBLE, 'seconds': 60.0, 'damping_s': 100.0},
    'swinging observer': {'motion': SWING, 'seconds': 25.0},
}
TARGETS = ('shuttle_stack', 'asteroid', 'cubesat', 'defunct_satellite', 'prism')
INSIDE = 0.95

Found = dict[str, dict[str, Any]]


def cases(motions: Sequence[str], targets: Sequence[str], seeds: Sequence[int]) -> Iterator[tuple[str, Case]]:
    """Name and case of each run."""
    known = {c.name: c for c in all_cases()}
    for seed in seeds:
        for motion in motions:
            for target in targets:
                case = replace(known[f'{target}-spin-s0'], seed=seed, options=MOTIONS[motion])
                yield f'{motion}/{target}/{seed}', case


def judged(case: Case) -> dict[str, Any]:
    """Figures of one case."""
    try:
        record = run_case(case)
    except Exception as error:  # the table counts it, and the other cases go on
        return {'error': f'{type(error).__name__}: {error}'}
    return {'reason': record['scan']['reason'], 'forecast': record['forecast'], 'metrics': record['metrics']}


def table(found: Found) -> str:
    """Markdown: a row for each motion."""
    names = ' | '.join(f'{s} s, deg' for s in AHEAD_S)
    lines = [
        f'| motion | forecasts | kinds | ratios, % | axes, deg | momentum, deg | centre, mm | {names} '
        f'| constant rate, 30 s | NEES inside {INSIDE:.0%} |',
        '|---|---|---|---|---|---|---|' + '---|' * (len(AHEAD_S) + 2),
    ]
    for motion in MOTIONS:
        of_motion = [record for key, record in found.items() if key.startswith(f'{motion}/')]
        if of_motion:
            lines.append(f'| {motion} | {" | ".join(_cells(of_motion))} |')
    return '\n'.join(lines)


def _cells(records: Sequence[dict[str, Any]]) -> Iterator[str]:
    figures = [r['forecast'] for r in records if r.get('forecast')]
    yield f'{len(figures)} of {len(records)}'
    kinds = [f['why'] for f in figures]
    yield ', '.join(f'{kinds.count(k)} {k}' for k in sorted(set(kinds)))
    known = [f for f in figures if 'ratio_errors' in f]
    yield _spread([100 * max(map(abs, f['ratio_errors'])) for f in known])
    for key in ('axes_deg', 'momentum_deg', 'centre_mm'):
        yield _spread([f[key] for f in known])
    ahead = [f['ahead'] for f in figures]
    for k in range(len(AHEAD_S)):
        yield _spread([a[k]['attitude_deg'] for a in ahead])
    yield _spread([a[1]['constant_rate_deg'] for a in ahead])
    bound = chi2.ppf(INSIDE, 3)
    inside = [step['nees'] < bound for a in ahead for step in a]
    yield f'{100 * np.mean(inside):.0f} %' if inside else '-'


def _spread(values: Sequence[float]) -> str:
    return f'{np.median(values):.2g} / {np.quantile(values, 0.95):.2g}' if values else '-'


def _seeds(text: str) -> list[int]:
    found: list[int] = []
    for part in text.split(','):
        first, _, last = part.partition('-')
        if not first.isdigit() or (last and not last.isdigit()):
            raise argparse.ArgumentTypeError(f'{text} is no list of seeds: say 7, or 0-2,5')
        found += range(int(first), int(last or first) + 1)
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Exit codes: 0 done, 2 wrong usage."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.forecasts', description=__doc__)
    add = parser.add_argument
    add('--motions', default=','.join(MOTIONS), metavar='LIST', help=f'({", ".join(MOTIONS)})')
    add('--targets', default=','.join(TARGETS), metavar='LIST', help=f'({", ".join(TARGETS)})')
    add('--seeds', type=_seeds, default=range(10), metavar='LIST', help='of each, as 0-2,5 (0-9)')
    add('--jobs', type=int, default=2, metavar='N', help='cases at a time (2)')
    add('--out', type=Path, default=Path('out/forecasts.json'), metavar='FILE', help='(out/forecasts.json)')
    args = parser.parse_args(argv)
    motions, targets = args.motions.split(','), args.targets.split(',')
    if unknown := [m for m in motions if m not in MOTIONS]:
        print(f'forecasts: there is no motion {", ".join(unknown)}', file=sys.stderr)
        return 2
    if unknown := [t for t in targets if f'{t}-spin-s0' not in {c.name for c in all_cases()}]:
        print(f'forecasts: there is no target {", ".join(unknown)}', file=sys.stderr)
        return 2
    found: Found = json.loads(args.out.read_text()) if args.out.exists() else {}
    os.environ['NUMBA_NUM_THREADS'] = os.environ['OMP_NUM_THREADS'] = '1'
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(args.jobs, mp_context=get_context('spawn')) as pool:
        running = {
            pool.submit(judged, case): key
            for key, case in cases(motions, targets, args.seeds)
            if key not in found
        }
        for n, future in enumerate(as_completed(running), 1):
            found[running[future]] = future.result()
            write_atomically(args.out, json.dumps(found, indent=1).encode())
            print(f'{n} of {len(running)}: {running[future]}', file=sys.stderr, flush=True)
    print(table(found))
    return 0


if __name__ == '__main__':
    sys.exit(main())
