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

"""``debris-scan merge SCAN... --out DIR``: joins the models of several scans of one object."""

import argparse
import time
from pathlib import Path

from debris_scanner.cli.errors import CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Join scans of one object: scanned twice, laid on another side between, or seen by two cameras. '
        'They are registered without a hint, checked, and fused into one model in the frame of the first. '
        'Scans of two objects, or of one whose placing cannot be told, are refused with the reason.'
    )
    parser.add_argument(
        'scans', type=Path, nargs='+', metavar='SCAN', help='output folder of a scan, or a mesh in metres'
    )
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='folder for the results')
    parser.add_argument('--params', type=Path, metavar='FILE', help='parameters, as params/default.yaml')


def run(args: argparse.Namespace) -> int:
    """Merge, write the results, and print the outcome."""
    from tqdm import tqdm

    from debris_scanner.cli.outcome import report_outcome
    from debris_scanner.core.parameters import load
    from debris_scanner.io.known_models import read_known_model
    from debris_scanner.io.result_files import ScanResult, claim
    from debris_scanner.merging import merge
    from debris_scanner.modelling.placement import MatchSettings
    from debris_scanner.settings import Settings
    from debris_scanner.tracking.gating import STRICT

    start = time.perf_counter()
    if len(args.scans) < 2:
        raise CliError('merge needs at least two scans')
    if any(scan.resolve() == args.out.resolve() for scan in args.scans):
        raise CliError(f'--out {args.out} is one of the scans: their files would be overwritten')
    with claim(args.out):
        settings = load(Settings(), args.params) if args.params else Settings()
        models = [read_known_model(scan) for scan in args.scans]
        bounds = MatchSettings(STRICT * settings.odometry.max_loss, settings.verdict.min_turning_loss)
        with tqdm(desc='merge', unit='step', disable=None) as bar:

            def progress(what: str, done: int, total: int) -> None:
                bar.set_postfix_str(f'{what} {done} of {total}')
                bar.update()

            merged = merge(models, settings.fusion, bounds, progress)
        result = ScanResult(
            merged.reason, merged.model, merged=merged.T_first_scan, why=merged.why, checks=merged.checks
        )
        result.wall_s = time.perf_counter() - start
        return report_outcome(args.out, result.save(args.out), 'merge', result.why)
