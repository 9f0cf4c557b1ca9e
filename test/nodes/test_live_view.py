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

"""``live --view``: the address is said, the page is there, and the scan needs neither."""

import re
import socket
import urllib.request

import pytest
from live_runs import LiveRun

from debris_scanner.cli.main import main


@pytest.mark.ros
@pytest.mark.slow
def test_the_page_is_there_and_its_end_is_not_the_scans(tmp_path):
    brief = ('--range', 1.6, '--spin', 1, '--rate', 6, '--seconds', 7.5)  # a turn of few pixels
    run = LiveRun(tmp_path / 'out', '--simulate', 'shuttle_stack', *brief, '--view', 0)
    run.until_said('the scan is shown at http://127.0.0.1:')
    url = re.search(r'shown at (\S+)', run.errors).group(1)
    with urllib.request.urlopen(url, timeout=30) as page:
        assert page.status == 200
        assert b'<html' in page.read().lower()
    run.until_said('scanning')
    run.kill('viewer')
    run.until_said('viewer ended (signal 9')
    assert run.end() == 0
    assert run.errors.count('viewer ended') == 1
    assert 'was restarted' not in run.errors
    assert run.summary['result'] == 'model'


def test_a_taken_port_is_said_before_anything_starts(tmp_path, capsys):
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        given = ['live', '--simulate', 'cubesat', '--out', str(tmp_path / 'out'), '--view', str(port)]
        assert main(given) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said == [
        f'debris-scan live: --view: port {port} of 127.0.0.1 is in use: give another, or 0 for a free one'
    ]
    assert not (tmp_path / 'out' / 'logs').exists()


def test_a_port_that_is_none_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(['live', '--out', str(tmp_path), '--view', '70000'])
    assert '70000 is not a port' in capsys.readouterr().err
