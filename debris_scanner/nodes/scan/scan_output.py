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

"""The output folder of a scan that runs in a node."""

import time
from pathlib import Path

from rclpy.node import Node

from debris_scanner.core.results import ScanResult
from debris_scanner.io.result_files import OutputError, check_output_dir, write_results
from debris_scanner.modelling.model_builder import Generation
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.worker import Answer


def outcome_text(generation: Generation) -> Answer:
    """Whether a model came of a generation, and in words what did."""
    if generation.model is None:
        return False, f'no model: {generation.reason}: {generation.why}'
    return True, f'a model of {len(generation.model.points)} points: {generation.why}'


class ScanOutput:
    """Writes results where the parameter ``output_dir`` says; the folder is checked at the start.

    Raises:
        OutputError: the folder cannot be made or written to.
    """

    def __init__(self, node: Node) -> None:
        folder = declare(node, 'output_dir', '', 'folder for the results; empty: nothing is saved')
        self.folder = Path(folder) if folder else None
        if self.folder is not None:
            check_output_dir(self.folder)
        self.problem = ''  # why the last attempt to save failed
        self.restart()

    def restart(self) -> None:
        """A new scan begins now."""
        self._start = time.monotonic()

    def save(self, result: ScanResult) -> Answer:
        """Write all files; the answer names them, or says why there are none."""
        outcome = 'a model' if result.model is not None else f'no model: {result.reason}'
        if self.folder is None:
            return False, f'{outcome}; not saved, for the parameter output_dir is empty'
        try:
            write_results(self.folder, result, time.monotonic() - self._start)
        except OutputError as error:  # a full disk ends no scan
            self.problem = f'not saved: {error}'
            return False, f'{outcome}, {self.problem}'
        self.problem = ''
        what = self.folder / ('model.ply' if result.model is not None else 'summary.json')
        return True, f'{outcome}, saved: {what}'
