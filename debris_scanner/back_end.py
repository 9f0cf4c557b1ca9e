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

The offline scan, the composed node and the graph node share this state machine; they differ in the source of
the frames. One thread drives a back end; only :class:`ScanState` may be used by others.

1. ``add`` and ``add_closures`` take the results of the front end for a frame.
2. ``advance`` builds a model when a loop has closed, or when enough of the surface is new.
3. ``finish`` refines all frames once more, builds the last model, and writes the files.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from debris_scanner.core.frames import KeyPose, Model, TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.core.results import INTERRUPTED, ClosureRecord
from debris_scanner.faults import Faults
from debris_scanner.io.result_files import SUMMARY, OutputError, ScanResult, claim, left_alone, write_results
from debris_scanner.io.scan_journal import ScanJournal
from debris_scanner.mapping.closures import Closure, descriptions
from debris_scanner.mapping.descriptors import DescriptorSettings
from debris_scanner.merging import extended
from debris_scanner.modelling.generation import Generation, Progress
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.modelling.placement import KnownModel
from debris_scanner.recorder import FrameCounts, ScanRecorder
from debris_scanner.settings import Settings
from debris_scanner.tracking.odometry import LOST, TRACKING, OdometryEstimate
from debris_scanner.tracking.sensor_path import SensorPath

WAITING, GENERATING, FINISHED = 'waiting', 'generating', 'finished'
CLOSURE_TO_MODEL = 'closure_to_model'
ATTEMPTS_SHARE = 0.2  # of the time of a live scan, over any minute: frames come first
MINUTE_S = 60.0
PATIENCE_GROWTH = 0.1  # new key frames, as a share, before a refused attempt; doubled by each like it

Answer = tuple[bool, str]  # to a request: whether it was done, and a text


class ScanEvents:
    """Events of a scan, for nodes to show; each method does nothing here.

    All but ``state_changed`` are called by the thread that drives the back end.
    """

    def state_changed(self, state: str) -> None:
        """The scan's state has changed."""

    def keyframe_added(self, keyframes: Sequence[KeyPose]) -> None:
        """There is a new key frame, and no model yet."""

    def model_built(self, generation: Generation, final: bool) -> None:
        """A model has passed all checks; after a final one the scan has ended."""

    def model_withdrawn(self, generation: Generation) -> None:
        """A known model that was tracked so far is another target's."""

    def scan_began(self) -> None:
        """A new scan has begun: everything shown is out of date."""

    def log(self, text: str, warning: bool = False) -> None:
        """A message for the user."""


