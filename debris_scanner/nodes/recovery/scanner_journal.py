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

"""What a composed scanner that was killed goes on from: the journals of odometry and of graph."""

from pathlib import Path

from nav_msgs.msg import Odometry as OdometryMessage

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.timing import StageTimer
from debris_scanner.io.odometry_journal import OdometryJournal, read_scan_keyframes
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.nodes.publishing.estimates import Verdict
from debris_scanner.nodes.recovery.graph_journal import GraphJournal
from debris_scanner.nodes.scan.frame_statistics import NOT_REGISTERED, FrameStatistics
from debris_scanner.nodes.scan.graph_stage import GraphStage
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.tracking.odometry import OdometryEstimate
from msg_adapters.poses import read_odometry


class ScannerJournal:
    """Notes of one scan.

    Odometry's are written by the frames' thread at once, so the scan goes on from the latest frame; those of
    the models by the builder's worker behind what they tell of. Frames that waited there are lost with the
    process, but for the key frames among them.

    Args:
        folder: of the journals.
        scanner: whose scan it is.
        builder: of its models, which only its worker touches once that runs.
        normals: how planes are fitted again.

    Raises:
        OSError: a file cannot be opened.
    """

    def __init__(
        self, folder: Path, scanner: Scanner, builder: ModelBuilder, normals: NormalSettings
    ) -> None:
        self._folder = folder
        self._normals = normals
        self._scanner = scanner
        self._builder = builder
        self._odometry = OdometryJournal(folder, normals)
        self._graph = GraphJournal(folder, normals)

    @property
    def problem(self) -> str:
        """Why the last record could not be written."""
        return self._odometry.problem or self._graph.problem

    def resume(self) -> bool:
        """Bring a scanner that was just reset to where the last one stopped; False if there was none.

        Raises:
            KeyError, ValueError, TypeError: journals of another release.
        """
        scanner, builder = self._scanner, self._builder
        if not self._odometry.resume(scanner.odometry):
            self.restart()
            self.restart_models()
            return False
        statistics = FrameStatistics()
        stage = GraphStage(builder, StageTimer(), statistics, lambda _: None)
        self._graph.replay(stage)
        scanner.recorder = stage.recorder
        scanner.frames_read = statistics.used + statistics.not_registered
        scanner.rejected[NOT_REGISTERED] = statistics.not_registered
        known = builder.graph.keyframes.index
        for keyframe in read_scan_keyframes(self._folder, 0, self._normals):
            scanner.detector.remember(keyframe)
            if keyframe.stamp_ns not in known:
                builder.add_keyframe(keyframe, tracked=False)
        return True

    def frame(self, estimate: OdometryEstimate) -> None:
        """After a frame; in the frames' thread."""
        self._odometry.note(self._scanner.odometry, estimate)

    def taken(
        self,
        verdict: Verdict,
        message: OdometryMessage,
        target: TargetFrame,
        closures: tuple[Closure, ...],
    ) -> None:
        """After the builder took what a frame gave it; in the worker."""
        frame = target if verdict.accepted else None
        stored = verdict.usable_for_mapping and bool(self._builder.store.frames)
        kept = stored and self._builder.store.frames[-1].depth is not None
        self._graph.frame(verdict, read_odometry(message), frame, kept or verdict.keyframe)
        if closures:
            self._graph.candidates([c.record for c in closures])
        for closure in closures:
            if closure.accepted:
                self._graph.closure(closure)

    def adopted(self) -> None:
        """After odometry adopted a model."""
        self._odometry.adopted(self._scanner.odometry)

    def generated(self) -> None:
        """After a generation; in the worker."""
        self._graph.generated(self._builder)

    def end(self) -> None:
        """The scan was finished and saved; in the worker."""
        self._graph.end()

    @property
    def ended(self) -> bool:
        """Whether the scan that was gone on with had been finished and saved."""
        return self._graph.ended

    def restart(self) -> None:
        """A new scan; in the frames' thread."""
        self._odometry.restart()

    def restart_models(self) -> None:
        """The same, in the worker."""
        self._graph.restart()
