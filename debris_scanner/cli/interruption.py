"""Ctrl-C and SIGTERM as a request to end with what was gathered, instead of an exception anywhere."""

import signal
from types import FrameType, TracebackType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Context in which the first signal only sets ``requested``; the second one raises as usual.

    A scan that was torn open in the middle of a frame could not be finished: the flag is looked at
    between frames, where all stages agree with each other.
    """

    def __init__(self) -> None:
        self.requested = False
        self._previous: dict[signal.Signals, Any] = {}

    def __enter__(self) -> 'Interruption':
        for number in SIGNALS:
            try:
                self._previous[number] = signal.signal(number, self._ask)
            except ValueError:  # signals reach the main thread alone
                return self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        self.requested = True
        self._restore()  # whoever asks twice does not want to wait for the end

    def _restore(self) -> None:
        while self._previous:
            signal.signal(*self._previous.popitem())
