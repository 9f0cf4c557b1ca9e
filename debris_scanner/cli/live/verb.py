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

"""``debris-scan live``: the real nodes as processes over DDS, from the first frame to the saved model."""

import argparse
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from debris_scanner.cli.errors import BAD_INPUT, CliError
from debris_scanner.cli.scan import (
    add_input_arguments,
    add_model_argument,
    add_view_argument,
    check_model_arguments,
)
from debris_scanner.cli.simulate import add_simulation_arguments
from debris_scanner.nodes.inputs.cameras import CAMERAS, remappings_of

if TYPE_CHECKING:
    from debris_scanner.cli.live.source import Source

DRIVERS = ('openni2', 'freenect')
FAILED = 1  # exit code after the crash of a node
TRACK_S = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        'Scan live: start preprocess, odometry, closure and graph as processes connected by DDS. '
        'They scan a bag played in real time, a simulated target, or a camera driver that '
        'publishes points or depth/image_raw. Ctrl-C ends the scan and saves it.'
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument('--bag', type=Path, metavar='BAG', help='play this recording')
    what.add_argument('--simulate', metavar='TARGET', help='simulate a camera in front of this target')
    what.add_argument(
        '--driver', choices=DRIVERS, help='start a driver: openni2 (Xtion, Carmine) or freenect (Kinect v1)'
    )
    add = parser.add_argument
    add('--out', type=Path, required=True, metavar='DIR', help='folder for the results')
    add('--params', type=Path, metavar='FILE', help='parameters, as params/default.yaml')
    add_model_argument(parser)
    add('--composed', action='store_true', help='one process, scanner, instead of four')
    add('--network', action='store_true', help='allow other machines to connect (default: this one only)')
    add(
        '--track-seconds',
        type=_seconds,
        metavar='S',
        help='end S after tracking began (10 when simulating; else at the end of the input)',
    )
    add('--idle-seconds', type=_seconds, metavar='S', help='with a camera: end after S without a frame')
    add('--device', metavar='D', help='of the driver: URI, index, serial number or recording (first found)')
    add(
        '--camera',
        action='append',
        default=[],
        metavar='NAME',
        help=f'the driver that publishes, for its topics: {", ".join(CAMERAS)}; '
        'or, with --driver, a parameter of it as NAME:=VALUE, e.g. fx:=570 or max_rate_hz:=30',
    )
    add('--topic', metavar='T', help='of the bag: topic to play (default: the most suitable)')
    add_input_arguments(parser)
    add('--speed', type=_factor, default=1.0, metavar='F', help='of the bag: times real time (1)')
    add('--loops', type=_count, default=1, metavar='N', help='of the bag: play it N times in a row (1)')
    add_view_argument(parser)
    add('--open', action='store_true', help='with --view: open the page in the browser')
    add(
        '--remap',
        type=_remapping,
        action='append',
        default=[],
        metavar='A:=B',
        help='topic of the driver, e.g. points:=/cam/p',
    )
    add_simulation_arguments(parser.add_argument_group('of the simulation'))


def run(args: argparse.Namespace) -> int:
    """Scan and print the outcome; of a simulation evaluate it, too."""
    from debris_scanner.nodes.lifecycle.middleware import refuse_full

    refuse_full()  # before anything loads ROS
    from debris_scanner.cli.live.processes import ChildFailed, Children
    from debris_scanner.cli.live.source import choose_source
    from debris_scanner.cli.live.supervision import JOURNALS, LiveScan, NodeFiles
    from debris_scanner.cli.live.view import check_view
    from debris_scanner.core.parameters import load
    from debris_scanner.interruption import Interruption
    from debris_scanner.io.known_models import read_known_model
    from debris_scanner.io.result_files import claim, newest_since, summaries
    from debris_scanner.io.scan_journal import make_way
    from debris_scanner.kernel_cache import WITHOUT_COLOUR
    from debris_scanner.settings import Settings

    check_model_arguments(args)
    check_view(args.view)
    settings = load(Settings(), args.params) if args.params else Settings()
    with claim(args.out) as lock:
        if args.model is not None:
            read_known_model(args.model)  # here, for one clear error
        source = choose_source(args)
        if args.simulate is not None and args.track_seconds is None:
            args.track_seconds = TRACK_S
        variables = {} if source.has_colour else {WITHOUT_COLOUR: '1'}
        _prepare(args, source, variables)
        if (unsaved := make_way(args.out / JOURNALS)) is not None:
            print(
                f'debris-scan live: an earlier scan was not saved, its journals are now {unsaved}',
                file=sys.stderr,
            )
        earlier = summaries(args.out)
        with tempfile.TemporaryDirectory() as folder, Interruption() as interruption:
            try:
                with Children(args.out / 'logs', lock, variables) as children:
                    named = [] if source.camera is None else remappings_of(source.camera)
                    files = NodeFiles(Path(folder), settings, [*args.remap, *named])
                    scan = LiveScan(args, source, files, children, interruption)
                    code = scan.run(lambda: _conclude(args, source, newest_since(args.out, earlier)))
            except ChildFailed as failure:
                print(f'debris-scan live: {failure}', file=sys.stderr)
                return BAD_INPUT if failure.code == BAD_INPUT else FAILED
        shutil.rmtree(args.out / JOURNALS, ignore_errors=True)
    return code


def _conclude(args: argparse.Namespace, source: 'Source', folder: Path | None) -> int:
    """Tell the outcome of a scan that is saved in a folder, and for the page write the report.

    Raises:
        CliError: it is not saved.
    """
    from debris_scanner.cli.evaluate import evaluate_and_print
    from debris_scanner.cli.outcome import report_outcome
    from debris_scanner.cli.report import write_page

    if folder is None:
        raise CliError(f'the scan is not saved in {args.out}: {args.out / "logs"} says why')
    code = report_outcome(args.out, folder, 'live')
    truth = source.truth_dir
    if source.simulation is not None and truth is not None and any(truth.glob('*.tum')):
        evaluate_and_print(folder, truth, source.frames())
    if args.view is not None:
        write_page(folder, 'live')
    return code


def _prepare(args: argparse.Namespace, source: 'Source', variables: dict[str, str]) -> None:
    """Set the environment of all processes, and load once, and compile, what each of them would load."""
    from debris_scanner.cli.live.domain import free_domain
    from debris_scanner.nodes.forked import load
    from debris_scanner.nodes.lifecycle.middleware import prepare

    load(variables)  # before a domain is chosen: another scan may choose the same until a node is there
    os.environ.setdefault('ROS_LOG_DIR', str((args.out / 'logs').resolve()))  # not in the home folder
    for remark in prepare(local_only=not args.network, images=False):
        print(f'debris-scan live: {remark}', file=sys.stderr)
    if source.node is not None and not args.network and 'ROS_DOMAIN_ID' not in os.environ:
        os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    print(f'debris-scan live: nodes run on ROS_DOMAIN_ID={domain}', file=sys.stderr)


def _remapping(text: str) -> str:
    name = r'~?/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*'
    if not re.fullmatch(f'{name}:={name}', text, re.ASCII):
        raise argparse.ArgumentTypeError(f'{text} is no remapping, such as points:=/camera/points')
    return text


def _seconds(text: str) -> float:
    return _positive(text, 'a number of seconds')


def _factor(text: str) -> float:
    return _positive(text, 'a factor')


def _count(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) < 10**6:
        raise argparse.ArgumentTypeError(f'{text} is not a number of times')
    return int(text)


def _positive(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f'{text} is not {what} above zero')
    return value
