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

import errno
import importlib.util
import ipaddress
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import viser

LOOPBACK, PORT = '127.0.0.1', 8080
INSTALL = "pip install 'debris_scanner[view]'"
# A page from elsewhere, open in the same browser, must not talk to a server on this host.
_LOCAL_PAGES = re.compile(r'https?://(127(\.\d+){3}|localhost|\[::1\])(:\d+)?')


class ViewerError(Exception):
    """The view cannot be opened; the message says why and what to do."""


def check_installed() -> None:
    """Check that viser is installed, without importing it.

    Raises:
        ViewerError: it is not.
    """
    if importlib.util.find_spec('viser') is None:
        raise ViewerError(f'the view in a browser needs viser: {INSTALL}')


def open_server(host: str = LOOPBACK, port: int = PORT) -> 'viser.ViserServer':
    """A server without content.

    It serves its page itself and fetches nothing. On a loopback address it is for this host alone, and
    connections that pages of other hosts open through the user's browser are refused. Viser's public tunnel
    is disabled.

    Args:
        host: address to bind.
        port: to bind; 0 takes a free one.

    Raises:
        ViewerError: viser is missing, or the address cannot be bound.
    """
    check_installed()
    import rich
    import viser

    rich.reconfigure(quiet=True)  # viser announces itself on stdout; the caller reports the address
    check_address(host, port)
    with _only_local_pages() if is_loopback(host) else _all_pages():
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


def _taken(host: str, port: int) -> str:
    return f'port {port} of {host} is in use: give another, or 0 for a free one'


@contextmanager
def _only_local_pages() -> Iterator[None]:
    """While the server starts, have websockets check a page's origin, which viser does not request."""
    from websockets.asyncio import server

    original: Any = server.serve
    # None: a client that is no page, which the loopback address guards
    server.serve = partial(original, origins=[None, _LOCAL_PAGES])
    try:
        yield
    finally:
        server.serve = original


@contextmanager
def _all_pages() -> Iterator[None]:
    yield


def _refuse_to_share(verbose: bool = True) -> str | None:
    return None
