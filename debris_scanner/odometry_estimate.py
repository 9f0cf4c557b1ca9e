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

"""What the odometry says of one frame."""

from dataclasses import dataclass
from typing import Any

from debris_scanner.frame_fit import FrameFit
from debris_scanner.frames import KeyFrame
from debris_scanner.geometry import Array
from debris_scanner.motion_filter import MotionFilter
from debris_scanner.registration import Agreement
from debris_scanner.views import View


@dataclass(frozen=True)
class OdometryEstimate:
    """What the filter says of one frame."""

    stamp_ns: int
    state: str
    accepted: bool  # the gate's verdict
    T_sensor_target: Array  # (4, 4)
    covariance: Array  # (6, 6): rotation, translation, sensor frame
    omega_target: Array  # (3,) rad/s
    omega_sigma: Array  # (3,) rad/s
    velocity: Array  # (3,) m/s, of the rotation centre, sensor frame
    agreement: Agreement
    observability: float | None  # None where nothing was registered
    submap: int = 0  # poses of different submaps cannot be compared
    keyframe: KeyFrame | None = None  # set when this frame became one
    missing: float = 0.0  # share of the reference's points beside the frame's silhouette
    sound: bool = True  # the whole side is seen, and where it is not told by its looks alone: fit for a model
    ambiguous: bool = False  # found again, but another attitude explains the frame as well

    @staticmethod
    def of(motion: MotionFilter, view: View, fit: FrameFit | None, **verdict: Any) -> 'OdometryEstimate':
        """What a filter says of a frame, how the frame fits, and what was made of it."""
        return OdometryEstimate(
            stamp_ns=view.frame.stamp_ns,
            T_sensor_target=motion.T_sensor_target,
            covariance=motion.pose_covariance,
            omega_target=motion.omega_target,
            omega_sigma=motion.omega_sigma,
            velocity=motion.velocity.copy(),
            agreement=fit.agreement if fit else Agreement(),
            observability=fit.observability if fit else None,
            missing=fit.missing if fit else 0.0,
            **verdict,
        )
