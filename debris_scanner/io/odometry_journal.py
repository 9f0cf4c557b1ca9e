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

"""The journal that a killed odometry resumes from: key frames, the tracked model, and the filter.

Key frames and models are appended; the filter, which changes with every frame, is overwritten in place.
Its record holds the number of models adopted so far, so a kill between the two files never leaves the filter
in one target frame and key frames in another.
"""

from pathlib import Path
from typing import Any

import numpy as np

from debris_scanner.core.frames import KeyFrame, Model
from debris_scanner.io.journal import Journal, Record, StateSlot, read_records
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import pack_keyframe, unpack_keyframe
from debris_scanner.tracking.motion_filter import MotionFilter, MotionSettings
from debris_scanner.tracking.odometry import Odometry, OdometryEstimate

RECORDS, STATE = 'odometry.journal', 'odometry.state'
_STATE = (np.ndarray, float)  # types of the filter's changing attributes
_KEYFRAME, _MODEL, _FILTER = 'keyframe', 'model', 'filter'


class OdometryJournal:
    """Written after every frame and every adopted model.

    Args:
        folder: of the journals.
        normals: settings of the key frames' plane fit.

    Raises:
        OSError: the files cannot be opened.
    """

    def __init__(self, folder: Path, normals: NormalSettings) -> None:
        self._normals = normals
        self._records = Journal(folder / RECORDS)
        self._slot = StateSlot(folder / STATE)
        self._adoptions = 0
        self.stamp_ns = 0  # of the filter

    @property
    def problem(self) -> str:
        """Why the last record could not be written."""
        return self._records.problem

    def resume(self, odometry: Odometry) -> bool:
        """Bring a reset odometry to where the last one stopped; False if there is none."""
        state, records = StateSlot.read(self._slot.path), list(self._records.take_found())
        if state is None or not records or 'inertia' not in state.values:
            return False  # nothing, or written by an earlier release
        self._adoptions = int(state.values['adoptions'])
        known = [r for r in records if r.values['adoptions'] <= self._adoptions]
        keyframes, model = self._replayed(known)
        if not keyframes:
            return False
        motion = _filter(state.values, odometry.motion)
        self.stamp_ns = int(state.values['stamp_ns'])
        odometry.resume(keyframes, motion, self.stamp_ns, bool(state.values.get('consistent', 1)))
        if model is not None:
            odometry.adopt_model(model, {k.stamp_ns: k.T_target_sensor for k in keyframes})
        odometry.T_target_scanning = state.values.get('scanning', odometry.T_target_scanning)
        return True

    def note(self, odometry: Odometry, estimate: OdometryEstimate) -> None:
        """Record a frame."""
        if not estimate.accepted or odometry.filter is None:
            return
        if estimate.keyframe is not None:
            values = pack_keyframe(estimate.keyframe)
            values |= {'adoptions': self._adoptions, 'tracked': odometry.model is not None}
            self._records.append(_KEYFRAME, values, estimate.stamp_ns)
        self.stamp_ns = estimate.stamp_ns
        self._write_state(odometry, odometry.filter)

    def adopted(self, odometry: Odometry) -> None:
        """Record an adopted model, or that it was dropped."""
        frames, nothing = odometry.keyframes.frames, np.zeros((0, 3), np.float32)
        model = odometry.model or Model(nothing, nothing, nothing, nothing.astype(np.int32))
        written = self._records.append(
            _MODEL,
            {
                'adoptions': self._adoptions + 1,
                'points': model.points,
                'normals': model.normals,
                'stamps': np.array([k.stamp_ns for k in frames], np.int64),
                'poses': np.array([k.T_target_sensor for k in frames]),
            },
        )
        if written:  # else the next process adopts the model again from its topic
            self._adoptions += 1
            if odometry.filter is not None:  # else with the first frame that comes
                self._write_state(odometry, odometry.filter)

    def restart(self) -> None:
        """Start a new scan."""
        self._records.restart()
        self._slot.restart()
        self._adoptions = self.stamp_ns = 0

    def _write_state(self, odometry: Odometry, motion: MotionFilter) -> None:
        state = {name: value for name, value in vars(motion).items() if isinstance(value, _STATE)}
        state |= {'stamp_ns': self.stamp_ns, 'adoptions': self._adoptions}
        state |= {
            'consistent': int(odometry.consistent_with_prediction),
            'scanning': odometry.T_target_scanning,
        }
        self._slot.write(_FILTER, state)

    def _replayed(self, records: list[Record]) -> tuple[list[KeyFrame], Model | None]:
        keyframes: dict[int, KeyFrame] = {}
        model = None
        for record in records:
            values = record.values
            if record.kind == _KEYFRAME:
                keyframes[record.key] = unpack_keyframe(values, self._normals)
                continue
            nothing = np.zeros((0, 3))
            model = None
            if len(values['points']):  # else it was dropped
                model = Model(
                    values['points'], values['normals'], nothing.astype(np.float32), nothing.astype(np.int32)
                )
            for stamp_ns, T in zip(values['stamps'].tolist(), values['poses'], strict=True):
                if stamp_ns in keyframes:
                    keyframes[stamp_ns].T_target_sensor = T
        return [keyframes[stamp_ns] for stamp_ns in sorted(keyframes)], model


def read_scan_keyframes(folder: Path, after_ns: int, normals: NormalSettings) -> list[KeyFrame]:
    """Key frames later than a stamp that odometry made before there was a model, in order of time."""
    records = read_records(folder / RECORDS, after_ns)
    scanned = [r for r in records if r.kind == _KEYFRAME and not r.values['tracked']]
    return [unpack_keyframe(r.values, normals) for r in scanned]


def _filter(values: dict[str, Any], settings: MotionSettings) -> MotionFilter:
    motion = MotionFilter(values['centre'], settings, values['footprint'])
    for name, value in vars(motion).items():
        if isinstance(value, _STATE):
            setattr(motion, name, values[name])
    return motion