class AttemptBudget:
    """When a scan may try again to build a model, whatever came of the attempts so far.

    Live, a refused attempt is not repeated before what was at fault may have changed: a new closure touches a
    key frame whose closures were rejected, or there are enough new key frames, the more of them the more
    attempts have been refused for the same reason. Attempts also take no more than a share of the time.

    Offline nobody waits for a model. An attempt costs in proportion to the key frames or more, so all of them
    together cost at most twice the last one if each has twice the key frames of the one before.
    """

    def __init__(self) -> None:
        self._attempts: deque[tuple[float, float]] = deque(maxlen=100)  # when the latest began and ended
        self._took = dict[bool, float]()  # s, the latest of each kind: to make or find a model, to ask again
        self._reason = ''  # of the last refusal
        self._refusals = 0  # in a row, for this reason
        self._keyframes = 0  # that there were
        self._at_fault: set[int] = set()  # stamps of key frames
        self._touched = False  # by a closure since

    def note(
        self, began_s: float, ended_s: float, generation: Generation, keyframes: int, again: bool = False
    ) -> None:
        """An attempt has ended, with so many key frames; ``again``: it asked about a model found before."""
        self._attempts.append((began_s, ended_s))
        self._took[again] = ended_s - began_s
        self._keyframes, self._touched = keyframes, False
        reason = generation.reason or ''
        self._refusals = self._refusals + 1 if reason == self._reason else 1
        self._reason = reason
        self._at_fault = generation.optimised.rejected_closures if reason and generation.optimised else set()

    def closure_added(self, closure: Closure) -> None:
        """A closure may have changed what was at fault."""
        self._touched |= not self._at_fault.isdisjoint((closure.from_stamp_ns, closure.to_stamp_ns))

    def allows(self, now_s: float, keyframes: int, live: bool, again: bool = False) -> bool:
        """Whether an attempt may begin with so many key frames; arguments as above."""
        if not self._attempts:
            return True
        if not live:
            return keyframes >= 2 * self._keyframes
        growth = PATIENCE_GROWTH * 2 ** (self._refusals - 1) if self._reason else 0.0
        if not self._touched and keyframes < self._keyframes * (1 + growth):
            return False
        return self._leaves_time(now_s, self._took.get(again, 0.0))

    def _leaves_time(self, now_s: float, takes_s: float) -> bool:
        """Whether an attempt of so many seconds, or more, leaves enough time to the frames."""
        began_s, ended_s = self._attempts[-1]
        if now_s < ended_s + (ended_s - began_s) * (1 / ATTEMPTS_SHARE - 1):
            return False
        since_s = now_s + takes_s - MINUTE_S
        while self._attempts[0][1] <= since_s and len(self._attempts) > 1:
            self._attempts.popleft()
        spent_s = sum(max(0.0, ended - max(began, since_s)) for began, ended in self._attempts)
        return not spent_s or spent_s + takes_s <= ATTEMPTS_SHARE * MINUTE_S * (1 + 1e-9)


class ScanState:
    """waiting, scanning, generating, tracking, lost or finished; ``changed`` is called at every change.

    Thread-safe. Odometry reports scanning, tracking and lost. Only the back end knows that a model is being
    built, is built but not yet tracked, or is the last one. Before the first frame, and while the input is
    silent, the scan waits.
    """

    def __init__(self, changed: Callable[[str], None]) -> None:
        self._changed = changed
        self._lock = threading.Lock()
        self._silent = False
        self._announced: int | None  # submap of a published model that is not tracked yet
        self.value = ''
        self.reset()

    def reset(self) -> None:
        """Begin a new scan."""
        self._begin()
        self._update()

    def odometry(self, estimate_state: str, tracked: bool, submap: int) -> None:
        """Take odometry's state at a frame, its submap, and whether it was registered to a model.

        A model is tracked only from the submap that it was built in: in a later one, scanning continues.
        """
        self._odometry = estimate_state
        if tracked or submap != self._announced:
            self._announced = None
        self._update()

    def silent(self, silent: bool) -> None:
        """Whether frames have ceased to come."""
        if silent != self._silent:
            self._silent = silent
            self._update()

    def finished(self) -> None:
        """The scan has ended; only a reset begins another."""
        self._finished = True
        self._update()

    def ending(self, what: str, done: int, total: int) -> None:
        """How far a step of the end has come; a :data:`Progress`."""
        self.phase = phase_of(what, done, total)

    def generation_began(self) -> None:
        """A model is being built."""
        self._generating = True
        self._update()

    def generation_ended(self, submap: int | None) -> None:
        """The model of a submap is built and published for tracking; None: it is not."""
        self._generating = False
        self._announced = submap
        self._update()

    def _begin(self) -> None:
        self._odometry = WAITING
        self._generating = self._finished = self._silent = False
        self._announced = None
        self.phase = ''  # what the end of the scan is at; empty before and after

    def _update(self) -> None:
        with self._lock:
            value = self._odometry
            if self._finished:
                value = FINISHED
            elif self._generating and value not in (LOST, TRACKING):
                value = GENERATING
            elif self._silent:
                value = WAITING
            elif self._announced is not None and value not in (LOST, TRACKING):
                value = GENERATING
            if value != self.value:
                self.value = value
                self._changed(value)


