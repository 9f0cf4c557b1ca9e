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

"""Trajectories and pose graphs as text files: TUM and g2o.

A TUM line is ``t tx ty tz qx qy qz qw``, one frame per line: T_sensor_target in seconds and metres, Hamilton
quaternion. Stamps carry nine decimals and are read as decimal text, so that integer nanoseconds of any size
survive the round trip.

The g2o file holds the pose graph for other optimisers and viewers.
"""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from debris_scanner.core.geometry import Array, from_pose_vector, inverse, to_pose_vector
from debris_scanner.core.results import GraphEdge, StampedPose
from debris_scanner.io.files import write_atomically

_NS = Decimal(1_000_000_000)

# g2o measures rotation errors by the vector part of the quaternion, half the rotation vector, so that
# information per radian squared counts four times.
_TO_G2O = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


class TrajectoryFileError(ValueError):
    """A pose file that is missing or malformed; the message names file and line."""


def write_tum(path: Path, poses: Sequence[StampedPose]) -> None:
    """Write poses in their order, atomically."""
    lines = []
    for pose in poses:
        seconds, fraction = divmod(pose.stamp_ns, 1_000_000_000)
        numbers = to_pose_vector(pose.T_sensor_target)
        lines.append(f'{seconds}.{fraction:09d} ' + ' '.join(f'{x:.9f}' for x in numbers) + '\n')
    write_atomically(path, ''.join(lines).encode())


def read_tum(path: Path) -> list[StampedPose]:
    """Poses of a file, in its order; empty lines and lines that start with # are skipped.

    Raises:
        TrajectoryFileError: the file is missing, or a line is not eight finite numbers with a stamp of
            whole nanoseconds and a unit quaternion.
    """
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryFileError(f'cannot read pose file {path}: {error}') from error
    poses = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if fields and not fields[0].startswith('#'):
            try:
                poses.append(_parse(fields))
            except (ValueError, InvalidOperation) as error:
                raise TrajectoryFileError(f'{path}, line {number}: {error}') from error
    return poses


def write_g2o(path: Path, poses: Sequence[StampedPose], edges: Sequence[GraphEdge]) -> None:
    """Write key frame poses and the edges between them, atomically.

    Vertex k is ``poses[k]`` and holds T_target_sensor, the inverse of the pose given: g2o composes an
    edge as T_i_j = inverse(T_i) T_j, which is the motion between two sensor views only for that inverse.
    Comments ahead of the vertices hold their stamps.

    Args:
        path: file to write.
        poses: T_sensor_target of each key frame, metres.
        edges: T_i_j between sensor views, which maps view j's points into view i; information per
            square metre and square radian of a rotation vector, translation first.

    Raises:
        ValueError: for an edge that names no vertex or whose information is not (6, 6).
        OSError: if the file cannot be written.
    """
    lines = ['# VERTEX_SE3:QUAT holds T_target_sensor of the key frame; metres']
    lines += [f'# vertex {k} stamp_ns {pose.stamp_ns}' for k, pose in enumerate(poses)]
    lines += [f'VERTEX_SE3:QUAT {k} {_pose(inverse(p.T_sensor_target))}' for k, p in enumerate(poses)]
    for edge in edges:
        if not (0 <= edge.i < len(poses) and 0 <= edge.j < len(poses)):
            raise ValueError(f'edge {edge.i}-{edge.j} names no vertex: there are {len(poses)}')
        if edge.information.shape != (6, 6):
            raise ValueError(f'information of edge {edge.i}-{edge.j} has shape {edge.information.shape}')
        information = edge.information * np.outer(_TO_G2O, _TO_G2O)
        upper = _numbers(information[np.triu_indices(6)])
        lines.append(f'EDGE_SE3:QUAT {edge.i} {edge.j} {_pose(edge.T_i_j)} {upper}')
    write_atomically(path, ('\n'.join(lines) + '\n').encode())


def _parse(fields: list[str]) -> StampedPose:
    if len(fields) != 8:
        raise ValueError(f'expected 8 numbers, found {len(fields)}')
    stamp = Decimal(fields[0]) * _NS
    if not stamp.is_finite() or stamp != int(stamp):
        raise ValueError(f'stamp {fields[0]!r} is not a whole number of nanoseconds')
    return StampedPose(int(stamp), from_pose_vector(np.array([float(x) for x in fields[1:]])))


def _pose(T: Array) -> str:
    return _numbers(to_pose_vector(T))


def _numbers(values: Array) -> str:
    return ' '.join(f'{v:.9g}' for v in values.tolist())
