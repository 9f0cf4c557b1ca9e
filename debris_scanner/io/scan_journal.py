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

"""Everything that a back end was given, in order: the next process goes on from it after a crash.

The depth of a frame is written only where the back end keeps it, so a journal grows no faster than the scan.
"""

import dataclasses
import itertools
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.core.geometry import inverse
from debris_scanner.core.results import ClosureRecord
from debris_scanner.io.closure_records import closure_values, read_closure_values
from debris_scanner.io.journal import Journal, read_records
from debris_scanner.mapping.closures import Closure
from debris_scanner.modelling.model_builder import ModelBuilder
from debris_scanner.modelling.placement import Answer
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import pack_frame, unpack_frame
from debris_scanner.tracking.odometry import OdometryEstimate

FILE = 'graph.journal'
_FRAME, _HYPOTHESES, _CLOSURE, _MODEL = 'frame', 'candidates', 'closure', 'model'
_SAVED, _END = 'saved', 'end'
_PLAIN = (
    *('stamp_ns', 'scan_ns', 'state', 'accepted', 'rejected', 'submap', 'tracked', 'path_rad'),
    'usable_for_mapping',
)
_ARRAYS = ('T_sensor_target', 'covariance', 'omega_target', 'omega_sigma', 'velocity')


def make_way(folder: Path) -> Path | None:
    """Clear a folder of journals for a new scan; returns where those of a scan that was never saved are now.

    Raises:
        OSError: the folder cannot be renamed.
    """
    empty = not any(path.stat().st_size for path in folder.glob('*.journal'))
    if empty or any(record.kind == _END for record in read_records(folder / FILE)):
        shutil.rmtree(folder, ignore_errors=True)
        return None
    asides = (folder.with_name(f'{folder.name}_{n}') for n in itertools.count(1))
    return folder.rename(next(path for path in asides if not path.exists()))


class Replayed(Protocol):
    """A back end that was just reset, into which a journal is replayed."""

    builder: ModelBuilder

    def add(self, estimate: OdometryEstimate, target: TargetFrame | None) -> None:
        """Take a frame."""

    def add_hypotheses(self, records: Sequence[ClosureRecord]) -> None:
        """Take closure hypotheses."""

    def add_closure(self, closure: Closure) -> None:
        """Take an accepted closure."""


