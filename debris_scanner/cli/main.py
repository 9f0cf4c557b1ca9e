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

"""``debris-scan VERB``: finds the verb, runs it, and converts errors to one line and an exit code."""

import argparse
import importlib
import os
import re
import signal
import sys
from collections.abc import Iterable, Sequence
from types import FrameType
from typing import Any, NoReturn

from debris_scanner import __version__
from debris_scanner.cli.errors import BAD_INPUT, ROS_REMEDY, CliError
from debris_scanner.kernel_cache import prepare_process

# Verb: its module in this package, and its line in --help. A module is imported only when its verb runs, so
# that help is instant. Each has add_arguments(parser) and run(args) -> exit code.
VERBS: dict[str, tuple[str, str]] = {
    'demo': ('demo', 'scan a simulated target live, and compare with the truth: the first minute'),
    'scan': ('scan', 'scan a recording offline: model, mesh, poses, summary'),
    'live': ('live', 'scan live: start the nodes, and a player or simulator where asked'),
    'batch': ('batch', 'scan many recordings, on all cores or on a cluster'),
    'merge': ('merge', 'join the models of several scans of one object'),
    'import': ('import_depth', 'convert a recording of depth (folders, clouds, videos) to a bag'),
    'simulate': ('simulate', 'record a simulated session and its truth'),
    'evaluate': ('evaluate', 'compare the result of a scan with the truth'),
    'report': ('report', 'make one HTML page of a scan: plots, closures, an interactive model'),
    'reproduce': ('reproduce', "run the thesis's experiments: compare its method with ours"),
    'doctor': ('doctor', 'check Python, ROS, Open3D, middleware and shared memory'),
}

# Errors that mean bad input, as module and class: names, so that a verb imports only what it needs.
INPUT_ERRORS = {
    ('debris_scanner.batch', 'BatchError'),
    ('debris_scanner.io.recordings.recording', 'RecordingError'),
    ('debris_scanner.core.optional', 'MissingLibrary'),
    ('debris_scanner.core.parameters', 'ParameterError'),
    ('debris_scanner.report.scan_output', 'ScanOutputError'),
    ('debris_scanner.io.result_files', 'OutputError'),
    ('debris_scanner.io.mesh_files', 'MeshFileError'),
    ('debris_scanner.io.trajectories', 'TrajectoryFileError'),
    ('msg_adapters.errors', 'BagError'),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code: 0 done, 2 bad input or usage, 3 no model."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    prepare_process()
    previous = _terminate_like_interrupt()
    try:
        try:
            return _run(arguments)
        finally:  # help and version raise SystemExit before their text is flushed
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output has ended (as in `| head`); avoid an error in the interpreter's last flush.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    finally:
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)


def _run(arguments: list[str]) -> int:
    verb = next((a for a in arguments if not a.startswith('-')), None)
    parser = _parser(verb)
    if verb is not None and verb not in VERBS:
        parser.error(f"no verb '{verb}'" + (_meant(verb, VERBS) or f'; verbs are {", ".join(VERBS)}'))
    try:
        args = parser.parse_args(arguments)
        return int(args.run(args))
    except KeyboardInterrupt as interrupt:
        print(f'debris-scan: {str(interrupt) or "interrupted"}', file=sys.stderr)
        return 128 + (signal.SIGTERM if str(interrupt) == 'terminated' else signal.SIGINT)
    except Exception as error:
        remedy = f'; {ROS_REMEDY}' if _is_ros(error) else ''
        if not (remedy or is_input_error(error)):
            raise
        print(f'debris-scan {verb}: {_one_line(error)}{remedy}', file=sys.stderr)
        return BAD_INPUT


def is_input_error(error: Exception) -> bool:
    """Whether an exception is due to bad input, rather than to an error of this program."""
    if isinstance(error, CliError | OSError) and not isinstance(error, BrokenPipeError):
        return True  # such as a missing file, a folder without permission, a full disk
    return any((kind.__module__, kind.__qualname__) in INPUT_ERRORS for kind in type(error).__mro__)


def _is_ros(error: Exception) -> bool:
    """Whether a package of ROS cannot be imported: the environment is not sourced, or has none."""
    name = (error.name or '').partition('.')[0] if isinstance(error, ModuleNotFoundError) else ''
    return name in ('rclpy', 'builtin_interfaces') or name.endswith(('_msgs', '_srvs'))


def _parser(verb: str | None) -> argparse.ArgumentParser:
    parser = _Parser(
        prog='debris-scan',
        description='Scan a rotating object with a depth sensor: close the loop, model it, track it.',
        epilog='Exit codes: 0 done, 2 bad input or usage, 3 no model (the reason on stderr).',
    )
    parser.add_argument('--version', action='version', version=f'debris-scan {__version__}')
    verbs = parser.add_subparsers(title='verbs', dest='verb', metavar='VERB', required=True)
    for name, (module_name, summary) in VERBS.items():
        sub = verbs.add_parser(name, help=summary, description=f'{summary[0].upper()}{summary[1:]}.')
        if name == verb:
            module = importlib.import_module(f'debris_scanner.cli.{module_name}')
            module.add_arguments(sub)
            sub.set_defaults(run=module.run)
    return parser


class _Parser(argparse.ArgumentParser):
    """Reports bad usage in one line, with the name that was probably meant."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Report an unknown option before anything that is missing, as it may be what was meant."""
        options = self._option_string_actions
        for text in args if self._subparsers is None and args is not None else ():
            if text == '--':
                break
            name = text.partition('=')[0]
            if name.startswith('--') and not any(known.startswith(name) for known in options):
                self.error(f'no option {name}{_meant(name, options)}')
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print it in one line, and end with exit code 2."""
        if choice := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)$", message):
            message += _meant(choice[1], re.findall(r"[^', ]+", choice[2]))
        self.exit(BAD_INPUT, f'{self.prog}: {message} (see {self.prog} --help)\n')


def _meant(name: str, known: Iterable[str]) -> str:
    from debris_scanner.core.parameters import did_you_mean

    return did_you_mean(name, known)


def _one_line(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def _terminate_like_interrupt() -> Any:
    """Let SIGTERM unwind like Ctrl-C, so that a verb can save; returns the previous handler."""

    def terminate(_signal: int, _frame: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt('terminated')

    try:
        return signal.signal(signal.SIGTERM, terminate)
    except ValueError:  # not the main thread
        return None


if __name__ == '__main__':
    sys.exit(main())
