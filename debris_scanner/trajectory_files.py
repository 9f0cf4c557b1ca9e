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

"""Pose files in the TUM format: ``t tx ty tz qx qy qz qw``, one frame a line.

Seconds and metres, Hamilton quaternion, T_sensor_target. Stamps carry nine decimals and are read as
decimal text, so that integer nanoseconds survive the round trip whatever their size.
"""

from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from debris_scanner.atomic_file import write_atomically
from debris_scanner.geometry import from_quaternion, to_quaternion, transform
from debris_scanner.results import StampedPose

_NS = Decimal(1_000_000_000)
_UNIT_TOLERANCE = 1e-2  # how far from 1 a quaternion's length may be


class TrajectoryFileError(ValueError):
    """A pose file that is missing or malformed; the message names file and line."""


def write_tum(path: Path, poses: Sequence[StampedPose]) -> None:
    """Write poses in their order; the file appears whole or not at all."""
    lines = []
    for pose in poses:
        seconds, fraction = divmod(pose.stamp_ns, 1_000_000_000)
        numbers = (*pose.T_sensor_target[:3, 3], *to_quaternion(pose.T_sensor_target[:3, :3]))
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


def _parse(fields: list[str]) -> StampedPose:
    if len(fields) != 8:
        raise ValueError(f'expected 8 numbers, found {len(fields)}')
    stamp = Decimal(fields[0]) * _NS
    if not stamp.is_finite() or stamp != int(stamp):
        raise ValueError(f'stamp {fields[0]!r} is not a whole number of nanoseconds')
    values = np.array([float(x) for x in fields[1:]])
    if not np.isfinite(values).all():
        raise ValueError('a number is not finite')
    if abs(float(np.linalg.norm(values[3:])) - 1) > _UNIT_TOLERANCE:
        raise ValueError('the quaternion is not of unit length')
    return StampedPose(int(stamp), transform(from_quaternion(values[3:]), values[:3]))
