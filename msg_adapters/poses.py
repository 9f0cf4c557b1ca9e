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

"""Poses, twists, covariances and paths to ROS messages and back.

Twists and covariances are ordered (rotation, translation) here and (x, y, z, rot x, rot y, rot z) in
messages (REP-103): the functions below reorder them, and never rotate a covariance into another frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from nav_msgs.msg import Odometry, Path

from debris_scanner.core.geometry import Array, from_quaternion, to_quaternion, transform
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import frame_stamp, header_message, stamp_of_text

_SWAP = np.ix_(
    [3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2]
)  # rotation first <-> translation first: its own inverse
_KEYFRAME = 'keyframe_'


@dataclass(frozen=True)
class StampedEstimate:
    """Pose of the target with its covariance (6, 6), ordered (rotation, translation)."""

    stamp_ns: int
    frame_id: str
    T_sensor_target: Array
    covariance: Array


@dataclass(frozen=True)
class StampedOdometry(StampedEstimate):
    """What an Odometry message says: the pose, and the twist (6,) in the target frame, rad/s and m/s."""

    child_frame_id: str
    twist: Array
    twist_covariance: Array


@dataclass(frozen=True)
class ClosureTransform:
    """An accepted loop closure between two key frames, named by their stamps."""

    from_stamp_ns: int
    to_stamp_ns: int
    T_from_to: Array


def pose_message(T: Array) -> Pose:
    """Pose of a transform (4, 4)."""
    x, y, z, w = to_quaternion(T[:3, :3]).tolist()
    return Pose(position=Point(**_xyz(T[:3, 3])), orientation=Quaternion(x=x, y=y, z=z, w=w))


def read_pose(pose: Any) -> Array:
    """Transform (4, 4) of a Pose.

    Raises:
        MalformedMessage: not finite, or a quaternion of no length.
    """
    return _rigid(pose.position, pose.orientation)


def transform_message(stamp_ns: int, frame_id: str, child_frame_id: str, T: Array) -> TransformStamped:
    """TransformStamped of a transform (4, 4) that maps points of the child into the frame."""
    x, y, z, w = to_quaternion(T[:3, :3]).tolist()
    return TransformStamped(
        header=header_message(stamp_ns, frame_id),
        child_frame_id=child_frame_id,
        transform=Transform(translation=Vector3(**_xyz(T[:3, 3])), rotation=Quaternion(x=x, y=y, z=z, w=w)),
    )


def read_transform(msg: Any) -> Array:
    """Transform (4, 4) of a TransformStamped.

    Raises:
        MalformedMessage: not finite, or a quaternion of no length.
    """
    return _rigid(msg.transform.translation, msg.transform.rotation)


def target_pose_message(
    stamp_ns: int, frame_id: str, T_sensor_target: Array, covariance: Array
) -> PoseWithCovarianceStamped:
    """Pose of the target in the sensor's frame, covariance (6, 6) ordered (rotation, translation)."""
    return PoseWithCovarianceStamped(
        header=header_message(stamp_ns, frame_id), pose=_pose_with_covariance(T_sensor_target, covariance)
    )


def read_target_pose(msg: Any) -> StampedEstimate:
    """The inverse of :func:`target_pose_message`.

    Raises:
        MalformedMessage: a pose or covariance that is not finite, or a quaternion of no length.
    """
    return StampedEstimate(
        frame_stamp(msg.header.stamp),
        str(msg.header.frame_id),
        read_pose(msg.pose.pose),
        _covariance(msg.pose),
    )


def odometry_message(
    stamp_ns: int,
    frame_id: str,
    child_frame_id: str,
    T_sensor_target: Array,
    covariance: Array,
    twist: Array,
    twist_covariance: Array,
) -> Odometry:
    """Odometry: the target's pose in the sensor's frame, and its twist in the target frame.

    Args:
        stamp_ns: stamp, nanoseconds.
        frame_id: the sensor's optical frame.
        child_frame_id: the target frame.
        T_sensor_target: pose (4, 4).
        covariance: of the pose, (6, 6), ordered (rotation, translation).
        twist: (6,), ordered (rotation, translation): rad/s and m/s, in the target frame.
        twist_covariance: (6, 6), ordered as the twist.
    """
    velocity = Twist(linear=Vector3(**_xyz(twist[3:])), angular=Vector3(**_xyz(twist[:3])))
    return Odometry(
        header=header_message(stamp_ns, frame_id),
        child_frame_id=child_frame_id,
        pose=_pose_with_covariance(T_sensor_target, covariance),
        twist=TwistWithCovariance(twist=velocity, covariance=_row_major(twist_covariance)),
    )


