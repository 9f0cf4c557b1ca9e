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

"""Unexpected exceptions: each costs one frame, one attempt at a model or one figure, never the scan.

A process that ends and starts again meets the same frame, and ends again. So an exception is counted by its
type for summary.json, its traceback is logged once, and the scan goes on without what raised it.
"""

import logging
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from debris_scanner.core.frames import FrameRejected
from debris_scanner.core.optional import MissingLibrary
from debris_scanner.core.results import ERROR


@dataclass
class Contained:
    """How a context of :meth:`Faults.contained` ended: the reason of a frame's rejection, or empty."""

    reason: str = ''
    message: str = ''


class Faults:
    """Counts exceptions by type, and logs the first of each type with its traceback.

    Args:
        log: takes a text; None: the logger of this package.
    """

    def __init__(self, log: Callable[[str], object] | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self._log = log or logging.getLogger('debris_scanner').error
        self._path: Path | None = None  # a line an exception

    def remember(self, folder: Path, stage: str) -> None:
        """Go on from the counts that a killed process of a stage left in a folder, and keep them there."""
        self._path = _noted(folder, stage)
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
        self.counts |= counted(folder, stage)

    def reset(self) -> None:
        """Start a new scan."""
        self.counts.clear()
        if self._path is not None:
            with suppress(OSError):
                self._path.unlink()

    def note(self, error: Exception, lost: str) -> None:
        """Count an exception; ``lost`` names what is left out because of it.

        Raises:
            MissingLibrary: the exception is one: everything would raise it, and its message says what to do.
        """
        if isinstance(error, MissingLibrary):
            raise error
        kind = type(error).__name__
        self.counts[kind] += 1
        if self._path is not None:
            with suppress(OSError), self._path.open('a', encoding='utf-8') as file:  # a full disk
                file.write(f'{kind}\n')
        if self.counts[kind] == 1:
            trace = ''.join(traceback.format_exception(error)).rstrip()
            self._log(f'{lost} is left out, the scan goes on: {described(error)}\n{trace}')

    @contextmanager
    def contained(self, lost: str, rejected: Counter[str] | None = None) -> Iterator[Contained]:
        """Within this context an exception is noted, and what follows it is skipped.

        Args:
            lost: names what is left out.
            rejected: counts frames, by the reason of their :class:`FrameRejected`, or as an error.
        """
        found = Contained()
        try:
            yield found
        except FrameRejected as rejection:
            found.reason, found.message = rejection.reason, str(rejection)
        except Exception as error:
            self.note(error, lost)
            found.reason, found.message = ERROR, described(error)
        if found.reason and rejected is not None:
            rejected[found.reason] += 1


def counted(folder: Path, stage: str) -> Counter[str]:
    """The exceptions of all processes of a stage, by type, as :meth:`Faults.remember` keeps them."""
    try:
        return Counter(_noted(folder, stage).read_text(encoding='utf-8').split())
    except OSError:
        return Counter()


def _noted(folder: Path, stage: str) -> Path:
    return folder / f'{stage}.errors'


def rollback(*objects: object) -> Callable[[], None]:
    """What sets the attributes of objects back to what they are now; what they refer to is not copied."""

    def attributes(item: object) -> list[str]:
        return list(vars(item)) if hasattr(item, '__dict__') else list(getattr(item, '__slots__', ()))

    before = [(item, {name: getattr(item, name) for name in attributes(item)}) for item in objects]

    def restore() -> None:
        for item, values in before:
            for name, value in values.items():
                setattr(item, name, value)

    return restore


def described(error: Exception) -> str:
    """An exception in one line."""
    return ' '.join(f'{type(error).__name__}: {error}'.split())
