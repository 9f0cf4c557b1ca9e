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

"""The journals of a composed scanner: those of odometry and of the back end."""

from pathlib import Path

from debris_scanner.back_end import BackEnd
from debris_scanner.io.odometry_journal import OdometryJournal, read_scan_keyframes
from debris_scanner.io.scan_journal import ScanJournal
from debris_scanner.scanner import FrontEnd
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.odometry import OdometryEstimate


class ScannerJournal:
    """Writes the journals of one scan, and continues from them.

    The frames' thread writes odometry's journal at once, so a scan continues from the latest frame. The back
    end writes its own when it processes a frame. Frames in its queue are lost with the process, except key
    frames.

    Args:
        folder: of the journals.
        front_end: whose odometry is written.
        back_end: used by its own thread alone once that runs.
        normals: how planes are fitted again.

    Raises:
        OSError: a file cannot be opened.
    """

    def __init__(self, folder: Path, front_end: FrontEnd, back_end: BackEnd, normals: NormalSettings) -> None:
        self._folder = folder
        self._normals = normals
        self._front_end = front_end
        self._back_end = back_end
        self._odometry = OdometryJournal(folder, normals)
        self._scan = ScanJournal(folder, normals)

    @property
    def problem(self) -> str:
        """Why the last record could not be written."""
        return self._odometry.problem or self._scan.problem

    def resume(self) -> bool:
        """Restore both ends, just reset, to the state of the last process; False if there was none.

        Raises:
            KeyError, ValueError, TypeError: a journal of another release.
        """
        if not self._odometry.resume(self._front_end.odometry):
            self._odometry.restart()
            self._scan.restart()
            self._back_end.journal = self._scan
            return False
        self._back_end.resume(self._scan)
        builder = self._back_end.builder
        for keyframe in read_scan_keyframes(self._folder, 0, self._normals):
            self._front_end.detector.remember(keyframe)
            if keyframe.stamp_ns not in builder.graph.keyframes.index:
                builder.add_keyframe(keyframe, tracked=False)
        return True

    def restart(self) -> None:
        """Begin a new scan; in the frames' thread. The back end begins its own journal with its reset."""
        self._odometry.restart()

    def forget(self) -> None:
        """Clear both journals; no thread may be running."""
        self._odometry.restart()
        self._scan.restart()
        self._back_end.journal = self._scan

    def frame(self, estimate: OdometryEstimate) -> None:
        """Write a frame's estimate; in the frames' thread."""
        self._odometry.note(self._front_end.odometry, estimate)

    def adopted(self) -> None:
        """Write that odometry adopted a model; in the frames' thread."""
        self._odometry.adopted(self._front_end.odometry)
