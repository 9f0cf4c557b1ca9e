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
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import KeyPose, LazyFrames, TargetFrame
from debris_scanner.core.geometry import Array, compose, inverse, rotation_angle
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import metres, quantised
from debris_scanner.tracking.cadence import Cadence

KEPT_BYTES = 128 << 20  # of restored frames: 200 with windows of 200 pixels square
UNBROKEN = 10  # frames at the usual rate: no longer apart are two frames of a target that is tracked on


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

    def restore(self, settings: NormalSettings, offset: DepthOffset = NO_OFFSET) -> TargetFrame:
        """The target frame again, freed from an offset of the sensor, normals fitted anew.

        Raises:
            ValueError: if the depth was not kept.
        """
        if self.depth is None:
            raise ValueError(f'the depth of frame {self.stamp_ns} was not kept')
        return offset.target_frame(self.stamp_ns, self.camera, metres(self.depth, self.unit), settings)


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
            unit, depth = quantised(frame.measured)
            self._kept += 1
        self.frames.append(StoredFrame(frame.stamp_ns, frame.camera, keyframe_ns, T, depth, unit))
        if self._kept > self.capacity:
            self._stride *= 2
            for n, stored in enumerate(self.frames):
                if n % self._stride:
                    stored.depth = None
            self._kept = sum(f.depth is not None for f in self.frames)

    def forget_between(self, first_ns: int, last_ns: int) -> None:
        """Forget frames between two key frames: how far the target had turned at them is not known."""
        self.frames = [f for f in self.frames if not first_ns < f.stamp_ns < last_ns]
        self._kept = sum(f.depth is not None for f in self.frames)

    @property
    def with_depth(self) -> list[StoredFrame]:
        """Frames whose depth was kept."""
        return [f for f in self.frames if f.depth is not None]


def spread(count: int, most: int) -> list[int]:
    """At most so many indices below ``count``, evenly spread."""
    return [int(n) for n in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def unbroken_ns(cadence: Cadence) -> float:
    """How long after each other two frames may come of a target that is tracked on, ns."""
    return cadence.span_s(UNBROKEN) * 1e9


def followed(frames: Sequence[StoredFrame], stamps_ns: Sequence[int]) -> list[bool]:
    """Whether the target was in sight all the time up to each of some stamps, from the one before.

    Args:
        frames: all of a scan, in order of time.
        stamps_ns: of some of them, in order of time.
    """
    seen_ns = np.array([f.stamp_ns for f in frames], np.int64)
    longest_ns = unbroken_ns(Cadence(seen_ns.tolist()))
    lost = seen_ns[1:][np.diff(seen_ns) > longest_ns]
    return [True, *(not ((lost > a) & (lost <= b)).any() for a, b in pairwise(stamps_ns))]


class Restorer:
    """Restores stored frames, freed from an offset, and keeps the first ones while there is room.

    They are needed in the same order again and again, to be refined, fused and looked past. If the latest
    ones were kept instead, none would still be there when its turn comes.
    """

    def __init__(
        self, settings: NormalSettings, offset: DepthOffset = NO_OFFSET, room: int = KEPT_BYTES
    ) -> None:
        self._settings, self._offset = settings, offset
        self._kept, self._room = dict[int, TargetFrame](), room

    def __call__(self, item: StoredFrame) -> TargetFrame:
        """The target frame of a stored one, as by :meth:`StoredFrame.restore`."""
        frame = self._kept.get(item.stamp_ns)
        if frame is None:
            frame = item.restore(self._settings, self._offset)
            size = frame.depth.nbytes + frame.depth_fit.nbytes + frame.normals.nbytes
            if size <= self._room:
                self._room -= size
                self._kept[item.stamp_ns] = frame
        return frame

    def posed(self, stored: Sequence[StoredFrame]) -> LazyFrames[StoredFrame]:
        """Stored frames with depth, posed in the model's target frame."""
        return LazyFrames(stored, lambda item: (self(item), item.pose({})))


def between(
    frames: Sequence[StoredFrame], keyframes: Sequence[KeyPose], most: int
) -> list[tuple[StoredFrame, bool]]:
    """Frames to become key frames where these lie far apart; whether each is tracked on from the one before.

    They are as far apart as key frames usually are, or farther if there were too many.

    Args:
        frames: all of a scan, in order of time.
        keyframes: of one submap, in order of time.
        most: so many at most.
    """
    poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
    turns = [rotation_angle(inverse(a)[:3, :3] @ b[:3, :3]) for a, b in pairwise(poses.values())]
    spacing = float(np.median(turns)) if turns else np.inf
    posed = [f for f in frames if f.keyframe_ns is None or f.keyframe_ns in poses]
    chosen = _spaced(posed, poses, spacing)
    while len(chosen) > most:
        spacing *= len(chosen) / most
        chosen = _spaced(posed, poses, spacing)
    return chosen


def _spaced(
    frames: Sequence[StoredFrame], poses: dict[int, Array], spacing: float
) -> list[tuple[StoredFrame, bool]]:
    """Frames with depth that lie a turn, rad, after the last key frame or chosen one before them."""
    chosen: list[tuple[StoredFrame, bool]] = []
    last: Array | None = None
    unbroken, before_ns = True, frames[0].stamp_ns if frames else 0
    longest_ns = unbroken_ns(Cadence(f.stamp_ns for f in frames))
    for frame in frames:
        unbroken &= frame.stamp_ns - before_ns <= longest_ns
        before_ns = frame.stamp_ns
        if frame.stamp_ns in poses:
            last, unbroken = poses[frame.stamp_ns], True
        elif last is not None and frame.depth is not None:
            T = frame.pose(poses)
            if rotation_angle(last[:3, :3].T @ T[:3, :3]) > spacing:
                chosen.append((frame, unbroken))
                last, unbroken = T, True
    return chosen


def reassign(frames: Sequence[StoredFrame], keyframes: Sequence[KeyPose]) -> None:
    """Let each frame move with the latest key frame before it, of which there may be more than there were."""
    poses = {k.stamp_ns: k.T_target_sensor for k in keyframes}
    stamps = np.array([k.stamp_ns for k in keyframes], np.int64)
    for frame in frames:
        if frame.keyframe_ns is not None and frame.keyframe_ns not in poses:
            continue  # of another submap
        k = int(np.searchsorted(stamps, frame.stamp_ns, side='right')) - 1
        if k >= 0 and stamps[k] != frame.keyframe_ns:
            T, frame.keyframe_ns = frame.pose(poses), int(stamps[k])
            frame.T = compose(inverse(keyframes[k].T_target_sensor), T)
