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

"""``debris-scan reproduce --out DIR``: the thesis's experiments, with its method and ours."""

import argparse
from pathlib import Path

from debris_scanner.cli.errors import DONE, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        "Simulate the thesis's experiments and run odometry alone, the thesis's method and ours on each. "
        'Writes table.md, table.json, index.html and the figures into DIR. Finished experiments are not run '
        'again; interrupted ones start over. Takes about ten minutes on two cores.'
    )
    add = parser.add_argument
    add('--out', type=Path, required=True, metavar='DIR', help='folder for the results')
    add('--experiments', default='1,2,3,cw', metavar='LIST', help='which to run, of 1,2,3,cw (all)')
    add('--quick', action='store_true', help='short sequences, to check that it runs')
    add('--jobs', type=int, default=2, metavar='N', help='experiments in parallel (2)')


def run(args: argparse.Namespace) -> int:
    """Run the unfinished experiments, then write the table of all requested ones."""
    from debris_scanner.io.result_files import check_output_dir
    from debris_scanner.research.reproduce.experiments import EXPERIMENTS
    from debris_scanner.research.reproduce.run import finished
    from debris_scanner.research.reproduce.tables import INDEX, TABLE_MD, lines, write_tables

    wanted = [k.strip() for k in args.experiments.split(',') if k.strip()]
    unknown = [k for k in wanted if k not in EXPERIMENTS]
    if unknown or not wanted:
        raise CliError(f'no experiment {", ".join(unknown) or "named"}: choose of {", ".join(EXPERIMENTS)}')
    if args.jobs < 1:
        raise CliError(f'--jobs must be at least 1, not {args.jobs}')
    keys = [k for k in EXPERIMENTS if k in wanted]
    check_output_dir(args.out)
    missing = [k for k in keys if finished(EXPERIMENTS[k], args.out, args.quick) is None]
    if missing:
        _run(missing, args)
    done = {k: finished(EXPERIMENTS[k], args.out, args.quick) or {} for k in keys}
    write_tables(args.out, done, args.quick)
    print(_aligned(lines(done)))
    print(f'{"table":24s}{args.out / TABLE_MD}\n{"figures":24s}{args.out / INDEX}')
    return DONE


def _run(keys: list[str], args: argparse.Namespace) -> None:
    from debris_scanner.batch import check_installed

    check_installed()
    from debris_scanner.research.reproduce.tasks import ReproduceError, run_experiments

    try:
        run_experiments(keys, args.out, args.quick, args.jobs)
    except ReproduceError as error:
        raise CliError(str(error)) from error


def _aligned(table: list[list[str]]) -> str:
    width = [max(len(row[k]) for row in table) for k in range(len(table[0]))]
    return '\n'.join('  '.join(c.ljust(w) for c, w in zip(row, width, strict=True)).rstrip() for row in table)
