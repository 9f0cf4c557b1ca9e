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

"""The key frames of a scan, submap by submap: which frames become some, and which can be compared."""

import numpy as np

from debris_scanner.frames import KeyFrame
from debris_scanner.geometry import inverse, rotation_angle
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.motion_filter import MotionFilter
from debris_scanner.normals import NormalSettings
from debris_scanner.odometry_settings import OdometrySettings
from debris_scanner.views import View


class Submaps:
    """``keyframes``: those of the current submap, ``number``; ``scan_ns``: stamp of the scan's first one."""

    def __init__(self, normals: NormalSettings) -> None:
        self.keyframes = KeyFrameSet(normals)
        self.number, self.scan_ns = 0, 0
        self._normals = normals
        self._path = 0.0  # rad, travelled up to the latest
        self._in_earlier = 0  # key frames

    def begin(self, travelled: float = 0.0) -> None:
        """The next key frames are comparable to none before; meanwhile the target has turned so far, rad."""
        self._in_earlier += len(self.keyframes)
        self.keyframes = KeyFrameSet(self._normals)
        self.number += 1
        self._path += travelled

    def resume(self, keyframes: list[KeyFrame]) -> None:
        """Go on with another process's key frames of a whole scan, in order of time."""
        last = keyframes[-1]
        for keyframe in keyframes:
            if keyframe.submap == last.submap:
                self.keyframes.add(keyframe)
        self._in_earlier = len(keyframes) - len(self.keyframes)
        self.scan_ns, self.number, self._path = keyframes[0].stamp_ns, last.submap, last.path_rad

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
            self._path += turned
        elif self.keyframes.view_angles(T_target_sensor, motion.pivot).min() <= step:
            return None  # the model knows this side already
        return self.add(view, motion)

    def add(self, view: View, motion: MotionFilter) -> KeyFrame:
        """Make a frame a key frame, at the filter's pose."""
        stamp_ns, T_target_sensor = view.frame.stamp_ns, inverse(motion.T_sensor_target)
        self.scan_ns = self.scan_ns or stamp_ns
        keyframe = KeyFrame(view.frame, T_target_sensor, self._path, motion.pose_covariance, self.number)
        self.keyframes.add(keyframe, view)
        return keyframe
