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

"""Odometry estimates as messages, and back: pose, twist, and the status of the frame."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage

from debris_scanner.core.frames import KeyFrame, TargetFrame
from debris_scanner.core.geometry import Array, inverse
from debris_scanner.nodes.lifecycle.diagnostics import key_values
from debris_scanner.registration.projective import RegistrationStats
from debris_scanner.tracking.motion_filter import VELOCITY, MotionFilter
from debris_scanner.tracking.odometry import OdometryEstimate
from msg_adapters.errors import MalformedMessage
from msg_adapters.poses import StampedOdometry, odometry_message, target_pose_message
from msg_adapters.records import read_record, record_values
from msg_adapters.stamps import frame_stamp, header_message

_LONGEST_PATH_RAD = 1e6  # a longer path is malformed
_MOST_SUBMAPS = 10**6


@dataclass(frozen=True)
class FrameStatus:
    """How the odometry node used one frame: topic ``odometry_status``; see OdometryEstimate."""

    stamp_ns: int
    scan_ns: int
    state: str
    accepted: bool
    keyframe: bool
    tracked: bool
    path_rad: float
    usable_for_mapping: bool = True
    submap: int = 0
    rejected: str = ''

    def __post_init__(self) -> None:
        if not abs(self.path_rad) < _LONGEST_PATH_RAD:
            raise MalformedMessage(f'no status of a frame: a path of {self.path_rad} rad')
        if not 0 <= self.submap < _MOST_SUBMAPS:
            raise MalformedMessage(f'no status of a frame: submap {self.submap}')

    @staticmethod
    def of(e: OdometryEstimate) -> 'FrameStatus':
        """The status of an estimate."""
        return FrameStatus(
            stamp_ns=e.stamp_ns,
            scan_ns=e.scan_ns,
            state=e.state,
            accepted=e.accepted,
            keyframe=e.keyframe is not None,
            tracked=e.tracked,
            path_rad=e.path_rad,
            usable_for_mapping=e.usable_for_mapping,
            submap=e.submap,
            rejected=e.rejected,
        )


def status_message(estimate: OdometryEstimate, model_id: str = '') -> DiagnosticArray:
    """The status, with the numbers behind it, and the name of the model that the pose is registered to."""
    stats = estimate.stats
    numbers = {
        'model_id': model_id,
        'ambiguous': int(estimate.ambiguous),
        'missing_reference_ratio': float(estimate.missing_reference_ratio),
        'matched': stats.matched,
        'overlap': float(stats.overlap),
        'residual_px': float(stats.rms),
        'conflict_ratio': float(stats.conflict_ratio),
        'silhouette_violation_ratio': float(stats.silhouette_violation_ratio),
        'observability': 'none' if estimate.observability is None else float(estimate.observability),
    }
    status = DiagnosticStatus(
        level=DiagnosticStatus.OK if estimate.accepted else DiagnosticStatus.WARN,
        name='odometry',
        message='accepted' if estimate.accepted else estimate.rejected,
        values=key_values(record_values(FrameStatus.of(estimate)) | numbers),
    )
    return DiagnosticArray(header=header_message(estimate.stamp_ns, ''), status=[status])


def read_status(msg: DiagnosticArray) -> FrameStatus:
    """The inverse of :func:`status_message`.

    Raises:
        MalformedMessage: no status of a frame.
    """
    if len(msg.status) != 1:
        raise MalformedMessage(f'no status of a frame: {len(msg.status)} of them')
    values = {item.key: item.value for item in msg.status[0].values}
    return read_record(FrameStatus, values, stamp_ns=frame_stamp(msg.header.stamp))


def estimate_messages(
    estimate: OdometryEstimate, motion: MotionFilter, frame_id: str, target_frame: str
) -> tuple[OdometryMessage, PoseWithCovarianceStamped]:
    """Odometry and target pose of an estimate.

    Args:
        estimate: of one frame.
        motion: the filter, for the rotation centre and the covariance of the velocity.
        frame_id: the sensor's optical frame.
        target_frame: the target's frame.
    """
    T = estimate.T_sensor_target
    R_target_sensor = T[:3, :3].T
    # the filter's velocity is that of the rotation centre, a twist is that of the frame's origin
    linear = R_target_sensor @ estimate.velocity - np.cross(estimate.omega_target, motion.pivot)
    twist_covariance: Array = np.zeros((6, 6))
    twist_covariance[:3, :3] = np.diag(estimate.omega_sigma**2)
    twist_covariance[3:, 3:] = R_target_sensor @ motion.P[VELOCITY, VELOCITY] @ R_target_sensor.T
    odometry = odometry_message(
        estimate.stamp_ns,
        frame_id,
        target_frame,
        T,
        estimate.covariance,
        np.concatenate([estimate.omega_target, linear]),
        twist_covariance,
    )
    return odometry, target_pose_message(estimate.stamp_ns, frame_id, T, estimate.covariance)


def read_estimate(
    status: FrameStatus, odometry: StampedOdometry, target: TargetFrame | None
) -> OdometryEstimate:
    """The estimate behind a status and an odometry message; its velocity is that of the target's origin.

    Args:
        status: of the frame.
        odometry: its pose and twist.
        target: the frame; needed where it became a key frame.
    """
    T = odometry.T_sensor_target
    keyframe = None
    if status.keyframe and target is not None:
        keyframe = KeyFrame(target, inverse(T), status.path_rad, odometry.covariance, status.submap)
    own = {f.name for f in dataclasses.fields(FrameStatus)} - {'keyframe'}
    return OdometryEstimate(
        **{name: getattr(status, name) for name in own},
        T_sensor_target=T,
        covariance=odometry.covariance,
        omega_target=odometry.twist[:3],
        omega_sigma=odometry.twist_covariance.diagonal()[:3] ** 0.5,
        velocity=T[:3, :3] @ odometry.twist[3:],
        stats=RegistrationStats(),
        observability=None,
        keyframe=keyframe,
    )
