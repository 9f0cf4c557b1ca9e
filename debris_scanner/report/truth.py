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

"""The truth of a scan, in the scan's own target frame, for the curves of a report."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, inverse, log_so3
from debris_scanner.core.results import StampedPose
from debris_scanner.evaluation.trajectory_errors import align, by_stamp, pose_errors

_LONGEST_STEP = 3  # median steps: a rate across a longer gap means nothing


@dataclass(frozen=True)
class Errors:
    """Errors over time; arrays run over the frames that have a truth."""

    stamps_ns: NDArray[np.int64]
    attitude_rad: Array
    position_m: Array


@dataclass(frozen=True)
class Truth:
    """True poses, and how the scan's poses compare."""

    T_sensor_target: dict[int, Array]  # true target frame, by stamp
    T_truth_target: Array  # (4, 4): constant between the two target frames

    @staticmethod
    def of(truth: list[StampedPose], estimate: list[StampedPose]) -> 'Truth | None':
        """The truth tied to an estimate, or None if they have no frame in common."""
        true, estimated = by_stamp(truth), by_stamp(estimate)
        if not true.keys() & estimated.keys():
            return None
        return Truth(true, align(true, estimated))

    def errors(self, poses: list[StampedPose], from_first: bool = False) -> Errors:
        """Errors of poses in the estimate's target frame, or in one tied to the truth at the first pose."""
        estimate = {k: T for k, T in by_stamp(poses).items() if k in self.T_sensor_target}
        stamps = sorted(estimate)
        constant = self.T_truth_target
        if from_first and stamps:
            constant = inverse(self.T_sensor_target[stamps[0]]) @ estimate[stamps[0]]
        attitude, position = pose_errors(self.T_sensor_target, estimate, constant)
        return Errors(np.array(stamps, dtype=np.int64), attitude, position)

    def rates(self) -> tuple[NDArray[np.int64], Array]:
        """Stamps (n,) and true rates (n, 3), rad/s, in the estimate's target frame."""
        stamps = np.array(sorted(self.T_sensor_target), dtype=np.int64)
        if len(stamps) < 2:
            return stamps[:0], np.zeros((0, 3))
        R = np.array([self.T_sensor_target[s][:3, :3] for s in stamps.tolist()])
        step = np.diff(stamps) * 1e-9
        turns = np.array([log_so3(a.T @ b) for a, b in pairwise(R)])
        omega = turns / step[:, None] @ self.T_truth_target[:3, :3]
        good = step <= _LONGEST_STEP * np.median(step)
        return stamps[1:][good], omega[good]
