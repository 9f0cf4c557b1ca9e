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

A frame passes these stages::

    depth frame -> preprocess -> odometry -> closure detection      FrontEnd
                                    ^             |
                                    |             v
                                  model <---- pose graph, model     BackEnd

Offline, both ends run in one thread, frame by frame, so that a scan is identical from run to run. The
composed node runs each end in a thread; the separate nodes run the three stages of the front end and the back
end in a process each.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from debris_scanner.back_end import BackEnd, FrameCounts, ScanEvents
from debris_scanner.core.frames import DepthFrame, Model, TargetFrame
from debris_scanner.core.results import ScanResult, commonest
from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import Faults
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import Generation, Progress
from debris_scanner.sensing.hints import joined
from debris_scanner.sensing.isolation import SETTLING
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector, make_model_builder, make_odometry, make_preprocessor
from debris_scanner.tracking.odometry import OdometryEstimate


@dataclass(frozen=True)
class Step:
    """The results of one frame: why it was rejected, or the target and its estimate; closures; a model."""

    rejected: str | None = None
    why: str = ''  # it was rejected, in words
    target: TargetFrame | None = None
    estimate: OdometryEstimate | None = None
    closures: tuple[Closure, ...] = ()
    generation: Generation | None = None


def _isolated(target_of: Callable[[DepthFrame], TargetFrame], frame: DepthFrame) -> Step:
    return Step(target=target_of(frame))


class FrontEnd:
    """Depth frames in; the target alone, its pose, key frames and closure hypotheses out.

    A frame that raises is left out: see :mod:`debris_scanner.faults`.
    """

    def __init__(
        self, settings: Settings, timer: StageTimer, revisits: bool = False, faults: Faults | None = None
    ) -> None:
        """``revisits``: frames rejected as ``settling`` are taken up once it is known what stands still."""
        self.timer, self.revisits = timer, revisits
        self.faults = faults or Faults()
        self.preprocessor = make_preprocessor(settings, timer)
        self.odometry = make_odometry(settings, timer)
        self.detector = make_closure_detector(settings, timer)
        self.rejected: Counter[str] = Counter()  # frames without a target, by reason
        self._refusals: dict[str, str] = {}  # the latest in words, by reason
        self._unsettled: list[DepthFrame] = []

    def reset(self) -> None:
        """Forget the scan; the next frame starts a new one."""
        for stage in (self.preprocessor, self.odometry, self.detector):
            stage.reset()
        self.rejected.clear()
        self._refusals.clear()
        self._unsettled.clear()

    def reject(self, reason: str, why: str) -> None:
        """Count an input that is no frame."""
        self.rejected[reason] += 1
        self._refusals[reason] = why

    @property
    def hint(self) -> str:
        """What is odd about the input, if most of it is of no use; empty where nothing is."""
        return joined(self._refusals.get(commonest(self.rejected), ''), self.preprocessor.hint)

    def process(self, frame: DepthFrame) -> Step:
        """Process one frame in all stages."""
        return self.process_all(frame)[-1]

    def process_all(self, frame: DepthFrame) -> list[Step]:
        """Process one frame in all stages, after those that it helps to understand; its step is last."""
        found = self._contained(partial(_isolated, self.preprocessor.process, frame))
        if found.target is None:
            if self.revisits and found.rejected == SETTLING:
                self._unsettled.append(frame)
            return [found]
        return [*self.settle(), self._contained(partial(self._track, found.target))]

    def settle(self) -> list[Step]:
        """The steps of the frames that were settling, in order, now that more is known, or no more comes."""
        earlier, self._unsettled = self._unsettled, []
        if not earlier:
            return []
        self.rejected[SETTLING] -= len(earlier)
        self.rejected += Counter()  # without zeros
        with self.preprocessor.looking_back() as target_of:
            found = [self._contained(partial(_isolated, target_of, frame)) for frame in reversed(earlier)]
        targets = [step.target for step in reversed(found) if step.target is not None]
        return [self._contained(partial(self._track, target)) for target in targets]

    def _contained(self, step: Callable[[], Step]) -> Step:
        """The step of a frame, or why there is none: the one place where a frame's exceptions end."""
        with self.faults.contained('a frame', self.rejected) as contained:
            return step()
        return Step(rejected=contained.reason, why=contained.message)

    def _track(self, target: TargetFrame) -> Step:
        """The target's pose, key frame and closures."""
        estimate = self.odometry.process(target)
        closures: list[Closure] = []
        # the poses of tracked key frames come from the model, so they need no closures
        if estimate.keyframe is not None and not estimate.tracked:
            with self.faults.contained('the closure search of a key frame'):
                closures = self.detector.add(estimate.keyframe)
        return Step(target=target, estimate=estimate, closures=tuple(closures))

    def adopt(self, generation: Generation) -> None:
        """Track the model of a generation, or give up the one that it withdraws.

        Raises:
            ValueError: it shares no key frame with this odometry.
        """
        if generation.model is not None:
            self.odometry.adopt_model(generation.model, generation.poses, generation.offset)
        elif generation.withdrawn:
            self.odometry.drop_model()

    def configure(self, settings: Settings) -> None:
        """Take the settings that may change during a scan."""
        self.preprocessor.configure(settings.isolation)
        self.odometry.settings = settings.odometry
        self.detector.configure(settings.closure, settings.closure_search, settings.verification)


