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

"""The back end of a scan: key frames, poses and closures in; models, files and the scan's state out.

The offline scan, the composed node and the graph node share this one state machine; they differ in where
frames come from. One thread drives a back end. Only :class:`ScanState` may be told things by another.

1. ``add`` and ``add_closures`` take what the front end found in a frame.
2. ``advance`` builds a model when a loop has closed, or when enough of the surface is new.
3. ``finish`` refines all frames once more, builds the last model, and writes the files.
"""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from debris_scanner.core.frames import KeyPose, TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.core.results import INTERRUPTED, ClosureRecord, Descriptions, ScanResult
from debris_scanner.core.timing import StageTimer
from debris_scanner.io.result_files import OutputError, check_output_dir, write_results
from debris_scanner.io.scan_journal import ScanJournal
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import Generation, ModelBuilder, Progress
from debris_scanner.recorder import ScanRecorder
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import LOST, SCANNING, TRACKING, OdometryEstimate

GENERATING = 'generating'
NOT_REGISTERED = 'not_registered'
CLOSURE_TO_MODEL = 'closure_to_model'

Answer = tuple[bool, str]  # to a request: whether it was done, and in words what was


class ScanEvents:
    """What a shell shows of a scan; each method does nothing here.

    All but ``state_changed`` are called by the thread that drives the back end.
    """

    def state_changed(self, state: str) -> None:
        """The scan's state is another one."""

    def keyframe_added(self, keyframes: Sequence[KeyPose]) -> None:
        """There is a new key frame, and no model yet."""

    def model_built(self, generation: Generation, final: bool) -> None:
        """A model has passed all checks; after a final one no more frames are taken."""

    def scan_began(self) -> None:
        """A new scan: all that was shown is out of date."""

    def log(self, text: str, warning: bool = False) -> None:
        """Something that users should read."""


class FrameCounts(NamedTuple):
    """What is known of frames that never reached the back end."""

    rejected: dict[str, int]  # by reason
    timing: dict[str, dict[str, float]]  # of all stages
    descriptions: Descriptions | None = None  # of the key frames; None where another process has them


