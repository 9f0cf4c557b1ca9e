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

"""``debris-scan demo``: a simulated scan by the real nodes, compared with the truth, and a picture of it."""

import argparse
import importlib.util
import os
import sys
from pathlib import Path

from debris_scanner.cli.errors import DONE
from debris_scanner.cli.live import verb as live

TARGET = 'shuttle_stack'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.description = (
        f'Simulate a turning {TARGET} before a depth camera, scan it by the nodes over DDS, close the loop, '
        'model and track it, compare with the truth, and draw the model: no camera and no recording needed. '
        'It takes a minute and a half; the first time it also compiles. Where there is a screen, a page in '
        'the browser shows the scan.'
    )
    parser.add_argument(
        '--out', type=Path, default=Path('out/demo'), metavar='DIR', help='folder for the results (out/demo)'
    )
    parser.add_argument('--no-view', action='store_true', help='open no page in the browser')


def run(args: argparse.Namespace) -> int:
    """Scan as ``live --simulate`` does, then draw; the exit code of the scan."""
    options = ['--simulate', TARGET, '--out', str(args.out)]
    if not args.no_view and has_screen() and importlib.util.find_spec('viser') is not None:
        options += ['--view', '0', '--open']
    parser = argparse.ArgumentParser(prog='debris-scan demo')
    live.add_arguments(parser)
    print(f'debris-scan demo: runs debris-scan live {" ".join(options)}', file=sys.stderr)
    code = live.run(parser.parse_args(options))
    if code == DONE:
        from debris_scanner.report.model_picture import write_picture

        print(f'{"picture":24s}{write_picture(args.out)}')
    return code


def has_screen() -> bool:
    """Whether a browser that is opened has a screen to appear on."""
    return sys.platform == 'darwin' or any(os.environ.get(name) for name in ('DISPLAY', 'WAYLAND_DISPLAY'))
