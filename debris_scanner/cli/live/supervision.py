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

"""The course of a live scan: start the nodes and the source, follow the scan, finish and save."""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from debris_scanner.cli.errors import CliError
from debris_scanner.cli.live.monitor import VIEWER, Monitor
from debris_scanner.cli.live.processes import BAD_INPUT, INTERRUPT_S, Children, Respawn
from debris_scanner.cli.live.progress_line import ProgressLine
from debris_scanner.cli.live.source import Source
from debris_scanner.cli.live.view import LiveView
from debris_scanner.interruption import Interruption
from debris_scanner.nodes.inputs.cameras import parameters_of
from debris_scanner.settings import Settings, render

STAGES = ('preprocess', 'odometry', 'closure', 'graph')
COMPOSED = ('scanner',)
INPUTS = ('preprocess', 'scanner')

START_S = 90.0
FINISH_S = 600.0
ASK_AGAIN_S = 5.0  # an owner that tells no phase so long after a request to finish has not heard it
UNHEARD_S = 6 * ASK_AGAIN_S  # then it is interrupted, which needs no discovery
MOST_RESTARTS = 5  # of a camera's driver
DRAINED_S = 2.0  # without a frame for so long after the source's end, all frames have been processed
TICK_S = 0.2
JOURNALS = 'journal'  # folder that exists while a scan runs


class NodeFiles:
    """Parameter files for the nodes: the settings for all, and the parameters of each.

    Args:
        folder: temporary.
        settings: of the scanner.
        remaps: of topics, as ``points:=/camera/points``.
    """

    def __init__(self, folder: Path, settings: Settings, remaps: Sequence[str]) -> None:
        self._folder = folder
        self._settings = folder / 'settings.yaml'
        self._settings.write_text(render(settings))
        self._remaps = [part for remap in remaps for part in ('-r', remap)]

    def arguments(self, node: str, parameters: dict[str, Any]) -> list[str]:
        """The command line of a node."""
        own = self._folder / f'{node}.yaml'
        own.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
        files = [self._settings, own] if parameters else [self._settings]
        return ['--ros-args', *(p for f in files for p in ('--params-file', str(f))), *self._remaps]


