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

"""The latest target frames on disk: a stage that was away for some seconds catches up from them."""

from pathlib import Path

from debris_scanner.core.frames import TargetFrame
from debris_scanner.io.journal import MB, Journal, read_records
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import pack_frame, unpack_frame

SEGMENT_BYTES = 8 * MB  # of each of two files: together more than a minute of a Kinect at 10 Hz
_NAMES = ('frames_0.journal', 'frames_1.journal')
_FRAME = 'frame'


class RecentFrames:
    """Writes frames into two files in turn, so that at least one is always there.

    Args:
        folder: of the journals.
        segment_bytes: size of a file at which the other one is started anew.

    Raises:
        OSError: the files cannot be opened.
    """

    def __init__(self, folder: Path, segment_bytes: int = SEGMENT_BYTES) -> None:
        self._segment_bytes = segment_bytes
        self._segments = [Journal(folder / name) for name in _NAMES]
        newest = [max((r.key for r in s.take_found()), default=0) for s in self._segments]
        self._current = int(newest[1] > newest[0])

    @property
    def problem(self) -> str:
        """Why a frame could not be written."""
        return self._segments[self._current].problem

    def append(self, frame: TargetFrame, frame_id: str) -> None:
        """Write a frame; ``frame_id`` is the sensor's optical frame."""
        if self._segments[self._current].size > self._segment_bytes:
            self._current = 1 - self._current
            self._segments[self._current].restart()
        values = pack_frame(frame) | {'frame_id': frame_id}
        self._segments[self._current].append(_FRAME, values, frame.stamp_ns)

    def restart(self) -> None:
        """Start a new scan."""
        for segment in self._segments:
            segment.restart()


def read_recent(folder: Path, after_ns: int, normals: NormalSettings) -> list[tuple[TargetFrame, str]]:
    """Frames later than a stamp, in order of time, each with the frame id of its points."""
    records = [r for name in _NAMES for r in read_records(folder / name, after_ns)]
    by_stamp = {r.key: r.values for r in records}
    return [(unpack_frame(by_stamp[ns], normals), str(by_stamp[ns]['frame_id'])) for ns in sorted(by_stamp)]
