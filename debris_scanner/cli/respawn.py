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

"""Nodes that were killed or crashed are started anew; they go on from their journals."""

import sys
import time
from collections import deque
from collections.abc import Iterable

from debris_scanner.cli.children import BAD_INPUT, Children
from debris_scanner.cli.shared_memory import leaked_segments

MOST, WINDOW_S = 5, 60.0  # a node that dies more often than this will not live
CALM_S = 5.0  # the node that has come back needs the processor more than the next one that stands by


class Respawn:
    """Looks after the stages of a scan.

    Args:
        children: their processes.
        stages: their names.
    """

    def __init__(self, children: Children, stages: Iterable[str]) -> None:
        self._children = children
        self._deaths: dict[str, deque[float]] = {stage: deque() for stage in stages}
        self._stand_by_s = float('inf')  # when

    def begin(self) -> None:
        """The nodes are up: let another process stand by."""
        if self._deaths:
            self._stand_by_s = time.monotonic()

    def look(self) -> list[str]:
        """Start those anew that have ended and should not have; their names.

        A node that was given something it cannot use, or that dies again and again, is left as it is.
        """
        revived = []
        for stage, deaths in self._deaths.items():
            code = self._children.exit_code(stage)
            if code is None or code == BAD_INPUT:
                continue
            now = time.monotonic()
            while deaths and now - deaths[0] > WINDOW_S:
                deaths.popleft()
            if len(deaths) >= MOST:
                continue
            deaths.append(now)
            how = self._children.last_words(stage)
            self._children.restart(stage)
            _remove_leaks()
            print(f'debris-scan live: {stage} ended ({how}) and was started anew', file=sys.stderr)
            revived.append(stage)
            self._stand_by_s = now + CALM_S
        if time.monotonic() >= self._stand_by_s:
            self._stand_by_s = float('inf')
            self._children.stand_by()
        return revived


def _remove_leaks() -> None:
    """A killed process leaves its shared memory behind, 64 MB each time."""
    for path in leaked_segments():
        try:
            path.unlink(missing_ok=True)
        except OSError:  # somebody else's
            continue
