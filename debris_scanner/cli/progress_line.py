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

import sys
import time
from typing import TextIO

EVERY_S = 5.0


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
            self._stream.write(f'\r{text.ljust(self._width)}')
            self._width = len(text)
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
