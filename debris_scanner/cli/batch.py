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

"""``debris-scan batch INPUT... --out DIR``: many recordings, on all cores or on a Dask cluster."""

import argparse
import sys
from pathlib import Path

from debris_scanner.cli.errors import BAD_INPUT, DONE, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Scan many recordings, each in a process of its own. DIR gets a folder a recording, as scan writes '
        'it, with report.html; batch.csv and batch.parquet, a row a recording; and index.html. The same '
        'command goes on where an earlier one ended: a recording whose content, parameters and program are '
        'unchanged is not scanned again. Exit code 2 if a recording has no result.'
    )
    add = parser.add_argument
    add(
        'inputs',
        nargs='+',
        metavar='INPUT',
        help="bag, folder of bags, glob in quotes, or URL of one, such as 's3://bucket/runs/*.mcap'",
    )
    add('--out', required=True, metavar='DIR', help='folder or URL for the results')
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--workers', type=int, metavar='N', help='processes on this machine (one a core)')
    where.add_argument('--scheduler', metavar='ADDRESS', help='of a Dask cluster, as tcp://host:8786')
    add('--params', type=Path, metavar='FILE', help='parameters, as params/default.yaml')
    add('--retries', type=int, default=1, metavar='N', help='tries more of a recording that fails (1)')
    add('--memory', metavar='SIZE', help="that a worker may take, as 3GB (its share of the machine's)")
    add('--limit', type=float, metavar='S', help='give up a recording after so many seconds')


def run(args: argparse.Namespace) -> int:
    """Run the batch and print the counts."""
    from debris_scanner.batch import check_installed

    check_installed()
    from debris_scanner.batch.engine import Cluster, say
    from debris_scanner.batch.fleet import CSV, INDEX, PARQUET, Batch, run_batch, unfinished

    for option, value, least in (('workers', args.workers, 1), ('retries', args.retries, 0)):
        if value is not None and value < least:
            raise CliError(f'--{option} must be at least {least}, not {value}')
    cluster = Cluster(args.workers, args.scheduler, _bytes(args.memory))
    batch = Batch(
        args.inputs,
        args.out,
        scan_quietly,
        args.params,
        cluster,
        args.retries,
        preload=(__name__, 'debris_scanner.cli.scan', 'debris_scanner.cli.outcome'),
        seconds=args.limit,
    )
    counts = run_batch(batch, say)
    for result, count in sorted(counts.items()):
        print(f'{result.replace("_", " "):18s}{count}')
    for k, name in enumerate((INDEX, CSV, PARQUET)):
        print(f'{"" if k else "files":18s}{args.out.rstrip("/")}/{name}')
    if missing := unfinished(counts):
        print(
            f'debris-scan batch: {missing} of {sum(counts.values())} recordings have no result, see {CSV}',
            file=sys.stderr,
        )
        return BAD_INPUT
    return DONE


def scan_quietly(bag: Path, out: Path, params: Path | None) -> None:
    """Scan as the verb ``scan`` does; what it prints is the recording's log.

    Raises:
        BadRecording: the recording cannot be scanned.
        OSError: a file cannot be read or written: of the machine's, not the recording's making.
    """
    from debris_scanner.batch.recording import BadRecording
    from debris_scanner.cli import scan
    from debris_scanner.cli.main import is_input_error
    from debris_scanner.io.result_files import OutputError

    parser = argparse.ArgumentParser()
    scan.add_arguments(parser)
    given = [] if params is None else ['--params', str(params)]
    try:
        scan.run(parser.parse_args([str(bag), '--out', str(out), *given]))
    except (OSError, OutputError):
        raise
    except Exception as error:
        if not is_input_error(error):
            raise
        told = ' '.join(str(error).split()) or type(error).__name__
        raise BadRecording(told.replace(str(bag.parent) + '/', '')) from error


def _bytes(size: str | None) -> int | None:
    if size is None:
        return None
    from dask.utils import parse_bytes

    try:
        return int(parse_bytes(size))
    except ValueError as error:
        raise CliError(f'--memory {size}: not a size, such as 3GB') from error