class ScanJournal:
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
        self._forget()

    def _forget(self) -> None:
        self.last_stamp_ns: int | None = None  # of the frames that were replayed
        self.last_scan_ns = 0
        self.ended = False  # the scan had been finished and saved
        self.owned = False  # the model in the output folder is of this scan

    @property
    def path(self) -> Path:
        """The file."""
        return self._journal.path

    @property
    def problem(self) -> str:
        """Why the last record could not be written."""
        return self._journal.problem

    def restart(self) -> None:
        """A new scan."""
        self._journal.restart()
        self._forget()

    def frame(self, estimate: OdometryEstimate, frame: TargetFrame | None, builder: ModelBuilder) -> None:
        """A frame, after the builder was given it; None for one that was rejected."""
        values: dict[str, Any] = {name: getattr(estimate, name) for name in (*_PLAIN, *_ARRAYS)}
        values['keyframe'] = estimate.keyframe is not None
        if frame is not None:
            stored = builder.store.frames[-1:] if estimate.usable_for_mapping else []
            kept = values['keyframe'] or any(f.depth is not None for f in stored)
            values |= pack_frame(frame, with_depth=kept)
        self._journal.append(_FRAME, values, estimate.stamp_ns)

    def hypotheses(self, records: Sequence[ClosureRecord]) -> None:
        """Closure hypotheses."""
        self._journal.append(_HYPOTHESES, {'records': [closure_values(r) for r in records]})

    def closure(self, closure: Closure) -> None:
        """A closure that the builder was given."""
        values = dataclasses.asdict(closure)
        self._journal.append(_CLOSURE, values | {'T_from_to': np.asarray(closure.T_from_to)})

    def generated(self, builder: ModelBuilder) -> None:
        """After a generation: closures that it left, and where a model put the key frames."""
        values: dict[str, Any] = {
            'closures': [[c.from_stamp_ns, c.to_stamp_ns] for c in builder.graph.closures]
        }
        if builder.T_model_scan is not None:
            values['T_model_scan'] = builder.T_model_scan
            values['disagreed'] = builder.answer.disagreed
            values['stamps'] = np.array([k.stamp_ns for k in builder.keyframes], np.int64)
            values['poses'] = np.array([k.T_target_sensor for k in builder.keyframes])
            values['slipped'] = [k.stamp_ns for k in builder.keyframes if k.slipped]
        elif builder.withdrawn_ns >= 0:
            values['withdrawn_ns'] = builder.withdrawn_ns
        self._journal.append(_MODEL, values)

    def saved(self) -> None:
        """A model of this scan was saved; noted once."""
        if not self.owned:
            self.owned = True
            self._journal.append(_SAVED, {})

    def end(self) -> None:
        """The scan was finished and saved."""
        self._journal.append(_END, {})

    def replay(self, back_end: Replayed) -> None:
        """Give everything to a back end that was just reset, and that writes no journal yet.

        Raises:
            KeyError, ValueError, TypeError: a journal of another release.
        """
        closures: dict[tuple[int, int], Closure] = {}
        replayed: dict[str, Callable[[dict[str, Any]], None]] = {
            _FRAME: lambda values: self._replay_frame(back_end, values),
            _HYPOTHESES: lambda values: back_end.add_hypotheses(
                [read_closure_values(r) for r in values['records']]
            ),
            _CLOSURE: lambda values: closures.update(
                {(values['from_stamp_ns'], values['to_stamp_ns']): Closure(**values)}
            ),
            _MODEL: lambda values: _replay_model(back_end.builder, closures, values),
            _SAVED: lambda _: setattr(self, 'owned', True),
            _END: lambda _: setattr(self, 'ended', True),
        }
        for record in self._journal.take_found():
            replayed[record.kind](record.values)
        known = back_end.builder.graph.keyframes.index
        for closure in closures.values():
            if closure.from_stamp_ns in known and closure.to_stamp_ns in known:
                back_end.add_closure(closure)

    def _replay_frame(self, back_end: Replayed, values: dict[str, Any]) -> None:
        frame = keyframe = None
        if 'camera' in values:
            frame = unpack_frame(values, self._normals if values['keyframe'] else None)
        if frame is not None and values['keyframe']:
            T_target_sensor = inverse(values['T_sensor_target'])
            keyframe = KeyFrame(
                frame, T_target_sensor, values['path_rad'], values['covariance'], values['submap']
            )
        estimate = OdometryEstimate(
            **{name: values[name] for name in (*_PLAIN, *_ARRAYS)},
            stats=RegistrationStats(),
            observability=None,
            keyframe=keyframe,
        )
        back_end.add(estimate, frame)
        self.last_stamp_ns, self.last_scan_ns = estimate.stamp_ns, estimate.scan_ns
        stored = back_end.builder.store.frames
        if frame is not None and not frame.depth.size and stored:  # a record before it is missing
            stored[-1].depth = None


def _replay_model(
    builder: ModelBuilder, closures: dict[tuple[int, int], Closure], values: dict[str, Any]
) -> None:
    kept = {(a, b) for a, b in values['closures']}
    for pair in [p for p in closures if p not in kept]:
        del closures[pair]
    if 'withdrawn_ns' in values:
        builder.withdraw(values['withdrawn_ns'])
    if 'T_model_scan' in values:
        builder.T_model_scan = values['T_model_scan']
        builder.answer = Answer('', '', disagreed=values['disagreed'])
        poses = dict(zip(values['stamps'].tolist(), values['poses'], strict=True))
        for keyframe in builder.keyframes:
            keyframe.T_target_sensor = poses.get(keyframe.stamp_ns, keyframe.T_target_sensor)
        builder.note_slips(values['slipped'])
