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

"""Rotations and rigid transforms, float64, kept exactly orthonormal.

``T_a_b`` maps points given in frame b into frame a. Twists are ordered (rotation, translation).
Quaternions are Hamilton, scalar last, as at every interface of this package.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from debris_scanner.rotation_kernels import exponential, logarithm, nearest_rotation

Array = NDArray[np.float64]


def hat(v: Array) -> Array:
    """Skew-symmetric matrix (3, 3) with ``hat(v) @ x == cross(v, x)``."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp_so3(v: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,) in radians."""
    return exponential(np.ascontiguousarray(v, np.float64))


def log_so3(R: Array) -> Array:
    """Rotation vector (3,) in radians of a rotation matrix (3, 3)."""
    return logarithm(np.ascontiguousarray(R, np.float64))


def project_so3(M: Array) -> Array:
    """Rotation matrix nearest to M (3, 3) in the Frobenius norm."""
    R, found = nearest_rotation(np.ascontiguousarray(M, np.float64))
    if found:
        return R
    U, _, Vt = np.linalg.svd(M)  # singular, or a reflection
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    return U @ D @ Vt


def transform(R: Array, t: Array) -> Array:
    """Homogeneous transform (4, 4) of a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def exp_se3(twist: Array) -> Array:
    """Transform (4, 4) of a decoupled twist (6,): rotation vector, then translation."""
    return transform(exp_so3(twist[:3]), twist[3:])


def inverse(T: Array) -> Array:
    """Inverse of a rigid transform (4, 4)."""
    R = T[:3, :3].T
    return transform(R, -R @ T[:3, 3])


def compose(*transforms: Array) -> Array:
    """Product of rigid transforms, re-orthonormalised so that long chains stay rigid.

    Thesis part T5 (Trowbridge 2014, eq. 2.30-2.33).
    """
    T = np.eye(4)
    for factor in transforms:
        T = T @ factor
    T[:3, :3] = project_so3(T[:3, :3])
    T[3] = (0.0, 0.0, 0.0, 1.0)
    return T


def apply(T: Array, points: NDArray[np.floating]) -> Array:
    """Points (..., 3) mapped by T (4, 4)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def rotation_angle(R: Array) -> float:
    """Geodesic angle of a rotation matrix, radians, 0..pi."""
    return float(np.linalg.norm(log_so3(R)))


def to_quaternion(R: Array) -> Array:
    """Unit quaternion (x, y, z, w) of a rotation matrix, w >= 0."""
    q = Rotation.from_matrix(R).as_quat()
    return -q if q[3] < 0 else q


def from_quaternion(q: Array) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w), normalised first."""
    return Rotation.from_quat(q).as_matrix()
