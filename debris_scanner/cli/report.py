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

"""``debris-scan report DIR``: shows the result of a scan on one HTML page."""

import argparse
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from debris_scanner.cli.errors import DONE, CliError

if TYPE_CHECKING:
    from debris_scanner.core.results import StampedPose


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Make one HTML page from the results of scan or live in DIR: the verdict and its reason, rates, '
        'drift, closure probabilities and decisions, the pose graph, the path of the sensor, timing, and an '
        'interactive model. The page is a single file and needs no network.'
    )
    parser.add_argument('directory', type=Path, metavar='DIR', help='folder with the results')
    parser.add_argument(
        '--truth', type=Path, metavar='BAG', help='folder of the recording: evaluate, draw the truth too'
    )
    parser.add_argument('--out', type=Path, metavar='FILE', help='the page (DIR/report.html)')
    parser.add_argument('--open', action='store_true', help='open the page in the browser')


def run(args: argparse.Namespace) -> int:
    """Evaluate if a truth is given, read the results, write the page, and print its path."""
    from debris_scanner.cli.evaluate import evaluate_and_print, recorded_frames
    from debris_scanner.io.result_files import REPORT, SUMMARY, complete
    from debris_scanner.io.trajectories import read_tum

    complete(args.directory)
    if not (args.directory / SUMMARY).is_file():
        raise CliError(f'{args.directory} has no {SUMMARY}: not the result of a scan')
    out = args.out or args.directory / REPORT
    if out.is_dir() or not out.parent.is_dir():
        raise CliError(f'cannot write the page to {out}: {"a folder" if out.is_dir() else "no such folder"}')
    true_poses = []
    if args.truth is not None:
        if not (args.truth / 'truth.tum').is_file():
            raise CliError(f'{args.truth} has no truth.tum: not a recording with truth beside it')
        evaluate_and_print(args.directory, args.truth, recorded_frames(args.truth))
        true_poses = read_tum(args.truth / 'truth.tum')
    size = write_report(args.directory, out, true_poses)
    print(f'{"report":24s}{out} ({size / 1e6:.1f} MB)')
    if args.open and not webbrowser.open(out.resolve().as_uri()):
        print(f'debris-scan report: no browser opened {out}: open it by hand', file=sys.stderr)
    return DONE


def write_report(directory: Path, out: Path, true_poses: 'Sequence[StampedPose]' = ()) -> int:
    """Write the page of the scan in ``directory``; returns its size in bytes.

    Raises:
        ScanOutputError: the folder's files cannot be read.
        OSError: the page cannot be written.
    """
    from debris_scanner.io.files import write_atomically
    from debris_scanner.report.page import render
    from debris_scanner.report.scan_output import read_scan
    from debris_scanner.report.truth import Truth

    scan = read_scan(directory)
    page = render(scan, Truth.of(list(true_poses), scan.poses)).encode()
    write_atomically(out, page)
    return len(page)


def write_page(directory: Path, verb: str) -> None:
    """Write the page of a scan that has just ended; a failure is told, as the scan itself is saved."""
    from debris_scanner.io.result_files import REPORT
    from debris_scanner.report.scan_output import ScanOutputError

    try:
        write_report(directory, directory / REPORT)
    except (ScanOutputError, OSError) as error:
        print(f'debris-scan {verb}: no report: {error}', file=sys.stderr)
