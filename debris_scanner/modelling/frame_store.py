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

"""Accepted frames and their poses; the depth of a bounded number of them is kept for fusion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import LazyFrames, TargetFrame
from debris_scanner.core.geometry import Array, compose
from debris_scanner.sensing.normals import NormalSettings, fit_normals
from debris_scanner.sensing.packing import metres, quantised


@dataclass(slots=True)  # one for each frame, for hours
class StoredFrame:
    """A frame's pose, relative to a key frame or in the model's target frame, and perhaps its depth."""

    stamp_ns: int
    camera: Camera
    keyframe_ns: int | None  # None: T is T_target_sensor
    T: Array  # T_keyframe_sensor or T_target_sensor, (4, 4)
    depth: NDArray[np.uint16] | None  # in multiples of the unit
    unit: float = 0.0  # m

    def pose(self, keyframe_poses: dict[int, Array]) -> Array:
        """T_target_sensor (4, 4) with the key frames at the given poses."""
        return self.T if self.keyframe_ns is None else compose(keyframe_poses[self.keyframe_ns], self.T)

    def restore(self, settings: NormalSettings) -> TargetFrame:
        """The target frame again, normals fitted anew.

        Raises:
            ValueError: if the depth was not kept.
        """
        if self.depth is None:
            raise ValueError(f'the depth of frame {self.stamp_ns} was not kept')
        depth = metres(self.depth, self.unit)
        fitted, normals = fit_normals(depth, self.camera, settings)
        return TargetFrame(self.stamp_ns, self.camera, depth, fitted, normals)


class FrameStore:
    """All poses, and at most ``capacity`` depths: when full, every second is dropped and fewer are taken."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.frames: list[StoredFrame] = []
        self._stride = 1
        self._kept = 0

    def add(self, frame: TargetFrame, keyframe_ns: int | None, T: Array) -> None:
        """Append an accepted frame; T as in :class:`StoredFrame`."""
        depth, unit = None, 0.0
        if len(self.frames) % self._stride == 0:
            unit, depth = quantised(frame.depth)
            self._kept += 1
        self.frames.append(StoredFrame(frame.stamp_ns, frame.camera, keyframe_ns, T, depth, unit))
        if self._kept > self.capacity:
            self._stride *= 2
            for n, stored in enumerate(self.frames):
                if n % self._stride:
                    stored.depth = None
            self._kept = sum(f.depth is not None for f in self.frames)

    @property
    def with_depth(self) -> list[StoredFrame]:
        """Frames whose depth was kept."""
        return [f for f in self.frames if f.depth is not None]


def restored(stored: Sequence[StoredFrame], settings: NormalSettings) -> LazyFrames[StoredFrame]:
    """Stored frames with depth, posed in the model's target frame, their normals fitted by the settings."""
    return LazyFrames(stored, lambda item: (item.restore(settings), item.pose({})))
