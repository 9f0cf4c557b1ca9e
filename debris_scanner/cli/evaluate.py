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

"""``debris-scan evaluate DIR --truth BAG``: compares the result of a scan with the truth."""

import argparse
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from debris_scanner.cli.errors import DONE, CliError

if TYPE_CHECKING:
    from debris_scanner.core.frames import DepthFrame


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Compare the results of scan or live in DIR with the truth in the folder of BAG '
        '(truth.tum, and truth_mesh.ply or truth_cloud.ply), or in the truth folder that a simulated '
        'camera wrote. Prints a table and writes DIR/metrics.json.'
    )
    parser.add_argument('directory', type=Path, metavar='DIR', help='folder with the results')
    parser.add_argument('--truth', type=Path, required=True, metavar='BAG', help='folder of the recording')
    parser.add_argument('--topic', metavar='T', help='topic that was scanned (default: the most suitable)')


def run(args: argparse.Namespace) -> int:
    """Evaluate, write metrics.json, print the table."""
    # report what is missing before anything is read
    if not (args.directory / 'summary.json').is_file():
        raise CliError(f'{args.directory} has no summary.json: not the result of a scan')
    if not (args.truth / 'truth.tum').is_file():
        raise CliError(f'{args.truth} has no truth.tum: not a recording with truth beside it')
    evaluate_and_print(args.directory, args.truth, _frames(args.truth, args.topic))
    return DONE


def _frames(truth: Path, topic: str | None) -> Iterator['DepthFrame']:
    """The frames of a recording, or of the simulation that left only its truth."""
    from debris_scanner.sim.session import SIMULATION, Simulation, frames_again, read_settings

    if not (truth / SIMULATION).is_file():
        return recorded_frames(truth, topic)
    try:
        return frames_again(Simulation(read_settings(truth)), truth)
    except ValueError as error:
        raise CliError(str(error)) from error


def evaluate_and_print(result_dir: Path, truth_dir: Path, frames: Iterable['DepthFrame']) -> dict[str, Any]:
    """Evaluate a result, write its metrics.json and print the table.

    Args:
        result_dir: what ``scan`` or ``live`` wrote.
        truth_dir: folder with ``truth.tum`` and ``truth_mesh.ply`` or ``truth_cloud.ply``.
        frames: the depth frames that were scanned; they show which part of the surface was visible.

    Returns:
        The content of metrics.json.

    Raises:
        CliError: a file is missing or unreadable.
    """
    from debris_scanner.evaluation.metrics import EvaluationError, evaluate, format_table
    from debris_scanner.io.files import write_atomically
    from debris_scanner.io.result_files import METRICS

    try:
        metrics = evaluate(result_dir, truth_dir, frames)
    except EvaluationError as error:
        raise CliError(str(error)) from error
    write_atomically(result_dir / METRICS, (json.dumps(metrics, indent=2) + '\n').encode())
    print(format_table(metrics))
    print(f'{"metrics":24s}{result_dir / METRICS}')
    return metrics


def recorded_frames(bag: Path, topic: str | None = None) -> Iterator['DepthFrame']:
    """The readable depth frames of a recording, with a progress bar."""
    from tqdm import tqdm

    from msg_adapters.bags import open_session
    from msg_adapters.errors import MalformedMessage

    with open_session(bag, topic) as session:
        for _, frame in tqdm(session, total=session.count, desc='evaluate', unit='frame', disable=None):
            if not isinstance(frame, MalformedMessage):
                yield frame
