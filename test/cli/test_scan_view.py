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

"""``scan --view``: the page of an offline scan, and its end."""

import signal
import socket
import time
from types import SimpleNamespace

import pytest
from scan_runs import run, simulated

from debris_scanner.cli.live.scan_view import ScanView
from debris_scanner.cli.main import main
from debris_scanner.interruption import Interruption


def test_the_page_shows_the_scan_and_its_result(tmp_path, capsys, monkeypatch):
    """A short scan without a model; a stand-in for a browser looks at it."""
    looking = [SimpleNamespace(camera=SimpleNamespace())]
    monkeypatch.setattr('viser.ViserServer.get_clients', lambda self: dict(enumerate(looking)))
    drawn = {}

    class Watched(ScanView):
        def conclude(self, last, written):
            super().conclude(last, written)
            drawn['target'] = len(self._scene._layers['Target now'].drawn)
            drawn['result'] = self._presenter.situation.result
            drawn['turned'] = self._presenter.situation.turned

        def linger(self, interruption):
            looking.clear()  # the browser is closed
            super().linger(interruption)

    monkeypatch.setattr('debris_scanner.cli.live.scan_view.ScanView', Watched)
    bag = simulated(tmp_path / 'bag', 'cubesat', '--seconds', '1')
    assert run(bag, tmp_path / 'out', '--view', '0') == 3
    said = capsys.readouterr().err
    assert 'the scan is shown at http://127.0.0.1:' in said
    assert drawn['target'] == 1
    assert drawn['result']['result'] == 'no_model'
    assert drawn['turned'] > 0.1
    assert (tmp_path / 'out' / 'report.html').is_file()


def test_a_taken_port_is_said_before_the_scan(session_bag, tmp_path, capsys):
    with socket.socket() as other:
        other.bind(('127.0.0.1', 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(['scan', str(session_bag), '--out', str(tmp_path / 'out'), '--view', str(port)]) == 2
    assert f'--view: port {port} of 127.0.0.1 is in use' in capsys.readouterr().err


def test_the_page_stays_while_somebody_looks_and_until_ctrl_c(tmp_path, monkeypatch, capsys):
    view = ScanView(0, tmp_path)
    monkeypatch.setattr(view._server, 'get_clients', lambda: {0: SimpleNamespace()})
    monkeypatch.setattr('time.sleep', lambda _: signal.raise_signal(signal.SIGINT))
    start = time.monotonic()
    with Interruption() as interruption:
        view.linger(interruption)
        assert interruption.requested
    assert time.monotonic() - start < 3
    assert 'the page stays while it is open' in capsys.readouterr().err
    view.close()


@pytest.mark.parametrize('given', ['70000', 'x'])
def test_a_port_that_is_none_is_refused(tmp_path, capsys, given):
    with pytest.raises(SystemExit):
        main(['scan', 'bag', '--out', str(tmp_path), '--view', given])
    assert f'{given} is not a port' in capsys.readouterr().err
