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

"""What the odometry node says of a frame, as messages: pose, twist, and the verdict with its numbers."""

from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage

from debris_scanner.core.geometry import Array
from debris_scanner.nodes.lifecycle.diagnostics import key_values
from debris_scanner.tracking.motion_filter import VELOCITY, MotionFilter
from debris_scanner.tracking.odometry import OdometryEstimate
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import odometry_message, target_pose_message
from msg_adapters.stamps import frame_stamp, header_message, stamp_of_text

# Until the first model the target frame is the first key frame's as odometry drifts along; the model's
# target frame is another. The child frame of a pose says which one it is given in.
SCANNING_FRAME = 'target_scanning'
TARGET_FRAME = 'target'

_LONGEST_PATH_RAD = 1e6  # a path that is longer was never travelled
_MOST_SUBMAPS = 10**6


@dataclass(frozen=True)
class Verdict:
    """What became of one frame in the odometry node: topic ``odometry_status``."""

    stamp_ns: int
    scan_ns: int  # stamp of the scan's first key frame: tells scans apart after a reset
    state: str  # scanning, tracking or lost
    accepted: bool
    keyframe: bool
    tracked: bool  # registered to a model: the pose is given in the target frame, else in the scan's
    path_rad: float  # rotation travelled up to the latest key frame
    usable_for_mapping: bool = True  # fit for a model
    submap: int = 0  # before a model, poses of different submaps cannot be compared

    @property
    def frame_id(self) -> str:
        """The target frame that the pose is given in."""
        return TARGET_FRAME if self.tracked else SCANNING_FRAME


def verdict_message(verdict: Verdict, estimate: OdometryEstimate) -> DiagnosticArray:
    """The verdict with the numbers that it was decided by."""
    a = estimate.stats
    values = {
        'scan_ns': verdict.scan_ns,
        'state': verdict.state,
        'accepted': int(verdict.accepted),
        'keyframe': int(verdict.keyframe),
        'tracked': int(verdict.tracked),
        'path_rad': verdict.path_rad,
        'sound': int(verdict.usable_for_mapping),
        'submap': verdict.submap,
        'ambiguous': int(estimate.ambiguous),
        'missing': float(estimate.missing_reference_ratio),
        'matched': a.matched,
        'overlap': float(a.overlap),
        'residual_mm': float(a.rms * 1e3),
        'free_space': float(a.conflict_ratio),
        'outside': float(a.silhouette_violation_ratio),
        'observability': 'none' if estimate.observability is None else float(estimate.observability),
    }
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK if verdict.accepted else DiagnosticStatus.WARN,
        name='odometry',
        message='accepted' if verdict.accepted else 'not registered',
        values=key_values(values),
    )
    return DiagnosticArray(header=header_message(verdict.stamp_ns, ''), status=[status])


def read_verdict(msg: DiagnosticArray) -> Verdict:
    """The inverse of :func:`verdict_message`.

    Raises:
        MalformedMessage: no verdict.
    """
    try:
        (status,) = msg.status
        values = {item.key: item.value for item in status.values}
        path_rad = float(values['path_rad'])
        if not abs(path_rad) < _LONGEST_PATH_RAD:
            raise MalformedMessage(f'no verdict on a frame: a path of {path_rad} rad')
        submap = int(values['submap'])
        if not 0 <= submap < _MOST_SUBMAPS:
            raise MalformedMessage(f'no verdict on a frame: submap {submap}')
        return Verdict(
            frame_stamp(msg.header.stamp),
            stamp_of_text(values['scan_ns']),
            values['state'],
            values['accepted'] == '1',
            values['keyframe'] == '1',
            values['tracked'] == '1',
            path_rad,
            values['sound'] == '1',
            submap,
        )
    except (KeyError, ValueError) as error:
        raise MalformedMessage(f'no verdict on a frame: {error}') from None


def estimate_messages(
    estimate: OdometryEstimate, motion: MotionFilter, frame_id: str, child_frame_id: str
) -> tuple[OdometryMessage, PoseWithCovarianceStamped]:
    """Odometry and target pose of an estimate.

    Args:
        estimate: of one frame.
        motion: the filter, for what the estimate leaves out.
        frame_id: the sensor's optical frame.
        child_frame_id: the target frame that the pose is given in.
    """
    T = estimate.T_sensor_target
    R_target_sensor = T[:3, :3].T
    # the filter's velocity is that of the rotation centre; a twist is that of the frame's origin
    linear = R_target_sensor @ estimate.velocity - np.cross(estimate.omega_target, motion.pivot)
    twist_covariance: Array = np.zeros((6, 6))
    twist_covariance[:3, :3] = np.diag(estimate.omega_sigma**2)
    twist_covariance[3:, 3:] = R_target_sensor @ motion.P[VELOCITY, VELOCITY] @ R_target_sensor.T
    odometry = odometry_message(
        estimate.stamp_ns,
        frame_id,
        child_frame_id,
        T,
        estimate.covariance,
        np.concatenate([estimate.omega_target, linear]),
        twist_covariance,
    )
    return odometry, target_pose_message(estimate.stamp_ns, frame_id, T, estimate.covariance)
