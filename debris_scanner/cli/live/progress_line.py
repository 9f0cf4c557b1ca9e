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

"""One line of progress: rewritten on a terminal, repeated every few seconds elsewhere."""

import os
import sys
import time
from typing import TextIO

EVERY_S = 5.0
_CODES = {
    'scanning': 36, 'generating': 35, 'tracking': 32, 'lost': 31, 'waiting': 33, 'finishing': 36,
    'finished': 32,
    'OK': 32, 'WARN': 33, 'FAIL': 31, 'SKIP': 2,
}  # fmt: skip


def has_colour(stream: TextIO) -> bool:
    """Whether colours belong there: a terminal that knows them, whose user has not set NO_COLOR."""
    return stream.isatty() and not os.environ.get('NO_COLOR') and os.environ.get('TERM') != 'dumb'


def in_colour(text: str, stream: TextIO) -> str:
    """The text, its first word in that word's colour if it has one."""
    word = text.split(maxsplit=1)[0].rstrip(':') if text.strip() else ''
    if word not in _CODES or not has_colour(stream):
        return text
    return text.replace(word, f'\x1b[{_CODES[word]}m{word}\x1b[0m', 1)


def clipped(text: str, columns: int) -> str:
    """One line of the text, of at most so many characters."""
    line = ' '.join(text.splitlines())
    return line if len(line) <= columns else f'{line[: max(columns - 1, 0)]}…'


class ProgressLine:
    """Writes to stderr, where it does not mix with results."""

    def __init__(self, stream: TextIO = sys.stderr) -> None:
        self._stream = stream
        self._rewrites = stream.isatty()
        self._last_s = -EVERY_S
        self._width = 0
        self._topic = ''

    def show(self, text: str) -> None:
        """Show the current text; one with a new first word, such as the scan's state, is always written."""
        now = time.monotonic()
        topic = text.split(maxsplit=1)[0] if text else ''
        if self._rewrites:
            columns = self._columns()
            line = clipped(text, columns)
            blank = ' ' * (min(self._width, columns) - len(line))  # over the rest of the text before
            self._stream.write(f'\r{in_colour(line, self._stream)}{blank}')
            self._width = len(line)
        elif topic != self._topic or now - self._last_s >= EVERY_S:
            self._stream.write(f'{text}\n')
            self._last_s = now
            self._topic = topic
        else:
            return
        self._stream.flush()

    def end(self) -> None:
        """Leave the last text standing."""
        if self._rewrites and self._width:
            self._stream.write('\n')
            self._stream.flush()
        self._width, self._last_s = 0, -EVERY_S

    def _columns(self) -> int:
        """Width of the terminal now, less the column in which some terminals wrap."""
        try:
            columns = os.get_terminal_size(self._stream.fileno()).columns
        except (OSError, ValueError, AttributeError):  # a stream that is no file, too
            columns = 0
        return (columns or 80) - 1
