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

"""What a frame is registered to: key frames seen from nearby, half hidden views, the model.

The key frames of a scan, submap by submap: which frames become some, and which can be compared.
"""

import numpy as np

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import inverse, rotation_angle
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import OdometrySettings, Reference
from debris_scanner.tracking.motion_filter import MotionFilter

WITNESS = np.radians(75.0)  # a whole view from so near still tells whether something hides a part


def choose_references(
    motion: MotionFilter,
    keyframes: KeyFrameSet,
    partial: list[Reference],
    surface: Surface | None,
    settings: OdometrySettings,
) -> list[Reference]:
    """References for a frame at a predicted state; empty where nothing known was seen from nearby.

    Args:
        motion: the predicted state.
        keyframes: all so far.
        partial: half hidden views, which bridge the time until a whole side is seen again.
        surface: of the model, if there is one.
        settings: how near is nearby, and how many.
    """
    reach = np.radians(settings.reference_angle_deg)
    angles = keyframes.view_angles(inverse(motion.T_sensor_target), motion.pivot)
    alike = [int(k) for k in np.argsort(angles) if angles[k] < reach]
    if surface is not None:
        chosen = alike[: settings.tracked_keyframes]  # they also know sides that the model lacks
        return [*_of(keyframes, chosen), (surface, np.eye(4))]
    chosen = [k for k in alike if k >= len(keyframes) - settings.recent_keyframes]
    chosen = chosen or alike[: settings.recent_keyframes]  # seen again after a gap
    if len(chosen) == settings.recent_keyframes or not partial:
        return _of(keyframes, chosen)
    if not chosen and len(angles) and angles.min() < WITNESS:
        chosen = [int(angles.argmin())]
    return [*_of(keyframes, chosen), *partial]


def _of(keyframes: KeyFrameSet, chosen: list[int]) -> list[Reference]:
    return [(keyframes.views[k], keyframes.frames[k].T_target_sensor) for k in chosen]


class Submaps:
    """``keyframes``: those of the current submap, ``number``; ``scan_ns``: stamp of the scan's first one."""

    def __init__(self, normals: NormalSettings) -> None:
        self.keyframes = KeyFrameSet(normals)
        self.number, self.scan_ns = 0, 0
        self._normals = normals
        self.path_rad = 0.0  # rad, travelled up to the latest
        self._in_earlier = 0  # key frames

    def begin(self, travelled: float = 0.0) -> None:
        """The next key frames are comparable to none before; meanwhile the target has turned so far, rad."""
        self._in_earlier += len(self.keyframes)
        self.keyframes = KeyFrameSet(self._normals)
        self.number += 1
        self.path_rad += travelled

    def resume(self, keyframes: list[KeyFrame]) -> None:
        """Go on with another process's key frames of a whole scan, in order of time."""
        last = keyframes[-1]
        for keyframe in keyframes:
            if keyframe.submap == last.submap:
                self.keyframes.add(keyframe)
        self._in_earlier = len(keyframes) - len(self.keyframes)
        self.scan_ns, self.number, self.path_rad = keyframes[0].stamp_ns, last.submap, last.path_rad

    def full(self, settings: OdometrySettings) -> str:
        """Why the scan gets no more key frames, in words; empty while it may."""
        return settings.full(self._in_earlier + len(self.keyframes))

    def younger(self, stamp_ns: int, age_ns: int) -> bool:
        """Whether the current submap began less than so long before a stamp."""
        return len(self.keyframes) > 0 and stamp_ns - self.keyframes.frames[0].stamp_ns < age_ns

    def choose(
        self, view: View, motion: MotionFilter, tracked: bool, settings: OdometrySettings
    ) -> KeyFrame | None:
        """Make a frame a key frame if it shows the target turned far enough, and there is room for one."""
        if self.full(settings):
            return None
        if not len(self.keyframes):
            return self.add(view, motion)
        step = np.radians(settings.keyframe_angle_deg)
        T_target_sensor = inverse(motion.T_sensor_target)
        last = self.keyframes.frames[-1]
        turned = rotation_angle(T_target_sensor[:3, :3] @ last.T_target_sensor[:3, :3].T)
        if not tracked:
            if turned <= step:
                return None
            self.path_rad += turned
        elif self.keyframes.view_angles(T_target_sensor, motion.pivot).min() <= step:
            return None  # the model knows this side already
        return self.add(view, motion)

    def add(self, view: View, motion: MotionFilter) -> KeyFrame:
        """Make a frame a key frame, at the filter's pose."""
        stamp_ns, T_target_sensor = view.frame.stamp_ns, inverse(motion.T_sensor_target)
        self.scan_ns = self.scan_ns or stamp_ns
        keyframe = KeyFrame(view.frame, T_target_sensor, self.path_rad, motion.pose_covariance, self.number)
        self.keyframes.add(keyframe, view)
        return keyframe
