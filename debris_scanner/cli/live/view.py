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

"""The browser view of a live scan: started with it, but not required by it."""

import webbrowser
from collections.abc import Callable

from debris_scanner.cli.errors import CliError
from debris_scanner.cli.live.monitor import VIEWER, Monitor
from debris_scanner.cli.live.processes import Children
from debris_scanner.viewer.server import LOOPBACK, TICK_S, ViewerError, check_address, check_installed, linger

SHOW_S = 20.0  # how long the view may take to show the result


def check_view(port: int | None) -> None:
    """Check ``--view PORT`` before any process is started; None: no view.

    Raises:
        CliError: the library is missing, or the port is in use.
    """
    if port is None:
        return
    try:
        check_installed()
        check_address(LOOPBACK, port)
    except ViewerError as error:
        raise CliError(f'--view: {error}') from None


class LiveView:
    """Reports the address of the view once, and its end; the scan continues without it.

    Args:
        children: the processes, among them the viewer.
        opens: open the page in the browser, too.
    """

    def __init__(self, children: Children, opens: bool = False) -> None:
        self._children = children
        self._opens = opens
        self._url = ''
        self._ended = False

    def news(self, monitor: Monitor) -> str:
        """A text to print; usually empty."""
        if self._ended:
            return ''
        if not self._children.running(VIEWER):
            self._ended = True
            return f'{VIEWER} ended ({self._children.last_words(VIEWER)}); the scan continues without it'
        url = monitor.value(VIEWER, 'url')
        if not url or url == self._url:
            return ''
        self._url = url
        opened = self._opens and webbrowser.open(url)
        return f'the scan is shown {"in the browser, " if opened else ""}at {url}'

    def show_result(self, monitor: Monitor) -> None:
        """Have the page show the result, as far as it has been written."""
        if self._runs():
            monitor.show_result(SHOW_S)

    def linger(self, monitor: Monitor, interrupted: Callable[[], bool]) -> None:
        """Keep the page for whoever looks at it, until nobody does any more, or the user interrupts."""

        def watched() -> bool:
            monitor.spin(TICK_S)
            return int(monitor.value(VIEWER, 'clients') or 0) > 0

        linger('debris-scan live', self._url, watched, lambda: interrupted() or not self._runs())

    def _runs(self) -> bool:
        return not self._ended and self._children.running(VIEWER)
