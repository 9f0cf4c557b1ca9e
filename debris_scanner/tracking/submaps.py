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

"""Submaps: which frames become key frames, and which key frames a frame is registered to.

A submap is a run of key frames whose relative poses are known. The target turns by an unknown angle while it
is out of sight for long, so :class:`Submaps` begins a new one then. :func:`choose_references` picks the
references of a frame: key frames seen from nearby, partially occluded views, and the model once there is one.
"""

import numpy as np

from debris_scanner.core.frames import KeyFrame
from debris_scanner.core.geometry import inverse, rotation_angle
from debris_scanner.mapping.keyframes import KeyFrameSet
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.views import Surface, View
from debris_scanner.tracking.gating import OdometrySettings, Reference
from debris_scanner.tracking.motion_filter import MotionFilter

OCCLUSION_CHECK_ANGLE = np.radians(75.0)  # an unoccluded view from within it still reveals an occlusion
CROWDED = 100  # key frames; of a tracked target with more, they lie further apart in proportion


class Submaps:
    """The key frames of a scan, submap by submap.

    ``keyframes``: those of the current submap, ``number``. ``scan_ns``: stamp of the scan's first key frame.
    ``path_rad``: rotation travelled up to the latest key frame, rad.
    """

    def __init__(self, normals: NormalSettings) -> None:
        self.keyframes = KeyFrameSet(normals)
        self.number, self.scan_ns = 0, 0
        self.path_rad = 0.0
        self._normals = normals
        self._earlier = 0  # key frames of earlier submaps

    def begin(self, travelled: float = 0.0) -> None:
        """Begin a submap, whose key frames cannot be compared with earlier ones; travelled meanwhile, rad."""
        self._earlier += len(self.keyframes)
        offset = self.keyframes.views.offset
        self.keyframes = KeyFrameSet(self._normals)
        self.keyframes.views.offset = offset
        self.number += 1
        self.path_rad += travelled

    def resume(self, keyframes: list[KeyFrame]) -> None:
        """Continue with all key frames that another process had, in order of time."""
        last = keyframes[-1]
        for keyframe in keyframes:
            if keyframe.submap == last.submap:
                self.keyframes.add(keyframe)
        self._earlier = len(keyframes) - len(self.keyframes)
        self.scan_ns, self.number, self.path_rad = keyframes[0].stamp_ns, last.submap, last.path_rad

    def full(self, settings: OdometrySettings) -> str:
        """Why the scan gets no more key frames; empty while it may."""
        return settings.full(self._earlier + len(self.keyframes))

    def younger(self, stamp_ns: int, age_ns: int) -> bool:
        """Whether the current submap began less than ``age_ns`` before a stamp."""
        return len(self.keyframes) > 0 and stamp_ns - self.keyframes.frames[0].stamp_ns < age_ns

    def add_if_turned(
        self, view: View, motion: MotionFilter, tracked: bool, settings: OdometrySettings
    ) -> KeyFrame | None:
        """Make a frame a key frame if the target has turned far enough and the scan is not full."""
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
        else:
            apart = step * max(1.0, len(self.keyframes) / CROWDED)
            if self.keyframes.view_angles(T_target_sensor, motion.pivot).min() <= apart:
                return None  # this side is mapped
        return self.add(view, motion)

    def add(self, view: View, motion: MotionFilter) -> KeyFrame:
        """Make a frame a key frame, at the filter's pose."""
        stamp_ns, T_target_sensor = view.frame.stamp_ns, inverse(motion.T_sensor_target)
        self.scan_ns = self.scan_ns or stamp_ns
        keyframe = KeyFrame(view.frame, T_target_sensor, self.path_rad, motion.pose_covariance, self.number)
        self.keyframes.add(keyframe, view)
        return keyframe


def choose_references(
    motion: MotionFilter,
    keyframes: KeyFrameSet,
    partial: list[Reference],
    surface: Surface | None,
    settings: OdometrySettings,
) -> list[Reference]:
    """References for a frame at a predicted state; empty if no reference was seen from nearby.

    Args:
        motion: the predicted state.
        keyframes: of the current submap.
        partial: partially occluded views, used until the target is unoccluded again.
        surface: of the model, if there is one.
        settings: the largest angle, and the number of key frames.
    """
    reach = np.radians(settings.reference_angle_deg)
    angles = keyframes.view_angles(inverse(motion.T_sensor_target), motion.pivot)
    near = [int(k) for k in np.argsort(angles) if angles[k] < reach]
    if surface is not None:
        chosen = near[: settings.tracked_keyframes]  # they also show sides that the model lacks
        return [*_references(keyframes, chosen), (surface, np.eye(4))]
    chosen = [k for k in near if k >= len(keyframes) - settings.recent_keyframes]
    chosen = chosen or near[: settings.recent_keyframes]  # the side is seen again after a gap
    if len(chosen) == settings.recent_keyframes or not partial:
        return _references(keyframes, chosen)
    if not chosen and len(angles) and angles.min() < OCCLUSION_CHECK_ANGLE:
        chosen = [int(angles.argmin())]
    return [*_references(keyframes, chosen), *partial]


def _references(keyframes: KeyFrameSet, chosen: list[int]) -> list[Reference]:
    return [(keyframes.views[k], keyframes.frames[k].T_target_sensor) for k in chosen]
