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

"""``python -m benchmarks.scorecard``: run the cases that are not done yet, print the table, write it down."""

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from benchmarks.performance.report import write_section
from benchmarks.scorecard.cases import EXTRAS, MOTIONS, QUICK, Case, all_cases, in_sample
from benchmarks.scorecard.document import scorecard, summary
from benchmarks.scorecard.outcome import Scored, score
from benchmarks.scorecard.releases import RELEASES, draw, write_release
from benchmarks.scorecard.store import PACKAGES, Store, digest
from benchmarks.scorecard.targets import available, data_folder
from benchmarks.scorecard.tasks import run_cases
from debris_scanner.batch import BatchError, check_installed
from debris_scanner.batch.sources import snapshot
from debris_scanner.io.files import write_atomically

DOCUMENT = Path('docs/scorecard.md')
SECTION = 'tables'  # of the document
DEFAULT_OUT = Path('out/scorecard')

# Options that choose cases, and what of a case they choose by.
_CHOICES: dict[str, Callable[[Case], str]] = {
    'targets': lambda c: c.target.name,
    'motions': lambda c: c.motion,
    'conditions': lambda c: c.condition or 'usual',
    'seeds': lambda c: str(c.seed),
    'cases': lambda c: c.name,
}


def parser() -> argparse.ArgumentParser:
    """The options."""
    p = argparse.ArgumentParser(prog='python -m benchmarks.scorecard', description=__doc__)
    add = p.add_argument
    add('--out', type=Path, default=DEFAULT_OUT, metavar='DIR', help=f'folder of the results ({DEFAULT_OUT})')
    add('--targets', metavar='LIST', help='only these (see --list)')
    add('--motions', metavar='LIST', help=f'only these, of {",".join(MOTIONS)},... (see --list)')
    add('--conditions', metavar='LIST', help='only these, as they stand in the names; "usual" for none')
    add('--seeds', metavar='LIST', help='only these')
    add('--cases', metavar='LIST', help='only these, by name')
    add('--quick', action='store_true', help='only some sixty, all classes, sensors and motions')
    add(
        '--sample',
        action='store_true',
        help='quick ones, each sensor, slow, desks, held out, strangers: two hours',
    )
    add('--held-out', action='store_true', help='only what was kept aside while developing')
    add('--everything', action='store_true', help='held-out cases too')
    add('--list', action='store_true', help='name the cases and end')
    add('--table', action='store_true', help='run nothing: the table of what is there')
    add('--jobs', type=int, default=2, metavar='N', help='cases at a time, one thread each (2)')
    add('--scheduler', metavar='ADDRESS', help='of a Dask cluster that takes the cases, in place of --jobs')
    add('--limit', type=float, default=1200.0, metavar='S', help='give up a case after so long (1200)')
    add('--bound', action='store_true', help='also fuse at the true poses: what the sensor leaves possible')
    add('--similarity', action='store_true', help='also compare the similarities: takes half as long again')
    add('--fresh', action='store_true', help='run again what is done already')
    add('--keep', action='store_true', help='what older sources did counts as done')
    add(
        '--write',
        type=Path,
        nargs='?',
        const=DOCUMENT,
        metavar='FILE',
        help=f'put the tables into the documentation too, below its <!-- {SECTION} --> ({DOCUMENT})',
    )
    add('--release', metavar='VERSION', help=f"keep the results as a version's, in {RELEASES}, and draw all")
    return p


def select(args: argparse.Namespace) -> list[Case]:
    """The cases that the options ask for.

    Raises:
        ValueError: a name that no case has, or nothing left.
    """
    cases = all_cases()
    for option, of in _CHOICES.items():
        if getattr(args, option) is None:
            continue
        wanted = {w.strip() for w in getattr(args, option).split(',') if w.strip()}
        if unknown := wanted - {of(c) for c in all_cases()}:
            raise ValueError(f'--{option}: there is no {", ".join(sorted(unknown))}')
        cases = [c for c in cases if of(c) in wanted]
    if args.quick:
        cases = [c for c in cases if c.name in QUICK]
    if args.sample:
        cases = [c for c in cases if in_sample(c)]
    elif args.held_out:
        cases = [c for c in cases if c.held_out]
    elif not args.everything and args.cases is None:
        cases = [c for c in cases if not c.held_out]
    if not cases:
        raise ValueError('no case is all of that')
    return cases


def main(argv: Sequence[str] | None = None) -> int:
    """Exit codes: 0 done, 1 interrupted or without its cluster, 2 wrong usage."""
    args = parser().parse_args(argv)
    try:
        cases = select(args)
        if args.jobs < 1:
            raise ValueError('--jobs must be at least 1')
    except ValueError as error:
        print(f'scorecard: {error}', file=sys.stderr)
        return 2
    if args.list:
        print('\n'.join(f'{c.name}{"  (held out)" if c.held_out else ""}' for c in cases))
        return 0
    missing = {c.target.name for c in cases if not available(c.target)}
    if missing:
        print(f'scorecard: no data for {", ".join(sorted(missing))} in {data_folder()}', file=sys.stderr)
        cases = [c for c in cases if c.target.name not in missing]
    store, code = Store(args.out), 0
    if not args.table:
        code = _run(args, cases, store)
    scored = _load(cases, store)
    text = scorecard(scored, _command(args))
    write_atomically(args.out / DOCUMENT.name, text.encode())
    print(summary(scored))
    if args.write is not None:
        try:
            write_section(args.write, SECTION, text.strip())
        except (OSError, ValueError) as error:
            print(
                f'scorecard: --write: {error}; the tables are in {args.out / DOCUMENT.name}', file=sys.stderr
            )
            return 2
    if args.release is not None and code == 0:
        try:
            print(write_release(RELEASES, args.release, _command(args), scored), draw(RELEASES))
        except ValueError as error:
            print(f'scorecard: --release: {error}', file=sys.stderr)
            return 2
    return code


def _run(args: argparse.Namespace, cases: Sequence[Case], store: Store) -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does, workers and copy with it
    try:
        check_installed()
        with snapshot(PACKAGES, 'scorecard-') as root:
            source = digest(root)
            wanted = None if args.keep else source
            extras = [name for name in EXTRAS if getattr(args, name)]
            todo = [c for c in cases if args.fresh or not store.done(c, wanted, extras)]
            print(f'scorecard: {len(todo)} of {len(cases)} cases to run, sources {source}', file=sys.stderr)
            save = partial(store.save, source=source)
            run_cases(todo, args.jobs, root, extras, args.limit, save, args.scheduler)
    except KeyboardInterrupt:
        print('scorecard: interrupted; the same command goes on from here', file=sys.stderr)
        return 1
    except BatchError as error:
        print(f'scorecard: {error}', file=sys.stderr)
        return 1
    return 0


def _load(cases: Sequence[Case], store: Store) -> list[Scored]:
    records = [(case, store.load(case)) for case in cases]
    return [score(case, record) for case, record in records if record is not None]


def _command(args: argparse.Namespace) -> str:
    """The command that leads to these results, without what only concerns this machine."""
    words = ['python -m benchmarks.scorecard']
    for name in (*_CHOICES, 'quick', 'sample', 'held_out', 'everything', *EXTRAS):
        value = getattr(args, name)
        if value:
            words.append(f'--{name.replace("_", "-")}' + ('' if value is True else f' {value}'))
    return ' '.join(words)


if __name__ == '__main__':
    sys.exit(main())
