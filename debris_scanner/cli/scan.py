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

"""``debris-scan scan BAG --out DIR``: scans a recorded session offline."""

import argparse
import contextlib
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from debris_scanner.cli.errors import CliError

if TYPE_CHECKING:
    from tqdm import tqdm

    from debris_scanner.cli.live.scan_view import ScanView
    from debris_scanner.interruption import Interruption
    from debris_scanner.scanner import Scanner, Step
    from msg_adapters.bags import BagSession
    from msg_adapters.inputs.decoder import InputOptions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Scan a recording offline: rosbag2 (mcap, sqlite3) or ROS 1 bag, point clouds or depth images '
        'with their camera_info. Writes model, mesh, poses and summary.json into DIR. The same recording '
        'gives the same files, byte for byte. Ctrl-C ends the scan and saves it; a second one saves it '
        'as it is.'
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder or file of the recording')
    parser.add_argument('--out', type=Path, required=True, metavar='DIR', help='folder for the results')
    parser.add_argument('--params', type=Path, metavar='FILE', help='parameters, as params/default.yaml')
    add_model_argument(parser)
    parser.add_argument('--topic', metavar='T', help='input topic (default: the most suitable)')
    add_input_arguments(parser)
    add_view_argument(parser)


def add_view_argument(parser: argparse.ArgumentParser) -> None:
    """The option for the page that shows the scan."""
    parser.add_argument(
        '--view',
        type=_port,
        nargs='?',
        const=8080,
        metavar='PORT',
        help='show the scan in a browser on this machine, at http://127.0.0.1:PORT (8080; 0: a free one)',
    )


def add_input_arguments(parser: argparse.ArgumentParser) -> None:
    """The options for what an input does not say by itself."""
    from debris_scanner.sensing.cloud_axes import AXES_HELP

    parser.add_argument(
        '--depth-scale',
        type=_scale,
        default=0.0,
        metavar='S',
        help='metres a unit of depth, e.g. 0.00025 (0.001 of 16-bit images, 1 of all else)',
    )
    parser.add_argument(
        '--axes', type=_axes, default='', metavar='A', help=f'of clouds: {AXES_HELP} (default: found out)'
    )


def input_options(args: argparse.Namespace) -> 'InputOptions':
    """What the user says of the input."""
    from msg_adapters.inputs.decoder import InputOptions

    return InputOptions(args.depth_scale, args.axes)


def _scale(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 1000:
        raise argparse.ArgumentTypeError(f'{text} is no number of metres a unit, above 0 and up to 1000')
    return value


def _axes(text: str) -> str:
    from debris_scanner.sensing.cloud_axes import parse_axes

    try:
        _ = parse_axes(text) if text else None  # argparse reads the default, too
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f'{text} is not a port')
    return int(text)


def add_model_argument(parser: argparse.ArgumentParser) -> None:
    """The option for a model that is known beforehand."""
    parser.add_argument(
        '--model',
        type=Path,
        metavar='DIR|MESH',
        help="find and track this model: an earlier scan's output folder, or a mesh in metres",
    )
    parser.add_argument(
        '--extend', action='store_true', help='with --model: add to it what it lacks and this scan shows'
    )


def check_model_arguments(args: argparse.Namespace) -> None:
    """Check that what extends a model has one.

    Raises:
        CliError: it has none.
    """
    if args.extend and args.model is None:
        raise CliError('--extend needs --model: there is nothing to extend')


def run(args: argparse.Namespace) -> int:
    """Scan, write the results, and print the outcome."""
    from debris_scanner.cli.outcome import report_outcome
    from debris_scanner.core.parameters import load
    from debris_scanner.core.results import INTERRUPTED
    from debris_scanner.interruption import Interruption
    from debris_scanner.io.known_models import read_known_model
    from debris_scanner.io.result_files import claim
    from debris_scanner.scanner import Scanner
    from debris_scanner.settings import Settings
    from msg_adapters.bags import open_session

    start = time.perf_counter()
    check_model_arguments(args)
    with contextlib.ExitStack() as stack:
        stack.enter_context(claim(args.out))
        settings = load(Settings(), args.params) if args.params else Settings()
        model = None if args.model is None else read_known_model(args.model)
        session = stack.enter_context(open_session(args.bag, args.topic, input_options(args)))
        view = None
        if args.view is not None:
            from debris_scanner.cli.live.scan_view import ScanView

            view = ScanView(args.view, args.out)
            stack.callback(view.close)
        interruption = stack.enter_context(Interruption())
        scanner = Scanner(settings, model=model, extend=args.extend)
        _scan(scanner, session, interruption, view)
        for warning in filter(None, [*session.warnings, *scanner.warnings]):
            print(f'debris-scan scan: warning: {warning}', file=sys.stderr)
        session.read_sensor_odometry(scanner.sensor_path)
        try:
            result = scanner.finish(INTERRUPTED if interruption.requested else None, _Progress(view))
        except KeyboardInterrupt:  # a second Ctrl-C: what was gathered is saved as it is
            result = scanner.result_so_far()
        if unused := (result.mass_properties or {}).get('odometry_unused'):
            print(f'debris-scan scan: warning: {unused}: it is not used', file=sys.stderr)
        result.wall_s = time.perf_counter() - start
        folder = result.save(args.out)
        code = report_outcome(args.out, folder, 'scan', result.why)
        if view is not None:
            from debris_scanner.cli.report import write_page

            write_page(folder, 'scan')
            view.conclude(scanner.last_attempt, folder)
            view.linger(interruption)
    return code


def _scan(
    scanner: 'Scanner', session: 'BagSession', interruption: 'Interruption', view: 'ScanView | None' = None
) -> None:
    """Show a scanner all frames of the session, or those before the interruption."""
    from tqdm import tqdm

    from msg_adapters.errors import MalformedMessage

    closures, warned = 0, False
    with tqdm(total=session.count, desc='scan', unit='frame', disable=None) as bar:
        for _, frame in session:
            if isinstance(frame, MalformedMessage):
                scanner.reject(frame.reason, str(frame))
            else:
                step = scanner.process(frame)
                if scanner.model_warning and not warned:
                    warned = True
                    bar.write(f'debris-scan scan: warning: {scanner.model_warning}', file=sys.stderr)
                closures += sum(c.accepted for c in step.closures)
                _show(bar, scanner, step, closures)
                if view is not None:
                    view.show(frame, step, scanner)
            bar.update()
            if interruption.requested:
                break


def _show(bar: 'tqdm', scanner: 'Scanner', step: 'Step', closures: int) -> None:
    """Show state, key frames and closures beside the bar; a generation in a line of its own."""
    bar.set_postfix_str(
        f'{scanner.state}, {scanner.keyframes} key frames, {closures} closures',
        refresh=False,
    )
    if step.generation is not None and not bar.disable:
        generation = step.generation
        verdict = 'model' if generation.reason is None else generation.reason
        bar.write(f'generated: {verdict}, {generation.why}', file=sys.stderr)


class _Progress:
    """A progress bar for each long step at the end of the scan."""

    def __init__(self, view: 'ScanView | None' = None) -> None:
        self._view = view
        self._bar: tqdm | None = None
        self._what = ''

    def __call__(self, what: str, done: int, total: int) -> None:
        from tqdm import tqdm

        if what != self._what:
            self._what, self._bar = what, tqdm(total=total, desc=what, unit='frame', disable=None)
        assert self._bar is not None
        self._bar.update(done - self._bar.n)
        if self._view is not None:
            self._view.generating(what, done, total)
        if done >= total:
            self._bar.close()
