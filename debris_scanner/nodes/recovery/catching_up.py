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

"""How a node that was killed makes up for what it missed: from the journals, before it listens again."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sensor_msgs.msg import PointCloud2

from debris_scanner.io.recent_frames import read_recent
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.sensing.normals import NormalSettings
from msg_adapters.target_frames import target_frame_message

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


def forget_journals(folder: Path | None) -> None:
    """Remove what nodes would go on from; those that run begin new files with their reset."""
    for path in [] if folder is None else [*folder.glob('*.journal'), *folder.glob('*.state')]:
        path.unlink(missing_ok=True)


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

    def cancel(self) -> None:
        """Take nothing more: a new scan has begun."""
        if not self.done:
            self.done = True
            self._node.destroy_timer(self._timer)

    def _step(self) -> None:
        if self._node.diagnostics.unmatched and time.monotonic() < self._deadline_s:
            return
        if not self._items:
            self._items.extend(self._read())
        if self._items:
            self._take(self._items.popleft())
            self._taken += 1
            return
        self.cancel()
        self._node.get_logger().info(f'caught up: {self._taken} frames of the outage')


class MissedClouds:
    """Clouds that were sent while a node was away, read from disk for some seconds after its start.

    Args:
        node: that was away.
        folder: of the journals.
        normals: how planes are fitted.
        after_ns: stamp of the last frame that the node has.
        take: called with each cloud and 0, for nobody published it.
    """

    _EVERY_S, _FOR_S = 0.3, 5.0

    def __init__(
        self,
        node: StageNode,
        folder: Path,
        normals: NormalSettings,
        after_ns: int,
        take: Callable[[PointCloud2, int], None],
    ) -> None:
        self._node = node
        self._folder, self._normals, self._after_ns = folder, normals, after_ns
        self._take = take
        self._until_s = time.monotonic() + self._FOR_S
        self._read()
        self._timer = node.create_timer(self._EVERY_S, self._read)

    def _read(self) -> None:
        for frame, frame_id in read_recent(self._folder, self._after_ns, self._normals):
            self._take(target_frame_message(frame, frame_id), 0)
            self._after_ns = frame.stamp_ns
        if time.monotonic() > self._until_s:
            self._node.destroy_timer(self._timer)
