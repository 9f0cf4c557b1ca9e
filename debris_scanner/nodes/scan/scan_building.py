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

"""The composed scanner's models: made and saved in a thread of their own, no frame waits for them."""

import queue
import threading
import time
from collections.abc import Callable

from rclpy.node import Node

from debris_scanner.core.results import INTERRUPTED, ScanResult
from debris_scanner.modelling.model_builder import Generation
from debris_scanner.nodes.lifecycle.worker import Answer, Worker
from debris_scanner.nodes.publishing.model_publisher import ModelPublisher
from debris_scanner.nodes.recovery.scanner_journal import ScannerJournal
from debris_scanner.nodes.scan.deferred_builder import DeferredBuilder
from debris_scanner.nodes.scan.graph_stage import CLOSURE_TO_MODEL
from debris_scanner.nodes.scan.scan_output import ScanOutput, outcome_text
from debris_scanner.nodes.scan.scan_state import ScanState
from debris_scanner.scanner import Scanner

DRAIN_S = 10.0  # what waits when the end is asked for gets this long


class ScanBuilding:
    """Takes the scanner's builder over; owner of the scan for the services.

    Args:
        node: for its log and parameters.
        scanner: whose builder works here from now on.
        frames: worker that takes the frames through the scanner.
        state: of the scan.
        result: makes the scan's result of a generation and the reason of an interruption.
    """

    def __init__(
        self,
        node: Node,
        scanner: Scanner,
        frames: Worker,
        state: ScanState,
        result: Callable[[Generation, str | None], ScanResult],
    ) -> None:
        self._log = node.get_logger()
        self.output = ScanOutput(node)
        self.publisher = ModelPublisher(node)
        self.worker = Worker(self._advance)
        self.builder = scanner.builder
        self._deferred = scanner.builder = DeferredBuilder(self.builder, self.worker)
        self.ended = False
        self.journal: ScannerJournal | None = None
        self._timer = scanner.timer
        self._frames = frames
        self._state = state
        self._result = result
        self._models: queue.SimpleQueue[tuple[int, Generation]] = queue.SimpleQueue()
        self._scan = self._scan_built = 0  # number of the scan, for the frames and for the builder
        self._closed_s: float | None = None

    def resume(self, ended: bool) -> None:
        """Go on with a scan that the journal told the builder of; ``ended`` had it been saved."""
        self.ended = ended
        if not ended and self.builder.T_model_scan is not None:
            self.worker.post(self._generate)

    # in the frames' thread -------------------------------------------------------------------------

    def begin(self) -> None:
        """A new scan: for the frames at once, for the builder after what it was given before."""
        self._scan += 1
        self._closed_s = None
        self.ended = False
        self.hand_over(self._begin)

    def hand_over(self, then: Callable[[], object] | None = None) -> None:
        """Give the worker what a frame gave the builder, and something to do after it."""
        self._deferred.hand_over(then)

    def closed(self) -> None:
        """A closure was accepted."""
        self._closed_s = self._closed_s or time.monotonic()

    def new_model(self) -> Generation | None:
        """The next model to be tracked, if one has come."""
        while not self._models.empty():
            scan, generation = self._models.get()
            if scan == self._scan:
                return generation
        return None

    # in the executor's thread ----------------------------------------------------------------------

    def close(self) -> None:
        """Save what was gathered; without a model the scan counts as interrupted."""
        if not self.ended:
            self.worker.post(self._save_interrupted)
        self.worker.stop()

    def finish_unasked(self, then: Callable[[], None]) -> None:
        """The input has ended; ``then`` is called when all is saved."""
        self.worker.post(lambda: self._log.info(self.finish_now()[1]))
        self.worker.post(then)

    # in the worker's thread ------------------------------------------------------------------------

    def generate_now(self) -> Answer:
        """``~/generate_model``."""
        return outcome_text(self._generate())

    def save_now(self) -> Answer:
        """``~/save_model``."""
        return self.output.save(self._result(self.builder.last or self.builder.generate(), None))

    def finish_now(self) -> Answer:
        """``~/finish``, once the frames that wait have come through."""
        seen = threading.Event()
        self._frames.post(seen.set)
        self.worker.work_until(lambda: seen.is_set() and not self.worker.backlog, DRAIN_S)
        return self._finish(None)

    def _begin(self) -> None:
        self._scan_built += 1
        if self.journal is not None:
            self.journal.restart_models()
        self.output.restart()
        self.publisher.clear()
        self._state.reset()

    def _advance(self) -> None:
        """After everything that came: a generation where one is due."""
        if not self.ended and self.builder.should_rebuild:
            self._generate()

    def _generate(self) -> Generation:
        self._state.generation_began()
        generation = self.builder.generate()
        if self.journal is not None:
            self.journal.generated()
        if generation.model is None:
            self._state.generation_ended(published=False)
            self._log.warning(outcome_text(generation)[1])
            return generation
        self._models.put((self._scan_built, generation))
        self.publisher.publish(generation)
        self._state.generation_ended(published=True)
        if self._closed_s is not None:
            self._timer.add(CLOSURE_TO_MODEL, time.monotonic() - self._closed_s)
            self._closed_s = None
        self._log.info(outcome_text(generation)[1])
        if self.output.folder is not None:  # so that no crash can take it away
            self._log.info(self.output.save(self._result(generation, None))[1])
        return generation

    def _save_interrupted(self) -> None:
        """First as things stand, for who stops us may lose patience; then with the last optimisation."""
        last = self.builder.last or Generation(None, INTERRUPTED, '', {}, None)
        self.output.save(self._result(last, INTERRUPTED))
        self._log.info(self._finish(INTERRUPTED)[1])

    def _finish(self, interrupted: str | None) -> Answer:
        if not self.ended:
            self.ended = True
            generation = self.builder.generate(final=True)
            if generation.model is not None:
                self.publisher.publish(generation)
        last = self.builder.last
        assert last is not None
        answer = self.output.save(self._result(last, interrupted))
        if self.journal is not None and answer[0]:
            self.journal.end()
        return answer