class ScanState:
    """scanning, generating, tracking or lost; ``changed`` is called whenever it changes. Thread-safe.

    Odometry knows scanning, tracking and lost. That a model is being built, or is built but not yet tracked,
    only the back end knows.
    """

    def __init__(self, changed: Callable[[str], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self.value = ''
        self.reset()

    def reset(self) -> None:
        """A new scan."""
        self._begin()
        self._update()

    def odometry(self, estimate_state: str, tracked: bool) -> None:
        """Odometry's state with a frame, and whether that frame was registered to a model."""
        self._odometry = estimate_state
        if tracked:
            self._announced = False
        self._update()

    def generation_began(self) -> None:
        """A model is being built."""
        self._generating = True
        self._update()

    def generation_ended(self, published: bool) -> None:
        """It was published for tracking, or not."""
        self._generating = False
        self._announced = published
        self._update()

    def _begin(self) -> None:
        self._odometry = SCANNING
        self._generating = False
        self._announced = False  # a model is out that odometry has not adopted yet

    def _update(self) -> None:
        with self._lock:
            value = self._odometry
            if value not in (LOST, TRACKING) and (self._generating or self._announced):
                value = GENERATING
            if value != self.value:
                self.value = value
                self._changed(value)


class ScanOutput:
    """The output folder of a scan, and how its files came out.

    Args:
        folder: None saves nothing.

    Raises:
        OutputError: the folder cannot be made or written to.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            check_output_dir(folder)
        self.problem = ''  # why the last attempt to save failed
        self.restart()

    def restart(self) -> None:
        """A new scan begins now."""
        self._start = time.monotonic()

    def save(self, result: ScanResult) -> Answer:
        """Write all files; the answer names them, or says why there are none."""
        outcome = 'a model' if result.model is not None else f'no model: {result.reason}'
        if self.folder is None:
            return False, f'{outcome}; not saved: the parameter output_dir is empty'
        try:
            write_results(self.folder, result, time.monotonic() - self._start)
        except OutputError as error:  # a full disk ends no scan
            self.problem = f'not saved: {error}'
            return False, f'{outcome}, {self.problem}'
        self.problem = ''
        what = self.folder / ('model.ply' if result.model is not None else 'summary.json')
        return True, f'{outcome}, saved: {what}'


class BackEnd:
    """Key frames, poses and closures of one scan after another, and the models built from them.

    Args:
        builder: of the models; nobody else touches it.
        counts: of frames that never came here, asked when a result is made.
        events: what the shell shows.
        output: where results are saved.
        timer: of the stages.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        counts: Callable[[], FrameCounts],
        events: ScanEvents | None = None,
        output: ScanOutput | None = None,
        timer: StageTimer | None = None,
    ) -> None:
        self.builder = builder
        self.events = events or ScanEvents()
        self.output = output or ScanOutput(None)
        self.state = ScanState(self.events.state_changed)
        self.journal: ScanJournal | None = None
        self.timer = timer or builder.timer
        self._counts = counts
        self._clear()

    def _clear(self) -> None:
        self.builder.reset()
        self.recorder = ScanRecorder()
        self.used = 0  # frames whose pose was accepted
        self.not_registered = 0
        self.ended = False
        self._closed_s: float | None = None  # when the loop of the first model closed

    def reset(self) -> None:
        """Forget the scan; the next frame starts a new one."""
        self._clear()
        if self.journal is not None:
            self.journal.restart()
        self.output.restart()
        self.events.scan_began()
        self.state.reset()

    def configure(self, settings: Settings) -> None:
        """Take those settings that may change while a scan goes on."""
        self.builder.fusion, self.builder.verdict = settings.fusion, settings.verdict

    @property
    def has_model(self) -> bool:
        """Whether there is a model."""
        return self.builder.last is not None and self.builder.last.model is not None

    # what the front end found ------------------------------------------------------------------------

    def add(self, estimate: OdometryEstimate, target: TargetFrame | None) -> None:
        """Take the estimate of a frame, and the frame; a rejected frame may be None."""
        self.recorder.add_estimate(estimate, self.builder.T_model_scan)
        if estimate.accepted and target is not None:
            self.used += 1
            self._add_accepted(estimate, target)
        else:
            self.not_registered += 1
        if self.journal is not None:
            frame = target if estimate.accepted else None
            self.journal.frame(estimate, frame, self._kept(estimate))

    def _add_accepted(self, estimate: OdometryEstimate, target: TargetFrame) -> None:
        if estimate.keyframe is not None:
            self.builder.add_keyframe(estimate.keyframe, estimate.tracked)
            if not self.has_model:
                self.events.keyframe_added(self.builder.active)
        if estimate.usable_for_mapping:
            self.builder.add_frame(target, inverse(estimate.T_sensor_target), estimate.tracked)

    def _kept(self, estimate: OdometryEstimate) -> bool:
        """Whether the depth of the latest frame is kept: the journal need not keep more."""
        stored = self.builder.store.frames[-1:] if estimate.usable_for_mapping else []
        return estimate.keyframe is not None or any(f.depth is not None for f in stored)

    def add_hypotheses(self, records: Sequence[ClosureRecord]) -> None:
        """Take closure hypotheses, accepted or not, for summary.json."""
        if records:
            self.recorder.closures += records
            if self.journal is not None:
                self.journal.hypotheses(records)

    def add_closure(self, closure: Closure, since_s: float | None = None) -> None:
        """Take an accepted closure between key frames that are here; ``since_s``: when it was found."""
        self.builder.add_closure(closure)
        if self.journal is not None:
            self.journal.closure(closure)
        if not self.has_model:
            self._closed_s = self._closed_s or since_s or time.monotonic()

    def add_closures(self, closures: Sequence[Closure]) -> None:
        """Take all hypotheses of one key frame."""
        self.add_hypotheses([c.record for c in closures])
        for closure in closures:
            if closure.accepted:
                self.add_closure(closure)

    # the state machine -------------------------------------------------------------------------------

    def advance(self) -> Generation | None:
        """Build a model where one should be built now."""
        return self.generate() if not self.ended and self.builder.should_rebuild else None

    def generate(self, final: bool = False, progress: Progress | None = None) -> Generation:
        """Attempt a model from everything so far; publish it, and save it so that no crash can take it away.

        Args:
            final: refine every stored frame and fuse those, instead of the key frames alone.
            progress: called as the long steps go on.
        """
        if not final:
            self.state.generation_began()
        generation = self.builder.generate(final, progress)
        if self.journal is not None:
            self.journal.generated(self.builder)
        if generation.model is None:
            self.state.generation_ended(published=False)
            self.events.log(describe(generation)[1], warning=True)
            return generation
        self.events.model_built(generation, final)
        self._time_first_model()
        self.state.generation_ended(published=not final)
        self.events.log(describe(generation)[1])
        if not final and self.output.folder is not None:
            self.events.log(self.output.save(self.result(generation))[1])
        return generation

    def save(self) -> Answer:
        """Write the files as things stand."""
        return self.output.save(self.result(self.builder.last or self.builder.generate()))

    def end(self, interrupted: str | None = None, progress: Progress | None = None) -> ScanResult:
        """Build the last model, take no more frames, and return the result.

        Args:
            interrupted: reason to give where a scan that was cut off has no model.
            progress: called as the long steps go on.
        """
        if not self.ended:
            self.ended = True
            self.generate(final=True, progress=progress)
        last = self.builder.last
        assert last is not None
        return self.result(last, interrupted)

    def finish(self, interrupted: str | None = None) -> Answer:
        """End the scan and write its files."""
        answer = self.output.save(self.end(interrupted))
        if self.journal is not None and answer[0]:
            self.journal.end()
        return answer

    def save_interrupted(self) -> Answer:
        """Write the files as things stand, without a new generation: whoever stops us may lose patience."""
        last = self.builder.last or Generation(None, INTERRUPTED, '', {}, None)
        return self.output.save(self.result(last, INTERRUPTED))

    def result(self, generation: Generation, interrupted: str | None = None) -> ScanResult:
        """The scan's result as a generation left it; arguments as :meth:`end`."""
        counts = self._counts()
        rejected = dict(counts.rejected)
        if self.not_registered:
            rejected[NOT_REGISTERED] = rejected.get(NOT_REGISTERED, 0) + self.not_registered
        read = self.used + sum(rejected.values())
        result = self.recorder.result(self.builder, generation, read, rejected, counts.timing, interrupted)
        result.descriptions = counts.descriptions
        return result

    def _time_first_model(self) -> None:
        if self._closed_s is not None:
            self.timer.add(CLOSURE_TO_MODEL, time.monotonic() - self._closed_s)
            self._closed_s = None

    # going on after a crash --------------------------------------------------------------------------

    def resume(self, journal: ScanJournal) -> bool:
        """Go on with a journal's scan, and write the journal from now on; False if it holds no scan.

        The caller builds a model at once where :attr:`resumed_model` says that there was one.
        """
        try:
            journal.replay(self)
        except (KeyError, ValueError, TypeError) as error:  # written by another release
            self.events.log(
                f'the journal {journal.path} cannot be read, a new scan begins: {error}', warning=True
            )
            journal.restart()
            self._clear()
        self.journal = journal
        self.ended = journal.ended
        return journal.last_stamp_ns is not None

    @property
    def resumed_model(self) -> bool:
        """Whether the scan had a model, which only a new generation brings back."""
        return not self.ended and self.builder.T_model_scan is not None and self.builder.last is None


def describe(generation: Generation) -> Answer:
    """Whether a generation has a model, and in words what came of it."""
    if generation.model is None:
        return False, f'no model: {generation.reason}: {generation.why}'
    return True, f'a model of {len(generation.model.points)} points: {generation.why}'