class ScanOutput:
    """The output folder of a scan, and whether its files could be written.

    It is this process's alone until :meth:`close`. A scan without a model leaves the model of another scan as
    it is: see :func:`write_results`.

    Args:
        folder: None saves nothing.

    Raises:
        OutputError: the folder cannot be made or written to, or another process writes to it.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._claim = contextlib.ExitStack()
        if folder is not None:
            self._claim.enter_context(claim(folder))
        self.problem = ''  # why the last attempt to save failed
        self.restart()

    def close(self) -> None:
        """Leave the folder to others."""
        self._claim.close()

    def restart(self) -> None:
        """Begin a new scan now."""
        self._start = time.monotonic()
        self.owned = False  # whether a model in the folder is of this scan
        self.remark = ''  # why the last files are elsewhere

    def save(self, result: ScanResult, name: str = '') -> Answer:
        """Write all files; the answer names them, or the reason why there are none.

        Args:
            result: of the scan.
            name: of a folder inside the output folder; empty: the output folder itself.
        """
        outcome = 'a model' if result.model is not None else f'no model: {result.reason}'
        if self.folder is None:
            return False, f'{outcome}; not saved: the parameter output_dir is empty'
        try:
            asked = self.folder / name
            folder = write_results(asked, result, time.monotonic() - self._start, self.owned and not name)
        except OutputError as error:  # a full disk does not end the scan
            self.problem = f'not saved: {error}'
            return False, f'{outcome}, {self.problem}'
        self.problem, self.remark = '', left_alone(asked, folder)
        self.owned = self.owned or (result.model is not None and not name)
        what = folder / ('model.ply' if result.model is not None else SUMMARY)
        return True, f'{outcome}, saved: {what}'


def phase_of(what: str, done: int, total: int) -> str:
    """What the end of a scan is at, in words, by its progress."""
    return f'{what} {done} of {total}' if done < total else 'making the model'


class BackEnd:
    """Key frames, poses and closures of one scan after another, and the models built from them.

    Args:
        builder: of the models; used by the back end alone.
        counts: called when a result is made.
        events: for the node to show.
        output: where results are saved.
        faults: of this process; a frame, an attempt or a figure that raises is left out.
    """

    def __init__(
        self,
        builder: ModelBuilder,
        counts: Callable[[], FrameCounts],
        events: ScanEvents | None = None,
        output: ScanOutput | None = None,
        faults: Faults | None = None,
    ) -> None:
        self.builder = builder
        self.events = events or ScanEvents()
        self.output = output or ScanOutput(None)
        self.faults = faults or Faults()
        self.state = ScanState(self.events.state_changed)
        self.journal: ScanJournal | None = None
        self.timer = builder.timer
        self.extend = False  # add to a known model what it lacks
        self.sensor_path = SensorPath()  # whoever knows how the sensor moves adds to it
        # to describe key frames with at the end, where no detector does
        self.descriptor: DescriptorSettings | None = None
        self._counts = counts
        self._clear()

    def _clear(self) -> None:
        self.builder.reset()
        self._budget = AttemptBudget()
        self.recorder = ScanRecorder()
        self.ended = False
        self._submap = 0  # of the latest estimate
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
        """Take the settings that may change during a scan."""
        chosen = self.builder.settings
        chosen.fusion, chosen.verdict = settings.fusion, settings.verdict

    # input from the front end ------------------------------------------------------------------------

    def add(
        self, estimate: OdometryEstimate, target: TargetFrame | None, closures: Sequence[Closure] = ()
    ) -> None:
        """Add the estimate of a frame, the frame, and its closures.

        A rejected frame may be None, and so may one that is not kept for the model.
        """
        with self.faults.contained('a frame', self.recorder.rejected):
            self._add_frame(estimate, target if estimate.accepted else None)
        with self.faults.contained('the closures of a key frame'):
            self.add_closures(closures)

    def _add_frame(self, estimate: OdometryEstimate, frame: TargetFrame | None) -> None:
        self._submap = estimate.submap
        if frame is not None:
            self._add_accepted(estimate, frame)
        if self.journal is not None:
            self.journal.frame(estimate, frame, self.builder)
        self.recorder.add_estimate(estimate, self.builder.T_model_scan)
        if not estimate.accepted:
            self.builder.lost += 1

    def _add_accepted(self, estimate: OdometryEstimate, target: TargetFrame) -> None:
        if estimate.keyframe is not None:
            self.builder.add_keyframe(estimate.keyframe, estimate.tracked)
            if not self.builder.has_model:
                self.events.keyframe_added(self.builder.active)
        if estimate.usable_for_mapping:
            self.builder.add_frame(target, inverse(estimate.T_sensor_target), estimate.tracked)

    def add_hypotheses(self, records: Sequence[ClosureRecord]) -> None:
        """Add closure hypotheses, accepted or not, for summary.json."""
        if records:
            self.recorder.closures += records
            if self.journal is not None:
                self.journal.hypotheses(records)

    def add_closure(self, closure: Closure, since_s: float | None = None) -> None:
        """Add an accepted closure between known key frames; ``since_s``: when it was found."""
        self.builder.add_closure(closure)
        self._budget.closure_added(closure)
        if self.journal is not None:
            self.journal.closure(closure)
        if not self.builder.has_model:
            self._closed_s = self._closed_s or since_s or time.monotonic()

    def add_closures(self, closures: Sequence[Closure]) -> None:
        """Add all hypotheses of one key frame; those with a key frame that was lost close nothing."""
        self.add_hypotheses([c.record for c in closures])
        known = self.builder.graph.keyframes.index
        for closure in closures:
            if closure.accepted and closure.from_stamp_ns in known and closure.to_stamp_ns in known:
                self.add_closure(closure)

    # the state machine -------------------------------------------------------------------------------

    def advance(self, live: bool = False) -> Generation | None:
        """Build a model if one is due; ``live`` leaves most of the time to the frames."""
        if self.ended or not self.builder.should_rebuild:
            return None
        began_s, keyframes = time.monotonic(), len(self.builder.keyframes)
        # offline, a known model is looked for whenever the key frames have grown by enough: that is cheap
        again = self.builder.known is not None and self.builder.T_model_scan is not None
        if (live or self.builder.known is None) and not self._budget.allows(began_s, keyframes, live, again):
            return None
        generation = self.generate()
        self._budget.note(began_s, time.monotonic(), generation, keyframes, again)
        if live:
            self.builder.rest()
        return generation

    def generate(self, final: bool = False, progress: Progress | None = None) -> Generation:
        """Try to build a model from everything so far; publish and save it, in case of a crash.

        Args:
            final: refine and fuse all stored frames, instead of the key frames alone.
            progress: called during long steps.
        """
        if not final:
            self.state.generation_began()
        generation = self.builder.attempt(self.faults, final, progress)
        if self.journal is not None:
            self.journal.generated(self.builder)
        if generation.model is None:
            self.state.generation_ended(None)
            if generation.withdrawn:
                with self.faults.contained('what is shown of the model'):
                    self.events.model_withdrawn(generation)
            self.events.log(describe(generation)[1], warning=True)
            return generation
        with self.faults.contained('what is shown of the model') as shown:
            self.events.model_built(generation, final)
        self._time_first_model()
        self.state.generation_ended(None if final or shown.reason else self._submap)
        self.events.log(describe(generation)[1])
        if not final and self.output.folder is not None:
            self.events.log(self._save(self.result(generation))[1])
        return generation

    def save(self, name: str = '') -> Answer:
        """Write the files of the current state; whether they have a model, and their names, in words."""
        saved, text = self._save(result := self.result(self.builder.last or self.builder.generate()), name)
        return saved and result.model is not None, text

    def _save(self, result: ScanResult, name: str = '') -> Answer:
        answer = self.output.save(result, name)
        if self.output.owned and self.journal is not None:
            self.journal.saved()
        if answer[0] and self.output.remark:
            self.events.log(self.output.remark, warning=True)
        return answer

    def end(self, interrupted: str | None = None, progress: Progress | None = None) -> ScanResult:
        """Build the last model, accept no more frames, and return the result.

        Args:
            interrupted: reason to give if an interrupted scan has no model.
            progress: called during long steps.
        """
        if not self.ended:
            self.ended = True
            generation = self.generate(final=True, progress=progress)
            if self.extend and self.builder.known is not None and generation.model is not None:
                with self.faults.contained('what the scan adds to the model'), self.timer.stage('fusion'):
                    self.builder.last = replace(generation, model=_extended(self.builder, self.builder.known))
                    self.events.model_built(self.builder.last, final=True)
            if self.descriptor is not None:
                with self.timer.stage('descriptor'), self.faults.contained('the descriptors'):
                    self.recorder.descriptions = descriptions(self.builder.graph.keyframes, self.descriptor)
            self.state.finished()
        last = self.builder.last
        assert last is not None
        return self.result(last, interrupted)

    def finish(self, interrupted: str | None = None) -> Answer:
        """End the scan and write its files."""
        if self.journal is not None and self.journal.ended:
            self.state.phase = ''
            return True, 'the scan was finished and saved before this process was started'
        self.state.phase = 'relaxing the graph'
        answer = self._save(self.end(interrupted, self.state.ending))
        self.state.phase = ''
        if self.journal is not None and answer[0]:
            self.journal.end()
        return answer

    def save_interrupted(self) -> Answer:
        """Write the files of the current state at once: the process may be killed during a new generation."""
        return self._save(self.result_so_far())

    def result_so_far(self) -> ScanResult:
        """The result without another generation: of what was gathered, for a scan that is interrupted."""
        return self.result(self.builder.last or Generation(None, INTERRUPTED, '', {}, None), INTERRUPTED)

    def result(self, generation: Generation, interrupted: str | None = None) -> ScanResult:
        """The scan's result after a generation; arguments as :meth:`end`."""
        given = (self._counts(), interrupted, self.sensor_path, self.faults)
        result = self.recorder.result(self.builder, generation, *given)
        if unused := (result.mass_properties or {}).get('odometry_unused'):
            self.events.log(f'dynamics in the frame of the sensor: {unused}', warning=True)
        return result

    def _time_first_model(self) -> None:
        if self._closed_s is not None:
            self.timer.add(CLOSURE_TO_MODEL, time.monotonic() - self._closed_s)
            self._closed_s = None

    # continuing after a crash ------------------------------------------------------------------------

    def resume(self, journal: ScanJournal) -> bool:
        """Continue a journal's scan, and write the journal from now on; False if it holds no scan.

        If :attr:`resumed_model`, the caller builds a model at once.
        """
        try:
            journal.replay(self)
        except (KeyError, ValueError, TypeError) as error:  # written by another release
            self.events.log(f'{journal.path} cannot be read, a new scan begins: {error}', warning=True)
            journal.restart()
            self._clear()
        self.journal = journal
        self.ended = journal.ended
        if self.ended:
            self.state.finished()
        self.output.owned = journal.owned
        return journal.last_stamp_ns is not None

    @property
    def resumed_model(self) -> bool:
        """Whether the scan had a model, which only a new generation brings back."""
        return not self.ended and self.builder.T_model_scan is not None and self.builder.last is None


def _extended(builder: ModelBuilder, known: KnownModel) -> Model:
    """A known model with what the scan shows and it lacks."""
    fusion = builder.settings.fusion
    return extended(
        known, builder.tracked_frames(fusion.max_frames), fusion, builder.graph.keyframes.coloured()
    )


def describe(generation: Generation) -> Answer:
    """Whether a generation has a model, and a text about it."""
    if generation.model is None:
        what = 'the model is given up' if generation.withdrawn else 'no model'
        return False, f'{what}: {generation.reason}: {generation.why}'
    return True, f'a model of {len(generation.model.points)} points: {generation.why}'
