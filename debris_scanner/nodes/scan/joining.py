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

"""Which scan a message belongs to, when a reset and the first frames of the new scan overtake each other.

Frames put together again: verdict, pose and cloud of one stamp travel on topics of their own.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import PointCloud2

from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.nodes.publishing.estimates import Verdict
from msg_adapters.poses import StampedOdometry, read_odometry
from msg_adapters.stamps import read_stamp
from msg_adapters.target_frames import read_target_frame

# A reset that comes this soon after a new scan has shown itself is the one that began it.
_SAME_RESET_S = 3.0

NEW, SAME, STALE = 'new', 'same', 'stale'


class ScanIdentity:
    """Follows the scans by the stamps of their first key frames, which every verdict carries."""

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
        """A reset was asked for; False if the scan after it has begun already."""
        if time.monotonic() - self._began_s < _SAME_RESET_S:
            return False
        self._stale_ns, self._scan_ns = self._scan_ns, None
        return True


PATIENCE_S = 2.0  # a part that has not come by then is lost
BUSY_PATIENCE_S = 20.0  # the same while there is a queue that it may still be in
MOST_CLOUDS = 300
MOST_POSES = 3000


@dataclass(frozen=True)
class JoinedFrame:
    """All parts of one frame; those that were lost, or not wanted, are None."""

    verdict: Verdict
    odometry: OdometryMessage | None
    cloud: PointCloud2 | None

    def estimate(self) -> StampedOdometry:
        """The pose.

        Raises:
            MalformedMessage: it is none.
        """
        return read_odometry(self.odometry)

    def target(self) -> TargetFrame:
        """The cloud as a target frame.

        Raises:
            MalformedMessage: it is none.
        """
        return read_target_frame(self.cloud)


def make_keyframe(verdict: Verdict, estimate: StampedOdometry, frame: TargetFrame) -> KeyFrame:
    """The key frame that odometry made of a frame."""
    T_target_sensor = inverse(estimate.T_sensor_target)
    return KeyFrame(frame, T_target_sensor, verdict.path_rad, estimate.covariance, verdict.submap)


class FrameJoin:
    """Takes the parts in any order and gives whole frames back in order of their verdicts.

    Args:
        wants_cloud: whether the cloud of a frame is needed; those of others are let go.
    """

    def __init__(self, wants_cloud: Callable[[Verdict], bool]) -> None:
        self._wants_cloud = wants_cloud
        self._verdicts: deque[tuple[Verdict, float]] = deque()
        self._odometry: dict[int, OdometryMessage] = {}
        self._clouds: dict[int, PointCloud2] = {}

    def restart(self) -> None:
        """A new scan: forget all verdicts. Parts stay, for those of the new scan may be there already."""
        self._verdicts.clear()

    def __len__(self) -> int:
        """Frames that wait for a part."""
        return len(self._verdicts)

    def add_verdict(self, verdict: Verdict, now_s: float) -> None:
        """A verdict, and when it came."""
        self._verdicts.append((verdict, now_s))

    def add_odometry(self, msg: OdometryMessage) -> None:
        """A pose."""
        self._odometry[read_stamp(msg.header.stamp)] = msg
        if len(self._odometry) > MOST_POSES:
            del self._odometry[min(self._odometry)]

    def add_cloud(self, msg: PointCloud2) -> None:
        """A target cloud; the same one may come twice, as a frame and as a key frame."""
        self._clouds[read_stamp(msg.header.stamp)] = msg
        if len(self._clouds) > MOST_CLOUDS:
            del self._clouds[min(self._clouds)]

    def pop(self, now_s: float, patience_s: float = PATIENCE_S) -> Iterator[JoinedFrame]:
        """Frames that are whole, and those that have waited too long for the rest."""
        while self._verdicts:
            verdict, since = self._verdicts[0]
            stamp = verdict.stamp_ns
            whole = stamp in self._odometry and (stamp in self._clouds or not self._wants_cloud(verdict))
            if not whole and now_s - since < patience_s:
                return
            self._verdicts.popleft()
            yield JoinedFrame(verdict, self._odometry.get(stamp), self._clouds.get(stamp))
            for parts in (self._odometry, self._clouds):
                for old in [s for s in parts if s <= stamp]:
                    del parts[old]
