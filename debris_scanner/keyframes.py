"""The set of key frames: their views, poses, and which of them look from where."""

import dataclasses

import numpy as np

from debris_scanner.frames import KeyFrame
from debris_scanner.geometry import Array, compose
from debris_scanner.views import View


class KeyFrameSet:
    """Key frames in order of time, each with its prepared view; found by stamp, index or view angle."""

    def __init__(self) -> None:
        self.frames: list[KeyFrame] = []
        self.views: list[View] = []
        self.index: dict[int, int] = {}  # by stamp
        self._centroids: list[Array] = []  # view frame

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, keyframe: KeyFrame, view: View | None = None) -> None:
        """Append a copy of a key frame: each stage moves its own; the view is prepared already or here."""
        self.index[keyframe.stamp_ns] = len(self.frames)
        self.frames.append(dataclasses.replace(keyframe))
        self.views.append(view or View(keyframe.frame))
        self._centroids.append(self.views[-1].centroid)

    @property
    def centre(self) -> Array:
        """Where the target is (3,): mean of what the key frames see, target frame."""
        T, seen = np.array([k.T_target_sensor for k in self.frames]), np.array(self._centroids)
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
