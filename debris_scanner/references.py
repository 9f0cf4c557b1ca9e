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

"""What a frame is registered to: key frames seen from nearby, half hidden views, the model."""

import numpy as np

from debris_scanner.frame_fit import Reference
from debris_scanner.geometry import inverse
from debris_scanner.keyframes import KeyFrameSet
from debris_scanner.motion_filter import MotionFilter
from debris_scanner.odometry_settings import OdometrySettings
from debris_scanner.views import Surface

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
