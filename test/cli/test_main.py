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

"""The command as users meet it: exit codes, one line for what is wrong, instant help."""

import importlib
import os
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import pytest

from debris_scanner import __version__
from debris_scanner.cli import main as cli
from debris_scanner.cli.errors import CliError


@pytest.fixture
def verb(monkeypatch):
    """Installs a verb named `probe` that does what the test says, and runs the command."""

    def run(action, argv=('probe',)):
        module = types.ModuleType('debris_scanner.cli.probe')
        module.add_arguments = lambda parser: parser.add_argument('--size', type=int, default=1)
        module.run = action
        monkeypatch.setitem(sys.modules, 'debris_scanner.cli.probe', module)
        monkeypatch.setitem(cli.VERBS, 'probe', ('probe', 'test verb'))
        return cli.main(argv)

    return run


def raising(error):
    def action(args):
        raise error

    return action


@pytest.mark.parametrize('code', [0, 3])
def test_exit_code_is_the_verbs(verb, code):
    assert verb(lambda args: code) == code


def test_verb_gets_its_options(verb):
    assert verb(lambda args: args.size, ['probe', '--size', '7']) == 7


def test_cli_error_is_one_line_and_exit_code_2(verb, capsys):
    assert verb(raising(CliError('no such\n  thing'))) == 2
    assert capsys.readouterr().err == 'debris-scan probe: no such thing\n'


def test_operating_system_errors_name_the_file(verb, capsys):
    assert verb(lambda args: Path('/nonexistent/file').read_text()) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert '/nonexistent/file' in err


@pytest.mark.parametrize(('module', 'name'), sorted(cli.INPUT_ERRORS))
def test_every_known_input_error_is_reported(verb, capsys, module, name):
    kind = getattr(importlib.import_module(module), name)
    assert verb(raising(type('Special', (kind,), {})('bad thing'))) == 2
    assert capsys.readouterr().err == 'debris-scan probe: bad thing\n'


def test_programming_errors_keep_their_traceback(verb):
    with pytest.raises(ZeroDivisionError):
        verb(lambda args: 1 // 0)


@pytest.mark.parametrize(
    ('argv', 'names'),
    [
        ([], 'VERB'),
        (['nonsense'], "no verb 'nonsense'; verbs are demo, scan, live"),
        (['scna', 'bag'], "did you mean 'scan'?"),
        (['doctor', '--nonsense'], '--nonsense'),
        (['doctor', '--claen'], "no option --claen; did you mean '--clean'?"),
        (['live', '--veiw'], "no option --veiw; did you mean '--view'?"),
        (['live', '--out', 'd', '--track-second=3', '--simulte', 'cubesat'], "did you mean '--simulate'?"),
        (['live', '--driver', 'opnni2'], "did you mean 'openni2'?"),
        (['import'], 'SOURCE'),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(capsys, argv, names):
    with pytest.raises(SystemExit) as ended:
        cli.main(argv)
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert names in err
    assert '--help' in err


@pytest.mark.parametrize(
    ('argv', 'meant'),
    [
        (['live', '--simulate', 'cubesta'], 'cubesat'),
        (['simulate', 'cubesat', '--motion', 'tumbel'], 'tumble'),
        (['simulate', 'cubesat', '--sensor', 'kinekt2'], 'kinect2'),
        (['simulate', 'cubesat', '--clutter', 'wal'], 'wall'),
    ],
)
def test_mistyped_names_of_the_simulation(tmp_path, capsys, argv, meant):
    assert cli.main([*argv, '--out', str(tmp_path / 'out')]) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert f'did you mean {meant!r}?' in err


@pytest.mark.parametrize('name', sorted(cli.VERBS))
def test_every_verb_has_help(capsys, name):
    with pytest.raises(SystemExit) as ended:
        cli.main([name, '--help'])
    assert ended.value.code == 0
    assert f'usage: debris-scan {name}' in capsys.readouterr().out


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(['--version'])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f'debris-scan {__version__}\n'


def test_help_imports_neither_ros_nor_numpy():
    code = (
        'import sys, contextlib\n'
        'from debris_scanner.cli.main import main\n'
        'with contextlib.suppress(SystemExit): main(["--help"])\n'
        'print(sorted({"numpy", "rclpy", "open3d", "numba", "scipy"} & set(sys.modules)))'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == '[]'
    assert all(name in done.stdout for name in cli.VERBS)


@pytest.mark.parametrize(('number', 'word'), [(signal.SIGTERM, 'terminated'), (signal.SIGINT, 'interrupted')])
def test_signals_unwind_the_verb(verb, capsys, number, word):
    unwound = []

    def action(args):
        try:
            os.kill(os.getpid(), number)
            time.sleep(5)
        finally:
            unwound.append(True)

    assert verb(action) == 128 + number
    assert unwound
    assert capsys.readouterr().err == f'debris-scan: {word}\n'


def test_signal_handler_is_put_back(verb):
    before = signal.getsignal(signal.SIGTERM)
    verb(lambda args: 0)
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize('arguments', [['--help'], ['--version'], ['scan', '--help']])
def test_closed_pipe_is_no_error(arguments, monkeypatch):
    monkeypatch.delenv('PYTHONUNBUFFERED', raising=False)  # argparse keeps a failed write to itself
    reader, writer = os.pipe()
    os.close(reader)  # as with `| true`, but surely before the first word is written
    try:
        done = subprocess.run(
            [sys.executable, '-m', 'debris_scanner', *arguments],
            stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    finally:
        os.close(writer)
    assert (done.stderr, done.returncode) == ('', 128 + signal.SIGPIPE)
