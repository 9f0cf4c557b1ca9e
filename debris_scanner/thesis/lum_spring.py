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

"""One spring of the Lu-Milios network: point pairs between two clouds, and what they ask of the poses.

Borrmann et al. 2008, with pose parameters (x, y, z, roll, pitch, yaw; R = Rz Ry Rx), as PCL's LUM has them.
The linearisation is that of small angles.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array, transform


@dataclass(frozen=True)
class Spring:
    """Point pairs of one edge, condensed: sum of (s, t, 1) (s, t, 1)^T over them, (7, 7)."""

    source: int
    target: int
    moments: Array

    @property
    def pairs(self) -> int:
        """Number of point pairs."""
        return round(float(self.moments[6, 6]))


def pose_matrix(pose: Array) -> Array:
    """Transform (4, 4) of a pose (6,): x, y, z, roll, pitch, yaw with R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(pose[3:]), np.cos(pose[3:])
    R = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return transform(R, pose[:3])


def spring(source: int, target: int, s: NDArray[np.floating], t: NDArray[np.floating]) -> Spring:
    """Edge of corresponding points s (k, 3) and t (k, 3), each in its own cloud's frame."""
    z = np.hstack([s, t, np.ones((len(s), 1))]).astype(np.float64)
    return Spring(source, target, z.T @ z)


def linearised(edge: Spring, T_source: Array, T_target: Array) -> tuple[Array, Array, float]:
    """Normal matrix (6, 6), right side (6,) and summed squared distance, m², of an edge; Borrmann 2008.

    The parameters are ordered translation, then turns about x, z and y.
    """
    W = edge.moments
    mean, difference = np.zeros((3, 7)), np.zeros((3, 7))
    mean[:, :3], mean[:, 3:6] = 0.5 * T_source[:3, :3], 0.5 * T_target[:3, :3]
    mean[:, 6] = 0.5 * (T_source[:3, 3] + T_target[:3, 3])
    difference[:, :3], difference[:, 3:6] = T_source[:3, :3], -T_target[:3, :3]
    difference[:, 6] = T_source[:3, 3] - T_target[:3, 3]
    a, d = mean @ W[:, 6], difference @ W[:, 6]
    aa, ad = mean @ W @ mean.T, mean @ W @ difference.T
    M = np.diag([W[6, 6]] * 3 + [aa[1, 1] + aa[2, 2], aa[0, 0] + aa[1, 1], aa[0, 0] + aa[2, 2]])
    upper = {
        (0, 4): -a[1], (0, 5): a[2], (1, 3): -a[2], (1, 4): a[0], (2, 3): a[1], (2, 5): -a[0],
        (3, 4): -aa[0, 2], (3, 5): -aa[0, 1], (4, 5): -aa[1, 2],
    }  # fmt: skip
    for (row, column), value in upper.items():
        M[row, column] = M[column, row] = value
    turns = [ad[1, 2] - ad[2, 1], ad[0, 1] - ad[1, 0], ad[2, 0] - ad[0, 2]]
    return M, np.array([*d, *turns]), float(np.trace(difference @ W @ difference.T))


def incidence(pose: Array) -> Array:
    """Matrix (6, 6) between changes of a pose and of the linearised parameters; Borrmann 2008."""
    x, y, z = pose[:3]
    sx, sy = np.sin(pose[3:5])
    cx, cy = np.cos(pose[3:5])
    H = np.eye(6)
    H[0, 4], H[0, 5] = y * sx - z * cx, y * cx * cy + z * sx * cy
    H[1, 3], H[1, 4], H[1, 5] = z, -x * sx, -x * cx * cy + z * sy
    H[2, 3], H[2, 4], H[2, 5] = -y, x * cx, -x * sx * cy - y * sy
    H[3, 5] = sy
    H[4, 4], H[4, 5] = sx, cx * cy
    H[5, 4], H[5, 5] = cx, -sx * cy
    return H
