"""Believed frames and their poses; the depth of a bounded number of them is kept for fusion."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from debris_scanner.camera import Camera
from debris_scanner.frames import TargetFrame
from debris_scanner.geometry import Array, compose
from debris_scanner.normals import NormalSettings, fit_normals

UNIT = 1e-4  # m


@dataclass(slots=True)  # one a frame, for hours
class StoredFrame:
    """A frame's pose, relative to a key frame or in the model's target frame, and perhaps its depth."""

    stamp_ns: int
    camera: Camera
    keyframe_ns: int | None  # None: T is T_target_sensor
    T: Array  # T_keyframe_sensor or T_target_sensor, (4, 4)
    depth: NDArray[np.uint16] | None  # in UNIT

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
        depth = self.depth.astype(np.float32) * np.float32(UNIT)
        fitted, normals = fit_normals(depth, self.camera, settings)
        return TargetFrame(self.stamp_ns, self.camera, depth, fitted, normals)


class FrameStore:
    """All poses; at most ``capacity`` depths: when full, every second one is dropped and fewer taken."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.frames: list[StoredFrame] = []
        self._stride = 1
        self._kept = 0

    def add(self, frame: TargetFrame, keyframe_ns: int | None, T: Array) -> None:
        """Take a believed frame; T as in :class:`StoredFrame`."""
        depth = None
        if len(self.frames) % self._stride == 0:
            depth = np.clip(np.rint(frame.depth / UNIT), 0, 65535).astype(np.uint16)
            self._kept += 1
        self.frames.append(StoredFrame(frame.stamp_ns, frame.camera, keyframe_ns, T, depth))
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


class RestoredFrames(Sequence[tuple[TargetFrame, Array]]):
    """Stored frames with their poses T_target_sensor, each restored when it is asked for, not kept.

    Hundreds of frames with their normals take as many megabytes; to restore one takes a millisecond.

    Args:
        stored: frames with depth, posed in the model's target frame.
        settings: of the normals.
    """

    def __init__(self, stored: Sequence[StoredFrame], settings: NormalSettings) -> None:
        self._stored = stored
        self._settings = settings

    def __len__(self) -> int:
        return len(self._stored)

    @overload
    def __getitem__(self, index: int) -> tuple[TargetFrame, Array]: ...

    @overload
    def __getitem__(self, index: slice) -> 'RestoredFrames': ...

    def __getitem__(self, index: int | slice) -> 'tuple[TargetFrame, Array] | RestoredFrames':
        if isinstance(index, slice):
            return RestoredFrames(self._stored[index], self._settings)
        item = self._stored[index]
        return item.restore(self._settings), item.pose({})
