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

"""Runs the back end of ``graph`` and ``scanner`` in a thread of its own, with its topics and files."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from std_msgs.msg import String

from debris_scanner.back_end import Answer, BackEnd, ScanEvents, ScanOutput, describe
from debris_scanner.core.frames import KeyPose
from debris_scanner.core.parameters import ParameterError
from debris_scanner.core.results import INTERRUPTED
from debris_scanner.io.known_models import read_known_model
from debris_scanner.modelling.generation import Generation
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare, declare_live, declare_path
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.worker import Job, Worker
from debris_scanner.nodes.publishing.model_publisher import ModelPublisher
from debris_scanner.recorder import FrameCounts
from debris_scanner.settings import Settings
from debris_scanner.stages import make_model_builder
from msg_adapters.records import check_values

MODEL = "a scan's folder, or a mesh in metres, to track; empty: build a model"
SAVE_AS = 'folder inside output_dir for ~/save_model; empty: output_dir'
DRAIN_S = 10.0  # how long a scan that ends waits for messages that are still on their way


def _check_name(name: str) -> None:
    """Check that ``save_as`` names a folder inside another one."""
    if name and not re.fullmatch(r'\w[\w .-]*', name):
        raise ParameterError(f'save_as names a folder inside output_dir, got {name!r}')


class ScanThread(ScanEvents):
    """Drives a back end from one worker, to which nodes post what they receive.

    Only this node publishes ``state``: a late joiner would receive two values from two latched publishers,
    and only the back end knows that a model is being built.

    Args:
        node: whose parameters and topics these are.
        settings: of the builder.
        counts: of frames that never came here.
        between: called in the worker after each task, before the back end advances.
        drained: called at the end of the scan; returns a condition that holds once all input is processed.
        nice: niceness of the worker.
    """

    def __init__(
        self,
        node: StageNode,
        settings: Settings,
        counts: Callable[[], FrameCounts],
        between: Callable[[], None],
        drained: Callable[[], Callable[[], bool]],
        nice: int = 0,
    ) -> None:
        self._node = node
        self._between = between
        self._drained = drained
        self._states = node.create_publisher(String, 'state', qos.latched())
        folder, known, extend, self._save_as = self.declare(node)
        self.publisher = ModelPublisher(node)
        self.worker = Worker(self._advance, nice, node.faults)
        model = read_known_model(known) if known else None
        output = ScanOutput(folder)
        builder = make_model_builder(settings, node.timer, model)
        self.back_end = BackEnd(builder, counts, self, output, faults=node.faults)
        self.back_end.extend = extend
        node.create_timer(0.2, self.worker.check)

    @staticmethod
    def declare(node: StageNode) -> tuple[Path | None, Path | None, bool, Callable[[], str]]:
        """Declare the parameters; returns the output folder, the known model, ``extend``, and ``save_as``."""
        ModelPublisher.declare(node)
        return (
            declare_path(node, 'output_dir', 'folder for the results; empty: save nothing'),
            declare_path(node, 'model', MODEL),
            bool(declare(node, 'extend', False, 'at the end, add to the model what it lacks')),
            declare_live(node, 'save_as', '', SAVE_AS, check=_check_name),
        )

    def _advance(self) -> None:
        if not self.back_end.ended:
            self._between()
            self.back_end.advance(live=True)

    def measured_values(self) -> dict[str, float | str]:
        """The sensor as measured so far, and the checks of the latest verdict, for the diagnostics."""
        sensor, last = self.back_end.builder.sensor, self.back_end.builder.last
        values = {} if sensor is None else {f'sensor.{name}': v for name, v in sensor.in_brief().items()}
        return values | check_values(() if last is None else last.checks)

    # events of the back end ---------------------------------------------------------------------------

    def state_changed(self, state: str) -> None:
        """Publish ``state``."""
        self._states.publish(String(data=state))

    def keyframe_added(self, keyframes: Sequence[KeyPose]) -> None:
        """Publish ``graph_markers`` of a scan that has no model yet."""
        self.publisher.publish_graph(keyframes)

    def model_built(self, generation: Generation, final: bool) -> None:
        """Publish all topics of a model."""
        self.publisher.publish(generation)

    def model_withdrawn(self, generation: Generation) -> None:
        """Clear the published model, which makes odometry drop it."""
        self.publisher.clear()

    def scan_began(self) -> None:
        """Clear the published model."""
        self.publisher.clear()

    def log(self, text: str, warning: bool = False) -> None:
        """Log with the node's logger."""
        logger = self._node.get_logger()
        if warning:  # rclpy allows one severity per line of code
            logger.warning(text)
        else:
            logger.info(text)

    # requests of services, in the worker ---------------------------------------------------------------

    def generate_now(self) -> Answer:
        """``~/generate_model``."""
        if self.back_end.ended:  # a model of the key frames alone must not replace the refined one
            return False, 'the scan is finished; ~/reset starts a new one'
        return describe(self.back_end.generate())

    def save_now(self) -> Answer:
        """``~/save_model``."""
        return self.back_end.save(self._save_as())

    def finish_now(self) -> Answer:
        """``~/finish``, once all input has been processed."""
        self._drain()
        return self.back_end.finish()

    def _interrupted(self) -> Answer:
        self.back_end.save_interrupted()
        self._drain()
        return self.back_end.finish(INTERRUPTED)

    def _drain(self) -> None:
        if not self.back_end.ended:
            self.worker.work_until(self._drained(), DRAIN_S)

    # in the executor -----------------------------------------------------------------------------------

    def ask_to_finish(self) -> Job:
        """Queue :meth:`finish_now`; the phase tells at once that the request was heard."""
        self.back_end.state.phase = 'waiting for the last messages'
        return self.worker.ask(self.finish_now)

    def finish_automatically(self, then: Callable[[], None]) -> None:
        """Finish at the end of the input; ``then`` is called once all is saved."""
        self.worker.post(lambda: self.log(self.finish_now()[1]))
        self.worker.post(then)

    def close(self) -> None:
        """Save the scan; without a model it counts as interrupted."""
        if not self.back_end.ended:
            self.worker.post(lambda: self.log(self._interrupted()[1]))
        self.worker.stop()
        self._node.unsaved = bool(self.back_end.output.problem)

    def forget(self) -> None:
        """Clear the published model and the journal, and leave the output folder to others."""
        self.publisher.clear()
        self.back_end.output.close()
        if self.back_end.journal is not None:
            self.back_end.journal.restart()
