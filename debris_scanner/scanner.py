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

"""The scanner: scanning, generating, tracking, lost; built from the stages, free of ROS.

The live nodes run the same stages in processes of their own; here they run in one, frame by frame,
so that a recorded scan is the same from run to run.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from debris_scanner.core.frames import DepthFrame, FrameRejected, TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.core.results import ScanResult
from debris_scanner.core.timing import StageTimer
from debris_scanner.mapping.closures import Closure, ClosureDetector
from debris_scanner.modelling.model_builder import Generation, ModelBuilder, Progress
from debris_scanner.recorder import ScanRecorder
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate


@dataclass(frozen=True)
class Step:
    """What one frame did: why it was rejected, or the target and its estimate; closures tried; a model."""

    rejected: str | None = None
    target: TargetFrame | None = None
    estimate: OdometryEstimate | None = None
    closures: tuple[Closure, ...] = ()
    generation: Generation | None = None


def make_odometry(settings: Settings, timer: StageTimer | None = None) -> Odometry:
    """The odometry stage of a scanner with these settings."""
    return Odometry(settings.odometry, settings.motion, settings.normals, timer)


def make_preprocessor(settings: Settings, timer: StageTimer | None = None) -> Preprocessor:
    """The preprocessing stage."""
    return Preprocessor(settings.isolation, settings.normals, timer)


def make_closure_detector(settings: Settings, timer: StageTimer | None = None) -> ClosureDetector:
    """The closure detection stage."""
    s = settings
    return ClosureDetector(s.closure, s.closure_search, s.descriptor, s.verification, s.normals, timer)


def make_model_builder(settings: Settings, timer: StageTimer | None = None) -> ModelBuilder:
    """The pose graph and model stage."""
    s = settings
    return ModelBuilder(s.builder, s.pose_graph, s.fusion, s.verdict, s.normals, s.motion, timer)


class Scanner:
    """Takes depth frames, finds the target's motion, closes the loop, builds the model, tracks it."""

    def __init__(
        self,
        settings: Settings | None = None,
        on_generation: Callable[[], None] | None = None,
        timer: StageTimer | None = None,
    ) -> None:
        """Build the stages.

        Args:
            settings: None takes the defaults.
            on_generation: called when a model is about to be generated, which takes seconds.
            timer: of all stages; None makes one.
        """
        settings = settings or Settings()
        self._on_generation = on_generation or (lambda: None)
        self.timer = timer or StageTimer()
        self.preprocessor = make_preprocessor(settings, self.timer)
        self.odometry = make_odometry(settings, self.timer)
        self.detector = make_closure_detector(settings, self.timer)
        self.builder = make_model_builder(settings, self.timer)
        self.reset()

    def reset(self) -> None:
        """Forget the scan; the next frame starts a new one."""
        for stage in (self.preprocessor, self.odometry, self.detector, self.builder):
            stage.reset()
        self.recorder = ScanRecorder()
        self.frames_read = 0
        self.rejected: Counter[str] = Counter()

    @property
    def state(self) -> str:
        """scanning, tracking or lost; generating is over when ``process`` returns."""
        return self.odometry.state

    def reject(self, reason: str) -> None:
        """Count an input that could not even be decoded."""
        self.frames_read += 1
        self.rejected[reason] += 1

    def process(self, frame: DepthFrame) -> Step:
        """Take one frame through all stages."""
        self.frames_read += 1
        try:
            target = self.preprocessor.process(frame)
        except FrameRejected as rejection:
            self.rejected[rejection.reason] += 1
            return Step(rejected=rejection.reason)
        tracked = self.odometry.model is not None
        estimate = self.odometry.process(target)
        self.recorder.add_estimate(
            estimate.stamp_ns,
            estimate.T_sensor_target,
            estimate.omega_target,
            estimate.omega_sigma,
            estimate.accepted,
            self.builder.T_model_scan if tracked else None,
            estimate.submap,
        )
        if not estimate.accepted:
            self.rejected['not_registered'] += 1
            return Step(target=target, estimate=estimate)
        closures = self._keyframe(estimate, tracked) if estimate.keyframe else ()
        if estimate.usable_for_mapping:
            self.builder.add_frame(target, inverse(estimate.T_sensor_target), tracked)
        generation = self.generate() if self.builder.should_rebuild else None
        return Step(target=target, estimate=estimate, closures=closures, generation=generation)

    def generate(self) -> Generation:
        """Attempt a model from everything so far, and track it."""
        self._on_generation()
        generation = self.builder.generate()
        if generation.model is not None:
            self.odometry.adopt_model(generation.model, generation.poses)
        return generation

    def finish(self, interrupted: str | None = None, progress: Progress | None = None) -> ScanResult:
        """Last optimisation over everything seen, and the result.

        Args:
            interrupted: reason to give where a cut-off scan has no model.
            progress: called as the long steps go on.
        """
        return self.result(self.builder.generate(final=True, progress=progress), interrupted)

    def result(self, generation: Generation, interrupted: str | None = None) -> ScanResult:
        """The scan as a generation left it; arguments as :meth:`finish`."""
        result = self.recorder.result(
            self.builder,
            generation,
            self.frames_read,
            dict(self.rejected),
            self.timer.summary(),
            interrupted,
        )
        result.descriptions = self.detector.descriptions
        return result

    def _keyframe(self, estimate: OdometryEstimate, tracked: bool) -> tuple[Closure, ...]:
        keyframe = estimate.keyframe
        assert keyframe is not None
        self.builder.add_keyframe(keyframe, tracked)
        if tracked:
            return ()  # the model places it; closures have done their work
        closures = tuple(self.detector.add(keyframe))
        for closure in closures:
            self.recorder.closures.append(closure.record)
            if closure.accepted:
                self.builder.add_closure(closure)
        return closures
