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

"""Reassembles frames and closures from their messages, and distinguishes the messages of different scans.

Status, pose and cloud of a frame travel on separate topics; so do a closure and its evidence. message_filters
is not on PyPI, and its synchronisers drop a frame whose partner is lost, where a scan has to count it.
"""

import time
from collections import deque
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.results import ClosureRecord
from debris_scanner.mapping.closures import Closure
from debris_scanner.nodes.publishing.estimates import FrameStatus, read_estimate
from debris_scanner.tracking.odometry import OdometryEstimate
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import ClosureTransform, read_odometry
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import read_target_frame

NEW, SAME, STALE = 'new', 'same', 'stale'

PATIENCE_S = 2.0  # a message that has not arrived by then is lost
BUSY_PATIENCE_S = 20.0  # the same while there is a queue that it may still be in
MOST_CLOUDS = 300
MOST_POSES = 3000
MOST_HYPOTHESES = 200_000  # that are remembered: those of 600 key frames

# A reset that arrives so soon after a new scan was detected is the one that began it.
_SAME_RESET_S = 3.0


class ScanIdentity:
    """Identifies scans by the stamp of their first key frame, which every status carries."""

    def __init__(self) -> None:
        self._scan_ns: int | None = None
        self._stale_ns: int | None = None
        self._began_s = float('-inf')

    def of(self, scan_ns: int) -> str:
        """``new`` for the first message of a scan, ``same`` for the next ones, ``stale`` after its reset."""
        if scan_ns == self._stale_ns:
            return STALE
        if scan_ns == self._scan_ns:
            return SAME
        if self._scan_ns is not None:
            self._stale_ns = self._scan_ns
            self._began_s = time.monotonic()
        self._scan_ns = scan_ns
        return NEW

    def reset(self) -> bool:
        """Take a reset; False if the scan after it has already begun."""
        if time.monotonic() - self._began_s < _SAME_RESET_S:
            return False
        self._stale_ns, self._scan_ns = self._scan_ns, None
        return True


@dataclass(frozen=True)
class JoinedFrame:
    """The messages of one frame; None for those that were lost or not needed."""

    status: FrameStatus
    odometry: 'OdometryMessage | None'
    cloud: 'PointCloud2 | None'
    dropped: bool = False  # the cloud, for want of room

    def decode(self) -> tuple[OdometryEstimate, TargetFrame | None]:
        """The estimate, and the frame if it was accepted and its cloud is here; a key frame's must be.

        Raises:
            MalformedMessage: a message is missing, or cannot be read.
        """
        status = self.status
        needed = status.accepted and (status.keyframe or not self.dropped)
        if self.odometry is None or (needed and self.cloud is None):
            raise MalformedMessage(f'frame {status.stamp_ns} lacks its pose or cloud')
        odometry = read_odometry(self.odometry)
        target = read_target_frame(self.cloud) if status.accepted and self.cloud is not None else None
        return read_estimate(status, odometry, target), target


class FrameJoin:
    """Joins the messages of frames, in any order; complete frames leave in order of their statuses.

    Args:
        wants_cloud: whether the cloud of a frame is needed.
    """

    def __init__(self, wants_cloud: Callable[[FrameStatus], bool]) -> None:
        self._wants_cloud = wants_cloud
        self._statuses: deque[tuple[FrameStatus, float]] = deque()
        self._odometry: dict[int, OdometryMessage] = {}
        self._clouds: dict[int, PointCloud2] = {}
        self._dropped: set[int] = set()

    def restart(self) -> None:
        """Start a new scan. Poses and clouds stay, because those of the new scan may have arrived."""
        self._statuses.clear()

    def __len__(self) -> int:
        """Number of incomplete frames."""
        return len(self._statuses)

    def add_status(self, status: FrameStatus, now_s: float) -> None:
        """Add a status, and when it arrived."""
        self._statuses.append((status, now_s))

    def add_odometry(self, msg: OdometryMessage) -> None:
        """Add a pose."""
        self._odometry[read_stamp(msg.header.stamp)] = msg
        if len(self._odometry) > MOST_POSES:
            del self._odometry[min(self._odometry)]

    def add_cloud(self, msg: PointCloud2) -> None:
        """Add a target cloud; it may arrive twice, as a frame and as a key frame."""
        self._clouds[read_stamp(msg.header.stamp)] = msg
        if len(self._clouds) > MOST_CLOUDS:
            del self._clouds[min(self._clouds)]

    def drop_cloud(self, stamp_ns: int) -> None:
        """A frame's cloud does not come; its pose counts all the same."""
        self._dropped.add(stamp_ns)

    def pop(self, now_s: float, patience_s: float = PATIENCE_S) -> Iterator[JoinedFrame]:
        """Complete frames, and those that have waited longer than ``patience_s``."""
        while self._statuses:
            status, since = self._statuses[0]
            stamp = status.stamp_ns
            here = stamp in self._clouds or (stamp in self._dropped and not status.keyframe)
            complete = stamp in self._odometry and (here or not self._wants_cloud(status))
            if not complete and now_s - since < patience_s:
                return
            self._statuses.popleft()
            dropped = stamp in self._dropped
            yield JoinedFrame(status, self._odometry.get(stamp), self._clouds.get(stamp), dropped)
            self._dropped = {s for s in self._dropped if s > stamp}
            for messages in (self._odometry, self._clouds):
                for old in [s for s in messages if s <= stamp]:
                    del messages[old]


@dataclass(frozen=True)
class _Waiting:
    transform: ClosureTransform
    since_s: float


class ClosureJoin:
    """Joins accepted closures with their evidence, and holds them back until their key frames are known.

    Args:
        log: called with a text for each closure that is dropped.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self.restart()

    def restart(self) -> None:
        """Start a new scan."""
        self._records: dict[tuple[int, int], ClosureRecord] = {}
        self._waiting: list[_Waiting] = []

    def __len__(self) -> int:
        """Number of closures that wait."""
        return len(self._waiting)

    def add_records(self, records: Sequence[ClosureRecord]) -> list[ClosureRecord]:
        """Add hypotheses; returns the new ones, as a stage that was restarted may publish some twice."""
        named = {(r.from_stamp_ns, r.to_stamp_ns): r for r in records}
        room = MOST_HYPOTHESES - len(self._records)
        new = {pair: r for pair, r in named.items() if pair not in self._records}
        kept = dict(list(new.items())[:room])
        self._records |= kept
        return list(kept.values())

    def add(self, transform: ClosureTransform, now_s: float) -> None:
        """Add an accepted closure, and when it arrived."""
        self._waiting.append(_Waiting(transform, now_s))

    def pop(
        self, known: Container[int], now_s: float, patience_s: float = PATIENCE_S
    ) -> Iterator[tuple[Closure, float]]:
        """Closures whose key frames are ``known``, and when each arrived; drops those that wait too long."""
        waiting, self._waiting = self._waiting, []
        for item in waiting:
            c, patient = item.transform, now_s - item.since_s < patience_s
            pair = c.from_stamp_ns, c.to_stamp_ns
            record = self._records.get(pair)
            if all(stamp in known for stamp in pair) and (record or not patient):
                probability, why = (record.probability, record.why) if record else (1.0, 'from another node')
                checks = record.checks if record else ()
                yield Closure(*pair, probability, True, why, c.T_from_to, checks), item.since_s
            elif patient:
                self._waiting.append(item)
            else:
                self._log(f'closure {pair[0]} - {pair[1]} names an unknown key frame')
