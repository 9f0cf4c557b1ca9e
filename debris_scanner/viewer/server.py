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

"""The web server of the view: one address and port, with access control."""

import contextlib
import errno
import importlib.util
import ipaddress
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import viser

LOOPBACK, PORT = '127.0.0.1', 8080
TICK_S = 0.2  # between two looks for a browser
UNSEEN_S = 3.0  # without a browser for so long, nobody looks any more
INSTALL = "pip install 'debris_scanner[view]'"
_LOCAL_NAMES = re.compile(r'(127(\.\d+){3}|localhost|\[::1\])(:\d+)?')
FILES = '/files/'
_PAGES = ('/', '/index.html')
_HEADERS = {
    'X-Frame-Options': 'DENY',  # no page may lay ours under its own buttons
    'X-Content-Type-Options': 'nosniff',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Referrer-Policy': 'no-referrer',
}
_BINARY, _TEXT = 'application/octet-stream', 'text/plain; charset=utf-8'
RESULT_FILES = {
    'report.html': 'text/html; charset=utf-8',
    'summary.json': 'application/json',
    'model.ply': _BINARY, 'mesh.ply': _BINARY, 'mesh_closed.ply': _BINARY, 'mesh_closed.stl': _BINARY,
    'mesh.glb': 'model/gltf-binary', 'target_pose.tum': _TEXT, 'rates.csv': 'text/csv',
}  # fmt: skip


class ViewerError(Exception):
    """The view cannot be opened; the message says why and what to do."""


def check_installed() -> None:
    """Check that viser is installed, without importing it.

    Raises:
        ViewerError: it is not.
    """
    if importlib.util.find_spec('viser') is None:
        raise ViewerError(f'the view in a browser needs viser: {INSTALL}')


def open_server(host: str = LOOPBACK, port: int = PORT, results: Path | None = None) -> 'viser.ViserServer':
    """A server without content.

    It serves its page itself and fetches nothing. On a loopback address it is for this host alone, and
    connections that pages of other hosts open through the user's browser are refused. Viser's public tunnel
    is disabled.

    Args:
        host: address to bind.
        port: to bind; 0 takes a free one.
        results: folder whose result files are served under ``/files/``, to this host alone.

    Raises:
        ViewerError: viser is missing, or the address cannot be bound.
    """
    check_installed()
    import rich
    import viser

    rich.reconfigure(quiet=True)  # viser announces itself on stdout; the caller reports the address
    check_address(host, port)
    page = Path(viser.__file__).parent / 'client' / 'build'
    paths = {f'/{path.relative_to(page).as_posix()}' for path in page.rglob('*') if path.is_file()}
    with _our_page(is_loopback(host), paths.union(_PAGES), results):
        server = viser.ViserServer(host, port, label='debris_scanner', verbose=False)
    server.request_share_url = _refuse_to_share
    if port and server.get_port() != port:  # taken between the check and now: viser takes the next
        server.stop()
        raise ViewerError(_taken(host, port))
    return server


def url_of(server: 'viser.ViserServer') -> str:
    """Address for a browser on this host."""
    host = server.get_host()
    here = LOOPBACK if host in ('0.0.0.0', '::', '') else host
    return f'http://{f"[{here}]" if ":" in here else here}:{server.get_port()}'


def result_links(results: Path) -> list[tuple[str, str]]:
    """Address within the page, and name, of each result file that is there."""
    return [(f'{FILES}{name}', name) for name in RESULT_FILES if (results / name).is_file()]