def read_odometry(msg: Any) -> StampedOdometry:
    """The inverse of :func:`odometry_message`.

    Raises:
        MalformedMessage: a number that is not finite, or a quaternion of no length.
    """
    velocity = msg.twist.twist
    twist = np.array(
        [getattr(part, a) for part in (velocity.angular, velocity.linear) for a in 'xyz'], np.float64
    )
    return StampedOdometry(
        frame_stamp(msg.header.stamp),
        str(msg.header.frame_id),
        read_pose(msg.pose.pose),
        _covariance(msg.pose),
        str(msg.child_frame_id),
        _finite(twist, 'twist'),
        _covariance(msg.twist),
    )


def add_sensor_odometry(path: SensorPath, msg: Any) -> None:
    """Add an Odometry message whose pose is that of the sensor's optical frame in a frame that does not turn.

    Raises:
        MalformedMessage: a number that is not finite, or a quaternion of no length.
    """
    odometry = read_odometry(msg)
    sigma = float(np.sqrt(max(np.trace(odometry.covariance[:3, :3]) / 3, 0.0)))
    path.add(odometry.stamp_ns, odometry.T_sensor_target, sigma, odometry.child_frame_id)


def path_message(stamp_ns: int, frame_id: str, poses: Sequence[tuple[int, Array]]) -> Path:
    """Path of (stamp, T) pairs, each pose with its own stamp; T (4, 4) maps into ``frame_id``."""
    return Path(
        header=header_message(stamp_ns, frame_id),
        poses=[
            PoseStamped(header=header_message(stamp, frame_id), pose=pose_message(T)) for stamp, T in poses
        ],
    )


def read_path(msg: Any) -> list[tuple[int, Array]]:
    """The (stamp, T) pairs of a Path.

    Raises:
        MalformedMessage: a pose that is not finite, or a quaternion of no length.
    """
    return [(frame_stamp(p.header.stamp), read_pose(p.pose)) for p in msg.poses]


def closure_message(closure: ClosureTransform) -> TransformStamped:
    """An accepted closure, stamped with the later key frame; the frame ids name both by their stamps."""
    stamps = closure.from_stamp_ns, closure.to_stamp_ns
    names = [f'{_KEYFRAME}{stamp}' for stamp in stamps]
    return transform_message(max(stamps), names[0], names[1], closure.T_from_to)


def read_closure(msg: Any) -> ClosureTransform:
    """The inverse of :func:`closure_message`.

    Raises:
        MalformedMessage: frame ids that name no key frames, or a transform that is not finite.
    """
    return ClosureTransform(
        _keyframe(msg.header.frame_id), _keyframe(msg.child_frame_id), read_transform(msg)
    )


def _keyframe(frame_id: str) -> int:
    if not frame_id.startswith(_KEYFRAME):
        raise MalformedMessage(f'frame id {frame_id!r} names no key frame: {_KEYFRAME}<stamp in ns> expected')
    try:
        return stamp_of_text(frame_id.removeprefix(_KEYFRAME))
    except MalformedMessage as error:
        raise MalformedMessage(f'a frame id names no key frame: {error}') from None


def _xyz(v: Array) -> dict[str, float]:
    return {'x': float(v[0]), 'y': float(v[1]), 'z': float(v[2])}


def _rigid(t: Any, q: Any) -> Array:
    numbers = _finite(np.array([t.x, t.y, t.z, q.x, q.y, q.z, q.w], np.float64), 'pose')
    if not 1e-6 < np.linalg.norm(numbers[3:]) < 1e6:
        raise MalformedMessage(f'quaternion {numbers[3:].tolist()} is no rotation')
    return transform(from_quaternion(numbers[3:]), numbers[:3])


def _finite(values: Array, what: str) -> Array:
    if not np.isfinite(values).all():
        raise MalformedMessage(f'{what} is not finite: {values.tolist()}')
    return values


def _pose_with_covariance(T: Array, covariance: Array) -> PoseWithCovariance:
    return PoseWithCovariance(pose=pose_message(T), covariance=_row_major(covariance))


def _row_major(covariance: Array) -> Array:
    return np.asarray(covariance, np.float64)[_SWAP].reshape(36)


def _covariance(part: Any) -> Array:
    matrix = np.asarray(part.covariance, np.float64).reshape(6, 6)[_SWAP]
    return _finite(matrix, 'covariance')
