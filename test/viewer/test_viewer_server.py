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

"""Who may reach the page, and what is said of an address that cannot be had."""

import contextlib
import socket
from http.client import HTTPConnection, RemoteDisconnected

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from debris_scanner.viewer import server as viewer_server
from debris_scanner.viewer.server import (
    ViewerError,
    check_address,
    is_loopback,
    open_server,
    result_links,
    url_of,
)


@pytest.fixture(scope='module')
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp('results')
    (folder / 'report.html').write_text('<html>the report</html>')
    (folder / 'secret.txt').write_text('not for the page')
    (folder / 'model.ply').symlink_to(folder / 'secret.txt')
    return folder


@pytest.fixture(scope='module')
def server(results):
    made = open_server(port=0, results=results)
    yield made
    made.stop()


def got(server, path, host=None):
    """Status, headers and body of a path, asked for under the name of a host."""
    connection = HTTPConnection('127.0.0.1', server.get_port(), timeout=20)
    connection.request('GET', path, headers={'Host': host} if host else {})
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read()


def test_result_files_are_served_by_name_in_a_sandbox(server, results):
    status, headers, body = got(server, '/files/report.html')
    assert (status, body) == (200, b'<html>the report</html>')
    assert headers['Content-Security-Policy'].startswith('sandbox')  # no origin: it cannot press buttons
    assert 'allow-same-origin' not in headers['Content-Security-Policy']
    assert headers['Cross-Origin-Resource-Policy'] == 'same-origin'
    assert result_links(results)[0] == ('/files/report.html', 'report.html')


@pytest.mark.parametrize(
    'path', ['/files/secret.txt', '/files/', '/files/../secret.txt', '/files/model.ply', '/files/%2e%2e/x']
)
def test_nothing_else_is_served(server, path):
    assert got(server, path)[0] == 404


@pytest.mark.parametrize(
    ('host', 'may'),
    [
        ('localhost:9000', True),
        ('127.0.0.1', True),
        ('elsewhere.example', False),
        ('127.0.0.1.nip.example', False),
    ],
)
def test_other_names_that_lead_here_are_refused(server, host, may):
    for path in ('/', '/files/report.html'):
        assert (got(server, path, host)[0] == 200) is may


def test_a_sandboxed_page_is_of_no_origin_and_is_refused(server):
    assert not joined(server, 'null')


def test_the_page_has_a_title_and_is_not_framed(server):
    status, headers, body = got(server, '/')
    assert status == 200
    assert b'<title>debris_scanner: live scan</title>' in body
    assert headers['X-Frame-Options'] == 'DENY'
    assert int(headers['Content-Length']) == len(body)


@pytest.mark.parametrize('path', ['//', '/%69ndex.html', '/.', '/./', '/index.html/.', '/assets/..', '/no'])
def test_only_known_paths_are_served_and_no_answer_may_be_framed(server, path):
    status, headers, _ = got(server, path)
    assert status == 404
    assert headers['X-Frame-Options'] == 'DENY'


def test_every_answer_has_the_headers(server):
    for path, host in (
        ('/index.html', None),
        ('/files/report.html', None),
        ('/', 'x.example'),
    ):
        status, headers, _ = got(server, path, host)
        assert status == (403 if host else 200), path
        assert headers['X-Frame-Options'] == 'DENY', path
        assert headers['X-Content-Type-Options'] == 'nosniff'
        assert headers['Cross-Origin-Resource-Policy'] == 'same-origin'
        assert headers['Referrer-Policy'] == 'no-referrer'


def test_nothing_is_posted(server):
    connection = HTTPConnection('127.0.0.1', server.get_port(), timeout=20)
    connection.request('POST', '/', body=b'finish')
    with contextlib.suppress(RemoteDisconnected, ConnectionError):  # nothing but GET is understood
        assert connection.getresponse().status >= 400


def joined(server, origin):
    """Whether a page of that origin gets a connection."""
    address = url_of(server).replace('http', 'ws')
    try:
        with connect(address, origin=origin, subprotocols=['viser-v0']):
            return True
    except InvalidStatus as refusal:
        assert refusal.response.status_code == 403
        return False


def test_listens_on_this_host_alone(server):
    address = url_of(server)
    assert address.startswith('http://127.0.0.1:')
    port = int(address.rpartition(':')[2])
    with socket.socket() as other:
        other.bind(('127.0.0.2', port))  # free, as it is not bound on every address


@pytest.mark.parametrize(
    ('origin', 'may'),
    [
        ('http://{own}', True),
        ('http://127.0.0.1:1', False),  # another server of this host
        ('http://localhost:3000', False),
        (None, False),
        ('http://elsewhere.example', False),
        ('http://localhost.elsewhere.example', False),
        ('https://127.0.0.1.elsewhere.example:8080', False),
    ],
)
def test_pages_from_elsewhere_are_refused(server, origin, may):
    own = url_of(server).removeprefix('http://')
    assert joined(server, origin and origin.format(own=own)) is may


def test_no_client_can_open_the_tunnel_to_the_public(server):
    assert server.request_share_url() is None


def test_a_taken_port_is_said(server):
    port = int(url_of(server).rpartition(':')[2])
    with pytest.raises(ViewerError, match=f'port {port} of 127.0.0.1 is in use'):
        open_server(port=port)


def test_an_address_of_another_host_is_said():
    with pytest.raises(ViewerError, match=r'cannot listen on 192\.0\.2\.1:8080'):
        check_address('192.0.2.1', 8080)
    with pytest.raises(ViewerError, match='cannot listen on no such host:8080'):
        check_address('no such host', 8080)


def test_a_missing_library_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(viewer_server.importlib.util, 'find_spec', lambda name: None)
    with pytest.raises(ViewerError, match=r"needs viser: pip install 'debris_scanner\[view\]'"):
        open_server()


def test_which_addresses_are_of_this_host():
    assert [is_loopback(h) for h in ('127.0.0.1', 'localhost', '::1', '0.0.0.0', '10.0.0.1', 'name')] == [
        True, True, True, False, False, False,
    ]  # fmt: skip
