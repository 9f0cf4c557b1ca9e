"""How a node that was killed makes up for what it missed: from the journals, before it listens again."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from debris_scanner.nodes.parameters import declare
from debris_scanner.nodes.stage import StageNode

_STEP_S = 0.005
_PATIENCE_S = 3.0


def journal_folder(node: StageNode) -> Path | None:
    """The folder that the parameter ``journal_dir`` names; None without one."""
    folder = declare(
        node,
        'journal_dir',
        '',
        'folder for what a killed node goes on from when it is restarted; empty: none',
    )
    return Path(folder) if folder else None


class CatchingUp:
    """Takes what was missed, item by item, once the node's outputs have found their subscribers again.

    Live messages come in between and should be passed over while ``done`` is False: they are among
    what is read.

    Args:
        node: whose outputs are waited for.
        read: what was missed and not taken yet, in order of time.
        take: called with each item.
    """

    def __init__(
        self, node: StageNode, read: Callable[[], Sequence[Any]], take: Callable[[Any], None]
    ) -> None:
        self._node = node
        self._read = read
        self._take = take
        self._items: deque[Any] = deque()
        self._deadline_s = time.monotonic() + _PATIENCE_S
        self._taken = 0
        self.done = False
        self._timer = node.create_timer(_STEP_S, self._step)

    def _step(self) -> None:
        if self._node.diagnostics.unmatched and time.monotonic() < self._deadline_s:
            return
        if not self._items:
            self._items.extend(self._read())
        if self._items:
            self._take(self._items.popleft())
            self._taken += 1
            return
        self.done = True
        self._node.destroy_timer(self._timer)
        self._node.get_logger().info(f'caught up: {self._taken} frames of the outage')
