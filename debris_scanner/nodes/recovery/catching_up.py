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

"""Reads what a restarted node missed from the journals of the other nodes."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sensor_msgs.msg import PointCloud2

from debris_scanner.io.recent_frames import read_recent
from debris_scanner.nodes.lifecycle.parameters import declare_path
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.sensing.normals import NormalSettings
from msg_adapters.target_frames import target_frame_message

_STEP_S = 0.005
_PATIENCE_S = 3.0


def declare_journal(node: StageNode) -> Path | None:
    """Declare the parameter ``journal_dir``; returns its folder."""
    doc = 'journals from which a killed node goes on; empty: none'
    return declare_path(node, 'journal_dir', doc)


def journal_folder(node: StageNode) -> Path | None:
    """The folder that the parameter ``journal_dir`` names; None without one.

    The node goes on from the exceptions that were counted before it was killed.
    """
    folder = declare_journal(node)
    if folder is not None:
        node.faults.remember(folder, node.diagnostics.stage)
    return folder


def forget_journals(folder: Path | None) -> None:
    """Remove all journals; running nodes begin new ones with their reset."""
    for path in [] if folder is None else folder.glob('*'):
        if path.suffix in ('.journal', '.state', '.errors'):
            path.unlink(missing_ok=True)


class CatchingUp:
    """Processes missed items one by one, once the node's outputs have found their subscribers again.

    The node should ignore live messages until ``done``: they are among the items that are read.

    Args:
        node: whose outputs need subscribers.
        read: returns the missed items that have not been processed, in order of time.
        process: called with each item.
    """

    def __init__(
        self, node: StageNode, read: Callable[[], Sequence[Any]], process: Callable[[Any], None]
    ) -> None:
        self._node = node
        self._read = read
        self._process = process
        self._items: deque[Any] = deque()
        self._deadline_s = time.monotonic() + _PATIENCE_S
        self._processed = 0
        self.done = False
        self._timer = node.create_timer(_STEP_S, self._step)

    def cancel(self) -> None:
        """Process nothing more: a new scan has begun."""
        if not self.done:
            self.done = True
            self._node.destroy_timer(self._timer)

    def _step(self) -> None:
        if self._node.diagnostics.unmatched and time.monotonic() < self._deadline_s:
            return
        if not self._items:
            self._items.extend(self._read())
        if self._items:
            self._process(self._items.popleft())
            self._processed += 1
            return
        self.cancel()
        self._node.get_logger().info(f'caught up: {self._processed} frames of the outage')


class MissedClouds:
    """Clouds that were published while a node was down, read from disk for some seconds after its restart.

    Args:
        node: that was restarted.
        folder: of the journals.
        normals: how planes are fitted.
        after_ns: stamp of the last frame that the node has.
        process: called with each cloud, and 0 as its time of publication.
    """

    _EVERY_S, _FOR_S = 0.3, 5.0

    def __init__(
        self,
        node: StageNode,
        folder: Path,
        normals: NormalSettings,
        after_ns: int,
        process: Callable[[PointCloud2, int], None],
    ) -> None:
        self._node = node
        self._folder, self._normals, self._after_ns = folder, normals, after_ns
        self._process = process
        self._until_s = time.monotonic() + self._FOR_S
        self._read()
        self._timer = node.create_timer(self._EVERY_S, self._read)

    def _read(self) -> None:
        for frame, frame_id in read_recent(self._folder, self._after_ns, self._normals):
            self._process(target_frame_message(frame, frame_id), 0)
            self._after_ns = frame.stamp_ns
        if time.monotonic() > self._until_s:
            self._node.destroy_timer(self._timer)
