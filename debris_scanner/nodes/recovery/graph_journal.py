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

"""What a graph node that was killed goes on from: everything that its stage was given, in order.

The depth of a frame is written only where the stage keeps it, so a journal grows no faster than the scan.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.results import ClosureRecord
from debris_scanner.io.journal import Journal
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.nodes.publishing.estimates import Verdict
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import pack_frame, unpack_frame
from msg_adapters.poses import StampedOdometry

if TYPE_CHECKING:
    from debris_scanner.nodes.scan.graph_stage import GraphStage

FILE = 'graph.journal'
_FRAME, _CANDIDATES, _CLOSURE, _MODEL, _END = 'frame', 'candidates', 'closure', 'model', 'end'
_ESTIMATE = ('T_sensor_target', 'covariance', 'twist', 'twist_covariance')


class GraphJournal:
    """Notes of one scan.

    Args:
        folder: of the journals.
        normals: how the planes of key frames are fitted again.

    Raises:
        OSError: the file cannot be opened.
    """

    def __init__(self, folder: Path, normals: NormalSettings) -> None:
        self._journal = Journal(folder / FILE)
        self._normals = normals
        self.last: Verdict | None = None  # of the frames that were replayed
        self.ended = False  # the scan had been finished and saved

    @property
    def problem(self) -> str:
        """Why the last record could not be written."""
        return self._journal.problem

    def restart(self) -> None:
        """A new scan."""
        self._journal.restart()
        self.last, self.ended = None, False

    def frame(
        self, verdict: Verdict, estimate: StampedOdometry, frame: TargetFrame | None, with_depth: bool
    ) -> None:
        """A frame; None for one that was not believed."""
        values: dict[str, Any] = {'verdict': dataclasses.asdict(verdict), 'frame_id': estimate.frame_id}
        values |= {name: getattr(estimate, name) for name in _ESTIMATE}
        if frame is not None:
            values |= pack_frame(frame, with_depth)
        self._journal.append(_FRAME, values, verdict.stamp_ns)

    def candidates(self, records: list[ClosureRecord]) -> None:
        """Hypotheses."""
        self._journal.append(_CANDIDATES, {'records': [dataclasses.asdict(r) for r in records]})

    def closure(self, closure: Closure) -> None:
        """One that the builder was given."""
        values = dataclasses.asdict(closure)
        self._journal.append(_CLOSURE, values | {'T_from_to': np.asarray(closure.T_from_to)})

    def generated(self, builder: ModelBuilder) -> None:
        """After a generation: closures that it left, and where a model put the key frames."""
        values: dict[str, Any] = {
            'closures': [[c.from_stamp_ns, c.to_stamp_ns] for c in builder.graph.closures]
        }
        if builder.T_model_scan is not None:
            values['T_model_scan'] = builder.T_model_scan
            values['stamps'] = np.array([k.stamp_ns for k in builder.keyframes], np.int64)
            values['poses'] = np.array([k.T_target_sensor for k in builder.keyframes])
        self._journal.append(_MODEL, values)

    def end(self) -> None:
        """The scan was finished and saved."""
        self._journal.append(_END, {})

    def replay(self, stage: 'GraphStage') -> None:
        """Give everything to a stage that was just reset.

        Raises:
            KeyError, ValueError, TypeError: a journal of another release.
        """
        closures: dict[tuple[int, int], Closure] = {}
        replayed: dict[str, Callable[[dict[str, Any]], None]] = {
            _FRAME: lambda values: self._replay_frame(stage, values),
            _CANDIDATES: lambda values: stage.note_candidates(
                [ClosureRecord(**r) for r in values['records']]
            ),
            _CLOSURE: lambda values: closures.update(
                {(values['from_stamp_ns'], values['to_stamp_ns']): Closure(**values)}
            ),
            _MODEL: lambda values: _replay_model(stage, closures, values),
            _END: lambda _: setattr(self, 'ended', True),
        }
        for record in self._journal.take_found():
            replayed[record.kind](record.values)
        known = stage.builder.graph.keyframes.index
        for closure in closures.values():
            if closure.from_stamp_ns in known and closure.to_stamp_ns in known:
                stage.builder.add_closure(closure)

    def _replay_frame(self, stage: 'GraphStage', values: dict[str, Any]) -> None:
        verdict = self.last = Verdict(**values['verdict'])
        estimate = StampedOdometry(
            stamp_ns=verdict.stamp_ns,
            frame_id=values['frame_id'],
            child_frame_id=verdict.frame_id,
            **{name: values[name] for name in _ESTIMATE},
        )
        frame = None
        if 'camera' in values:
            frame = unpack_frame(values, self._normals if verdict.keyframe else None)
        stage.add(verdict, estimate, frame)
        if frame is not None and not frame.depth.size:  # a record before it is missing
            stage.builder.store.frames[-1].depth = None


def _replay_model(
    stage: 'GraphStage', closures: dict[tuple[int, int], Closure], values: dict[str, Any]
) -> None:
    kept = {(a, b) for a, b in values['closures']}
    for pair in [p for p in closures if p not in kept]:
        del closures[pair]
    if 'T_model_scan' in values:
        stage.builder.T_model_scan = values['T_model_scan']
        poses = dict(zip(values['stamps'].tolist(), values['poses'], strict=True))
        for keyframe in stage.builder.keyframes:
            keyframe.T_target_sensor = poses.get(keyframe.stamp_ns, keyframe.T_target_sensor)