def is_loopback(host: str) -> bool:
    """Whether an address is a loopback address."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_address(host: str, port: int) -> None:
    """Bind the address once: viser tries a thousand ports, and waits for ever on a bad host."""
    try:
        family, kind, number, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, number) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        if isinstance(error, socket.gaierror) or error.errno != errno.EADDRINUSE:
            raise ViewerError(f'cannot listen on {host}:{port}: {error.strerror or error}') from None
        raise ViewerError(_taken(host, port)) from None


def linger(command: str, url: str, watched: Callable[[], bool], over: Callable[[], bool]) -> None:
    """Keep a page for whoever looks at it, until nobody does any more, or Ctrl-C.

    Args:
        command: that shows it.
        url: of the page.
        watched: waits a moment and says whether a browser is connected.
        over: whether there is another reason to end.
    """
    seen_s, said = time.monotonic(), False
    with contextlib.suppress(KeyboardInterrupt):
        while not over() and time.monotonic() - seen_s < UNSEEN_S:
            if not watched():
                continue
            seen_s = time.monotonic()
            if not said:
                said = True
                print(f'{command}: the page stays while it is open, or until Ctrl-C: {url}', file=sys.stderr)


def _taken(host: str, port: int) -> str:
    return f'port {port} of {host} is in use: give another, or 0 for a free one'


@contextmanager
def _our_page(local: bool, paths: Set[str], results: Path | None) -> Iterator[None]:
    """While the server starts: who may connect, and what is served beside viser's page.

    A local server answers only to names of this host, since another name that leads here is a trick of
    another site's. Its buttons are pressed over websockets, so these are for the page's own origin alone.
    """
    from websockets.asyncio import server

    original: Any = server.serve

    def serve(*args: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if local and not _LOCAL_NAMES.fullmatch(request.headers.get('Host', '')):
                return _response(HTTPStatus.FORBIDDEN, b'this address is not of this host', 'text/plain')
            if request.headers.get('Upgrade') is not None:
                if local and not _is_own(request.headers):
                    return _response(HTTPStatus.FORBIDDEN, b'not for pages from elsewhere', 'text/plain')
                return process_request(connection, request)
            path = request.path.partition('?')[0]
            if path.startswith(FILES) and local and results is not None:
                return _result_file(results, path.removeprefix(FILES))
            if path not in paths:  # as it is written: viser would take //, /. and %69ndex.html for its page
                return _response(HTTPStatus.NOT_FOUND, b'no such page', 'text/plain')
            if path not in _PAGES:
                return process_request(connection, request)
            if 'Accept-Encoding' in request.headers:  # its title is put into the plain text
                del request.headers['Accept-Encoding']
            return _titled(process_request(connection, request))

        return original(*args, process_request=answer, process_response=_guarded, **options)

    server.serve = serve
    try:
        yield
    finally:
        server.serve = original


def _is_own(headers: Any) -> bool:
    """Whether a request comes from a page of this server, by whatever name and port the browser knows it."""
    scheme, separator, authority = headers.get('Origin', '').partition('://')
    return bool(separator) and scheme in ('http', 'https') and authority == headers.get('Host', '')


def _guarded(_connection: Any, _request: Any, response: Any) -> Any:
    """Any answer, also one of viser's or a refusal, with what keeps other pages from using it."""
    for name, value in _HEADERS.items():
        if name not in response.headers:
            response.headers[name] = value
    return response


def _result_file(results: Path, name: str) -> Any:
    """One of the result files, by its name alone; the report in a sandbox, as it has scripts."""
    path = results / name
    if name not in RESULT_FILES or path.is_symlink() or not path.is_file():
        return _response(HTTPStatus.NOT_FOUND, b'no such file', 'text/plain')
    return _response(HTTPStatus.OK, path.read_bytes(), RESULT_FILES[name])


def _titled(response: Any) -> Any:
    """Viser's page under our title."""
    body = response.body.replace(b'<title>Viser</title>', b'<title>debris_scanner: live scan</title>', 1)
    del response.headers['Content-Length']
    response.headers['Content-Length'] = str(len(body))
    response.body = body
    return response


def _response(status: HTTPStatus, body: bytes, kind: str) -> Any:
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    headers = Headers()
    headers['Content-Type'] = kind
    headers['Content-Length'] = str(len(body))
    headers['Content-Security-Policy'] = 'sandbox allow-scripts allow-downloads'
    return Response(status.value, status.phrase, headers, body)


def _refuse_to_share(verbose: bool = True) -> str | None:
    return None
