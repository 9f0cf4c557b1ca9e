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

Programs call :meth:`Scanner.add`, :meth:`Scanner.poll` and :meth:`Scanner.finish`. Whoever has decoded frames
and wants the results of all stages calls :meth:`Scanner.process` in place of ``add``.

A frame passes these stages::

    depth frame -> preprocess -> odometry -> closure detection      FrontEnd
                                    ^             |
                                    |             v
                                  model <---- pose graph, model     BackEnd

Offline, both ends run in one thread, frame by frame, so that a scan is identical from run to run. The
composed node runs each end in a thread; the separate nodes run the three stages of the front end and the back
end in a process each.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.back_end import BackEnd, ScanEvents
from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame, Model, TargetFrame
from debris_scanner.core.geometry import Array
from debris_scanner.core.results import Checks, commonest
from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import Faults
from debris_scanner.io.known_models import as_known_model
from debris_scanner.io.result_files import ScanResult
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.generation import Generation, Progress
from debris_scanner.recorder import FrameCounts
from debris_scanner.sensing.hints import checked_unit, given, joined, model_unit
from debris_scanner.sensing.isolation import SETTLING
from debris_scanner.settings import Settings
from debris_scanner.stages import make_closure_detector, make_model_builder, make_odometry, make_preprocessor
from debris_scanner.tracking.odometry import LOST, NOT_REGISTERED, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath

SHORTEST_STEP_NS = 100_000  # between frames: no sensor gives ten thousand a second


@dataclass(frozen=True)
class Estimate:
    """What is known of the target at one frame.

    Poses can be compared within one ``submap``; a closure may join two of them at the end. Of a frame that
    shows no target there is no pose, and of one that was rejected the pose is a prediction.
    """

    stamp_ns: int
    state: str  # scanning, tracking (of a model) or lost
    accepted: bool  # the frame agrees with the others
    rejected: str = ''  # why it does not, as counted in summary.json
    T_sensor_target: Array | None = None  # (4, 4), metres, camera's optical frame
    omega: Array | None = None  # (3,), rad/s, target frame
    omega_sigma: Array | None = None  # (3,), rad/s
    in_model_frame: bool = False  # the target frame is the model's, else that of the scan so far
    submap: int = 0


@dataclass(frozen=True)
class LoopClosed:
    """Two key frames show the same face."""

    from_stamp_ns: int  # the earlier one
    to_stamp_ns: int
    checks: Checks


@dataclass(frozen=True)
class ModelBuilt:
    """A model has passed all checks: the scan's own, a better one than before, or a given one was found."""

    stamp_ns: int  # of the latest frame
    model: Model
    why: str  # what speaks for it: the checks in words
    checks: Checks


@dataclass(frozen=True)
class ModelRejected:
    """An attempt at a model has failed; scanning goes on, with the model before it if there is one."""

    stamp_ns: int  # of the latest frame
    reason: str  # as in summary.json
    why: str  # the checks in words
    checks: Checks
    withdrawn: bool = False  # the given model that was tracked so far is another target's


@dataclass(frozen=True)
class Lost:
    """The target cannot be followed any more."""

    stamp_ns: int


@dataclass(frozen=True)
class Found:
    """The target is followed again after it was lost."""

    stamp_ns: int


