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

"""Ctrl-C and SIGTERM as a request, instead of an exception at any point."""

import signal
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Context in which the first signal only sets ``requested``; the second one raises as usual.

    The flag is checked where all is consistent: a scan that is aborted within a frame cannot be finished, and
    an exception in some library's clean-up is lost.
    """

    def __init__(self) -> None:
        self.requested = False
        self._number: int | None = None
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> 'Interruption':
        for number in SIGNALS:
            try:
                self._previous[number] = signal.signal(number, self._ask)
            except ValueError:  # not the main thread
                return self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def act(self) -> None:
        """Do what a signal that came would have done at once, such as to raise KeyboardInterrupt."""
        number, self._number = self._number, None
        if number is not None:
            signal.raise_signal(number)

    def _ask(self, number: int, _frame: FrameType | None) -> None:
        self.requested, self._number = True, number
        self._restore()  # the second signal ends the process at once

    def _restore(self) -> None:
        while self._previous:
            signal.signal(*self._previous.popitem())
