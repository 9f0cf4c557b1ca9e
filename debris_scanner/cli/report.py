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
from pathlib import Path

from debris_scanner.cli.errors import DONE, CliError


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


def run(args: argparse.Namespace) -> int:
    """Evaluate if a truth is given, read the results, write the page, and print its path."""
    from debris_scanner.cli.evaluate import evaluate_and_print, recorded_frames
    from debris_scanner.io.files import write_atomically
    from debris_scanner.io.result_files import REPORT, SUMMARY
    from debris_scanner.io.trajectories import read_tum
    from debris_scanner.report.page import render
    from debris_scanner.report.scan_output import read_scan
    from debris_scanner.report.truth import Truth

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
    scan = read_scan(args.directory)
    page = render(scan, Truth.of(true_poses, scan.poses)).encode()
    write_atomically(out, page)
    print(f'{"report":24s}{out} ({len(page) / 1e6:.1f} MB)')
    return DONE