class Scanner:
    """Takes depth frames, estimates the target's motion, closes the loop, builds the model, and tracks it.

    Args:
        settings: None: the defaults.
        events: for the caller to show.
        timer: of all stages; None: a new one.
        model: known beforehand; it is looked for and tracked, and none is built.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        events: ScanEvents | None = None,
        timer: StageTimer | None = None,
        model: Model | None = None,
    ) -> None:
        settings = settings or Settings()
        self.timer = timer or StageTimer()
        self.faults = Faults()
        self.front_end = FrontEnd(settings, self.timer, revisits=True, faults=self.faults)
        builder = make_model_builder(settings, self.timer, model)
        self.back_end = BackEnd(builder, self._counts, events, faults=self.faults)

    def reset(self) -> None:
        """Forget the scan; the next frame starts a new one."""
        self.front_end.reset()
        self.back_end.reset()
        self.faults.reset()

    @property
    def state(self) -> str:
        """scanning, tracking or lost; never generating, which ends before ``process`` returns."""
        return self.front_end.odometry.state

    def reject(self, reason: str, why: str = '') -> None:
        """Count an input that cannot be decoded; ``why`` is told if most of the input is like it."""
        self.front_end.reject(reason, why)

    def process(self, frame: DepthFrame) -> Step:
        """Process one frame in both ends; the step is this frame's, also where earlier ones were taken up."""
        steps = self.front_end.process_all(frame)
        self._add(steps)
        step = steps[-1]
        if step.estimate is None:
            return step
        generation = self.back_end.advance()
        if generation is not None:
            with self.faults.contained('tracking by a model'):
                self.front_end.adopt(generation)
        return replace(step, generation=generation)

    def _add(self, steps: Sequence[Step]) -> None:
        for step in steps:
            if step.estimate is not None:
                self.back_end.add(step.estimate, step.target, step.closures)

    def finish(self, interrupted: str | None = None, progress: Progress | None = None) -> ScanResult:
        """Optimise over all frames, and return the result; arguments as :meth:`BackEnd.end`."""
        self._add(self.front_end.settle())
        return self.back_end.end(interrupted, progress)

    def _counts(self) -> FrameCounts:
        front = self.front_end
        descriptions = front.detector.descriptions
        units = front.preprocessor.unit_warning
        return FrameCounts(
            dict(front.rejected), self.timer.summary(), descriptions, hint=front.hint, units=units
        )
