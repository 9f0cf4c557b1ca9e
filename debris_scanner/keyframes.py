"""The set of key frames: their views, poses, and which of them look from where."""

from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np

from debris_scanner.frames import KeyFrame, KeyPose, TargetFrame
from debris_scanner.geometry import Array, compose
from debris_scanner.kept_views import KeptViews
from debris_scanner.normals import NormalSettings
from debris_scanner.views import View

PREPARED = 64  # views a set keeps prepared, 80 to 160 MB: of the side that is seen, and of its neighbours


class KeyFrameSet:
    """Key frames in order of time, each with its view; found by stamp, index or view angle.

    Args:
        normals: by which the key frames' planes were fitted, to fit those of views put away anew.
        prepared: views that are kept prepared; None takes ``PREPARED``.
    """

    def __init__(self, normals: NormalSettings, prepared: int | None = None) -> None:
        self.frames: list[KeyPose] = []
        self.views = KeptViews(prepared or PREPARED, normals)
        self.index: dict[int, int] = {}  # by stamp
        self._coloured: list[int] = []

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, keyframe: KeyFrame, view: View | None = None) -> None:
        """Append a key frame: each stage moves its own pose; the view is prepared already or here."""
        k = self.index[keyframe.stamp_ns] = len(self.frames)
        self.frames.append(KeyPose(keyframe.stamp_ns, keyframe.T_target_sensor, keyframe.path_rad))
        self.views.append(view or View(keyframe.frame))
        if keyframe.frame.rgb is not None:
            self._coloured.append(k)

    @property
    def posed(self) -> 'PosedFrames':
        """All frames with their poses as they are when asked for."""
        return PosedFrames(self, range(len(self)))

    def coloured(self) -> Iterator[KeyFrame]:
        """Those with colours, restored one by one."""
        for k in self._coloured:
            pose = self.frames[k]
            yield KeyFrame(self.views.frame(k), pose.T_target_sensor, pose.path_rad)

    @property
    def centre(self) -> Array:
        """Where the target is (3,): mean of what the key frames see, target frame."""
        T, seen = np.array([k.T_target_sensor for k in self.frames]), np.array(self.views.centroids)
        return np.asarray((np.einsum('nij,nj->ni', T[:, :3, :3], seen) + T[:, :3, 3]).mean(axis=0))

    def view_angles(self, T_target_sensor: Array, centre: Array) -> Array:
        """Angle (n,), radians, between each key frame's direction of view onto the centre and a pose's.

        Args:
            T_target_sensor: (4, 4).
            centre: (3,), target frame.
        """
        eyes = np.array([k.T_target_sensor[:3, 3] for k in self.frames]).reshape(-1, 3) - centre
        eye = T_target_sensor[:3, 3] - centre
        cosine = eyes @ eye / (np.linalg.norm(eyes, axis=1) * np.linalg.norm(eye))
        return np.arccos(np.clip(cosine, -1.0, 1.0))

    def move(self, poses: dict[int, Array], T_new_old: Array) -> None:
        """Set optimised poses T_target_sensor by stamp; the others follow by T_new_old."""
        for keyframe in self.frames:
            moved = poses.get(keyframe.stamp_ns)
            keyframe.T_target_sensor = (
                compose(T_new_old, keyframe.T_target_sensor) if moved is None else moved
            )


class PosedFrames(Sequence[tuple[TargetFrame, Array]]):
    """Key frames' target frames with T_target_sensor, each restored when it is asked for, not kept."""

    def __init__(self, keyframes: KeyFrameSet, chosen: Sequence[int]) -> None:
        self._keyframes = keyframes
        self._chosen = chosen

    def __len__(self) -> int:
        return len(self._chosen)

    @overload
    def __getitem__(self, index: int) -> tuple[TargetFrame, Array]: ...

    @overload
    def __getitem__(self, index: slice) -> 'PosedFrames': ...

    def __getitem__(self, index: int | slice) -> 'tuple[TargetFrame, Array] | PosedFrames':
        if isinstance(index, slice):
            return PosedFrames(self._keyframes, self._chosen[index])
        k = self._chosen[index]
        return self._keyframes.views.frame(k), self._keyframes.frames[k].T_target_sensor