Event = LoopClosed | ModelBuilt | ModelRejected | Lost | Found


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
    def hints(self) -> tuple[str, ...]:
        """What is odd about the input, if most of it is of no use."""
        return given(self._refusals.get(commonest(self.rejected), ''), *self.preprocessor.hints)

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
        extend: add to a known model what it lacks and the scan shows.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        events: ScanEvents | None = None,
        timer: StageTimer | None = None,
        model: Model | None = None,
        extend: bool = False,
    ) -> None:
        self.settings = settings or Settings()
        self.timer = timer or StageTimer()
        self.faults = Faults()
        self.front_end = FrontEnd(self.settings, self.timer, revisits=True, faults=self.faults)
        builder = make_model_builder(self.settings, self.timer, model)
        self.back_end = BackEnd(builder, self._counts, events, faults=self.faults)
        shown = model is not None and len(model.points)
        self._extent = float(np.ptp(model.points, axis=0).max()) if model and shown else None
        self._seen = 0.0  # largest extent of the target in an image, metres
        self.back_end.extend = extend
        self._begin()

    def _begin(self) -> None:
        self._began_s = time.monotonic()
        self._stamp_ns: int | None = None  # of the frame that was added last
        self._events: list[Event] = []

    def reset(self) -> None:
        """Forget the scan; the next frame starts a new one."""
        self.front_end.reset()
        self.back_end.reset()
        self.faults.reset()
        self._begin()

    @property
    def state(self) -> str:
        """scanning, tracking or lost; never generating, which ends before ``add`` returns."""
        return self.front_end.odometry.state

    @property
    def keyframes(self) -> int:
        """How many key frames there are."""
        return len(self.back_end.builder.keyframes)

    @property
    def frames_used(self) -> int:
        """How many frames were accepted."""
        return self.back_end.recorder.used

    @property
    def last_attempt(self) -> Generation | None:
        """The model, or why the latest attempt made none; None before the first one."""
        return self.back_end.builder.last

    @property
    def sensor_path(self) -> SensorPath:
        """How the sensor moves; who knows it adds to it before ``finish``."""
        return self.back_end.sensor_path

    @property
    def warnings(self) -> list[str]:
        """What a user should know about the scan so far, each in a line."""
        front = self.front_end
        said = (front.odometry.full, front.preprocessor.background_warning, front.preprocessor.unit_warning)
        return [warning for warning in said if warning]

    @property
    def model_warning(self) -> str:
        """Warning about the unit of the model that is looked for, by the target's size; empty without any."""
        unit = model_unit(self._extent, self._seen) if self._extent and self._seen else ''
        if not unit:
            return ''
        return f'the model is {self._extent:.3g} m large, the target {self._seen:.2g} m: is it in {unit}?'

    def add(
        self,
        depth: NDArray[Any],
        camera: Camera,
        stamp_ns: int,
        colour: NDArray[np.uint8] | None = None,
    ) -> Estimate:
        """Add one frame; what it leads to beside the estimate is told by :meth:`poll`.

        Args:
            depth: (h, w), metres if float32 or float64, millimetres if uint16; 0, NaN or Inf where invalid.
            camera: of the depth image.
            stamp_ns: nanoseconds, whole, later than that of the frame before.
            colour: (h, w, 3) or (h, w) uint8, registered to the depth.

        Raises:
            ValueError: an argument is not as described, or the scan is finished; the frame does not count.
        """
        frame = DepthFrame(stamp_ns, depth, camera, colour)
        checked_unit(frame.depth, self.settings.isolation.box_max[2])
        if self._stamp_ns is not None and frame.stamp_ns - self._stamp_ns < SHORTEST_STEP_NS:
            raise ValueError(
                f'stamp_ns {frame.stamp_ns} after {self._stamp_ns}: '
                f'stamps must increase, and be nanoseconds (at least {SHORTEST_STEP_NS} apart)'
            )
        self._stamp_ns = frame.stamp_ns
        before = self.state
        step = self.process(frame)
        self._note(step, before)
        return self._estimate(frame.stamp_ns, step)

    def poll(self) -> list[Event]:
        """What has happened since the last call, in order, by frames that were added and by ``finish``."""
        events, self._events = self._events, []
        return events

    def reject(self, reason: str, why: str = '') -> None:
        """Count an input that cannot be decoded; ``why`` is told if most of the input is like it."""
        self.front_end.reject(reason, why)

    def process(self, frame: DepthFrame) -> Step:
        """Process one frame in both ends; the step is this frame's, also where earlier ones were taken up.

        A frame that is out of order is counted as rejected, as is all that a recording may hold.

        Raises:
            ValueError: the scan is finished.
        """
        if self.back_end.ended:
            raise ValueError('the scan is finished: reset() begins a new one')
        steps = self.front_end.process_all(frame)
        self._add(steps)
        step = steps[-1]
        if step.target is not None and self._extent is not None:
            self._seen = max(self._seen, max(step.target.inner_size) * step.target.footprint)
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

    def _estimate(self, stamp_ns: int, step: Step) -> Estimate:
        found = step.estimate
        if found is None:
            return Estimate(stamp_ns, self.state, False, step.rejected or '')
        return Estimate(
            stamp_ns,
            self.state,
            found.accepted,
            '' if found.accepted else found.rejected or NOT_REGISTERED,
            found.T_sensor_target,
            found.omega_target,
            found.omega_sigma,
            found.tracked,
            found.submap,
        )

    def _note(self, step: Step, before: str) -> None:
        """Note the events of a frame; ``before`` it was this state."""
        assert self._stamp_ns is not None
        self._events += [
            LoopClosed(c.from_stamp_ns, c.to_stamp_ns, c.checks) for c in step.closures if c.accepted
        ]
        if step.generation is not None:
            self._note_attempt(step.generation)
        if LOST in (before, self.state) and self.state != before:
            self._events.append((Lost if self.state == LOST else Found)(self._stamp_ns))

    def _note_attempt(self, attempt: Generation) -> None:
        stamp_ns = self._stamp_ns or 0
        if attempt.model is not None:
            self._events.append(ModelBuilt(stamp_ns, attempt.model, attempt.why, attempt.checks))
        else:
            self._events.append(
                ModelRejected(stamp_ns, attempt.reason or '', attempt.why, attempt.checks, attempt.withdrawn)
            )

    def finish(self, interrupted: str | None = None, progress: Progress | None = None) -> ScanResult:
        """Optimise over all frames, and return the result; arguments as :meth:`BackEnd.end`."""
        ended = self.back_end.ended
        self._add(self.front_end.settle())
        result = self._timed(self.back_end.end(interrupted, progress))
        if not ended and self.last_attempt is not None:
            self._note_attempt(self.last_attempt)
        return result

    def result_so_far(self) -> ScanResult:
        """The result of what was gathered, without another attempt at a model."""
        return self._timed(self.back_end.result_so_far())

    def _timed(self, result: ScanResult) -> ScanResult:
        result.wall_s = time.monotonic() - self._began_s
        return result

    def _counts(self) -> FrameCounts:
        front = self.front_end
        descriptions = front.detector.descriptions
        units = front.preprocessor.unit_warning
        return FrameCounts(
            dict(front.rejected),
            self.timer.summary(),
            descriptions,
            hint=joined(*front.hints),
            units=joined(units, self.model_warning),
        )


class Tracker(Scanner):
    """A scanner that tracks a given model, from the frames on in which it is found.

    From then on, an estimate's pose is ``in_model_frame``.

    Args:
        model: a model, the result or the folder of a scan, a mesh file, or a mesh of trimesh or Open3D;
            metres, in a frame of its own, which becomes the target frame.
        settings: None: the defaults.
        extend: add to the model, at the end, what it lacks and the frames show.

    Raises:
        ValueError: there is no model in what was given, or its size cannot be in metres.
        MeshFileError: a file cannot be read.
    """

    def __init__(self, model: Any, settings: Settings | None = None, extend: bool = False) -> None:
        super().__init__(settings, model=as_known_model(model), extend=extend)