class LiveScan:
    """One live scan, from the start of its nodes to its files."""

    def __init__(
        self,
        args: argparse.Namespace,
        source: Source,
        files: NodeFiles,
        children: Children,
        interruption: Interruption,
    ) -> None:
        self._args = args
        self._source = source
        self._files = files
        self._children = children
        self._interruption = interruption
        self._stages = COMPOSED if args.composed else STAGES
        self._owner = self._stages[-1]  # the node that owns the scan and saves it
        self._line = ProgressLine()
        self._restarts = 0
        self._respawn = Respawn(children, self._stages)
        self._view = None if args.view is None else LiveView(children, args.open)

    def run(self, conclude: Callable[[], int]) -> int:
        """The whole of it; returns the exit code.

        Args:
            conclude: called once the scan is saved; tells the user, and returns the exit code.

        Raises:
            ChildFailed: a node ended unexpectedly.
            CliError: the nodes did not find each other, or did not finish.
            KeyboardInterrupt: interrupted before there was anything to save.
        """
        self._start_nodes()
        self._monitor = Monitor(self._owner)
        try:
            self._await_nodes()
            self._follow_scan()
            self._end_source()
            self._line.end()
            self._finish()
            self._line.end()
            return self._conclude(conclude)
        finally:
            self._line.end()
            self._monitor.close()

    def _start(self, node: str, parameters: dict[str, Any]) -> None:
        self._children.start(node, self._files.arguments(node, parameters))

    def _start_nodes(self) -> None:
        for stage in self._stages:
            parameters: dict[str, Any] = {'journal_dir': str((self._args.out / JOURNALS).resolve())}
            if stage in INPUTS and self._source.node is not None:
                parameters['input_reliability'] = 'reliable'  # as our own publishers are
            if stage in INPUTS:
                parameters |= {'depth_scale': self._args.depth_scale, 'axes': self._args.axes}
            if stage in INPUTS and self._source.camera is not None:
                given = {'axes': self._args.axes} if self._args.axes else {}
                parameters |= parameters_of(self._source.camera) | given
            if stage == self._owner:
                parameters['output_dir'] = str(self._args.out.resolve())
                if self._args.model is not None:
                    parameters['model'] = str(self._args.model.resolve())
                    parameters['extend'] = self._args.extend
            self._start(stage, parameters)
        self._start_source()
        if self._view is not None:
            results = str(self._args.out.resolve())
            self._start(VIEWER, {'port': self._args.view, 'owner': self._owner, 'result_dir': results})

    def _start_source(self) -> None:
        if self._source.node is not None:  # it waits for the stages: a frame sent earlier would be lost
            waits = {'wait_for_stages': ' '.join(self._stages), 'wait_for_subscribers': START_S}
            self._start(self._source.node, self._source.parameters | waits)

    def _await_nodes(self) -> None:
        """Wait until all stages have found each other."""
        deadline = time.monotonic() + START_S
        while not self._monitor.ready(self._stages):
            self._line.show('starting the nodes')
            self._tick()
            if self._interruption.requested:
                raise KeyboardInterrupt
            if time.monotonic() > deadline:
                missing = self._monitor.missing(self._stages)
                raise CliError(f'the nodes did not find each other in {START_S:.0f} s: {missing}')

    def _follow_scan(self) -> None:
        """Show the progress until the input ends, the model was tracked for long enough, or an interrupt."""
        args, monitor = self._args, self._monitor
        tracking_since: float | None = None
        while not self._interruption.requested:
            self._tick()
            idle_s = monitor.idle_s
            progress = self._input_problem() if idle_s is None else str(monitor.progress())
            self._line.show(monitor.driver_problem or progress)
            node = self._source.node
            if node is not None and not self._children.running(node) and not self._restart_camera(node):
                self._report_source_failure(node)
                return
            if monitor.value(self._owner, 'finished') == '1':
                return  # somebody called ~/finish, as the page's button does
            is_camera = self._source.node is None or self._source.is_camera
            if (
                is_camera
                and args.idle_seconds is not None
                and idle_s is not None
                and idle_s > args.idle_seconds
            ):
                return
            if args.track_seconds is not None and monitor.state == 'tracking':
                tracking_since = tracking_since or time.monotonic()
                if time.monotonic() - tracking_since > args.track_seconds:
                    return

    def _input_problem(self) -> str:
        """Why no frame has arrived yet, and what to do."""
        problem = self._monitor.input_problem
        if problem and self._source.node is None:
            problem += ' (start the driver, or name it: --camera, or its topics: --remap)'
        return problem

    def _end_source(self) -> None:
        """Stop the source, if it has not ended, and wait until its last frames have arrived."""
        node = self._source.node
        if node is None:
            return
        self._children.interrupt(node)
        while self._children.running(node) or (
            self._monitor.idle_s is not None and self._monitor.idle_s < DRAINED_S
        ):
            self._tick()

    def _finish(self) -> None:
        """Ask the owner to save the scan.

        Raises:
            CliError: it did not finish, or could not save.
        """
        answer, start, asked_s = None, time.monotonic(), 0.0
        deadline, heard_s = start + FINISH_S, start
        interrupted = self._interruption.requested
        while not interrupted and (answer is None or not answer.done()):
            phase = self._monitor.value(self._owner, 'phase')
            # the service of an owner that was killed looks ready until discovery knows of its end
            if answer is None or (not phase and time.monotonic() - asked_s > ASK_AGAIN_S):
                answer, asked_s = self._monitor.ask_to_finish(), time.monotonic()
            waited = f'{time.monotonic() - start:.0f} s'
            self._line.show(f'finishing: {phase or self._monitor.state}, {waited}')
            if self._owner in self._tick():
                answer, heard_s = None, time.monotonic()  # it was restarted: ask again
            elif phase:
                heard_s = time.monotonic()
            if time.monotonic() > deadline:
                raise CliError(f'{self._owner} did not finish in {FINISH_S:.0f} s')
            interrupted = self._interruption.requested or time.monotonic() - heard_s > UNHEARD_S
        if interrupted:
            if not self._interruption.requested:
                self._line.end()
                print(f'debris-scan live: {self._owner} hears no request: interrupting it', file=sys.stderr)
            self._children.interrupt(self._owner)
            self._children.wait(self._owner, FINISH_S)
            if self._children.exit_code(self._owner):
                raise CliError(f'the scan is not saved: {self._children.last_words(self._owner)}')
        elif answer is not None and (reply := answer.result()) is not None and not reply.success:
            raise CliError(reply.message)  # it is not saved

    def _conclude(self, conclude: Callable[[], int]) -> int:
        """Tell the outcome; the page, if there is one, shows it for as long as somebody looks."""
        if self._view is not None:
            self._view.show_result(self._monitor)  # while the latched model is still published
        self._children.interrupt(*self._stages)
        for stage in self._stages:
            self._children.wait(stage, INTERRUPT_S)
        code = conclude()
        if self._view is None:
            return code
        self._view.show_result(self._monitor)  # again, with all files
        already = self._interruption.requested  # then it takes another Ctrl-C to end the page
        self._view.linger(self._monitor, lambda: self._interruption.requested and not already)
        return code

    def _restart_camera(self, node: str) -> bool:
        """Restart a camera's driver that was killed or crashed; not one that ended by itself."""
        killed = self._children.exit_code(node) not in (0, BAD_INPUT)
        if not (self._source.is_camera and killed and self._restarts < MOST_RESTARTS):
            return False
        self._restarts += 1
        self._line.end()
        how = self._children.last_words(node)
        print(f'debris-scan live: {node} ended ({how}) and was restarted', file=sys.stderr)
        self._children.restart(node)
        return True

    def _report_source_failure(self, node: str) -> None:
        if self._children.exit_code(node):
            self._line.end()
            how = self._children.last_words(node)
            print(f'debris-scan live: {node} ended ({how}): finishing the scan', file=sys.stderr)

    def _tick(self) -> list[str]:
        """Process messages for TICK_S and check the nodes; returns those that were restarted."""
        self._monitor.spin(TICK_S)
        restarted = self._respawn.check()
        source = [self._source.node] if self._source.node else []
        self._children.check(source, may_fail=[VIEWER, *self._respawn.watched])
        if self._view is not None and (text := self._view.news(self._monitor)):
            self._line.end()
            print(f'debris-scan live: {text}', file=sys.stderr)
        return restarted
