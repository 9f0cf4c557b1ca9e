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

Exponential, logarithm and projection of rotations are compiled: a frame calls them dozens of times. Scipy's
Rotation takes 16 to 64 microseconds a call, most of it for checks; these take three.
"""

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from debris_scanner.core.optional import kernel

Array = NDArray[np.float64]

_SMALL = 1e-8  # squared angle below which the series are exact
_CONVERGED = 1e-9  # change of the last step; the step after it would be its square
_SINGULAR = 1e-6  # determinant below which M has no usable inverse
_MOST_STEPS = 30
_UNIT_TOLERANCE = 1e-2  # how far from 1 a quaternion's length may be
_IDENTITY = np.eye(4)  # a copy takes a tenth of what making it takes


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


def solve_informed(H: Array, g: Array) -> Array:
    """H⁻¹ g (6,) for a positive semidefinite H (6, 6); directions of next to no information give nothing."""
    if not np.trace(H) > 0:
        return np.zeros(len(g))
    scale = 1 / np.sqrt(np.maximum(np.diag(H), 1e-12 * float(np.trace(H))))
    values, vectors = np.linalg.eigh(H * np.outer(scale, scale))
    keep = values > 1e-6 * max(float(values[-1]), 1e-300)
    kept = vectors[:, keep]
    return np.asarray(scale * (kept @ ((kept.T @ (scale * g)) / values[keep])))


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
    T = _IDENTITY.copy()
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def exp_se3(twist: Array) -> Array:
    """Transform (4, 4) of a decoupled twist (6,): rotation vector, then translation."""
    return transform(exp_so3(twist[:3]), twist[3:])


def log_se3(T: Array) -> Array:
    """Decoupled twist (6,) of a transform (4, 4): rotation vector, then translation."""
    return np.concatenate([log_so3(T[:3, :3]), T[:3, 3]])


def inverse(T: Array) -> Array:
    """Inverse of a rigid transform (4, 4)."""
    R = T[:3, :3].T
    return transform(R, -R @ T[:3, 3])


def parts(T: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) of a transform (4, 4), contiguous, as kernels take them."""
    return np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])


def compose(*transforms: Array) -> Array:
    """Product of rigid transforms, re-orthonormalised so that long chains stay rigid.

    Thesis part T5 (Trowbridge 2014, eq. 2.30-2.33).

    Raises:
        LinAlgError: the product is no rigid transform: a number is not finite.
    """
    T = _IDENTITY.copy()
    for factor in transforms:
        T = T @ factor
    T[:3, :3] = project_so3(T[:3, :3])
    if not math.isfinite(T[0, 3] + T[1, 3] + T[2, 3]):
        raise np.linalg.LinAlgError('a translation is not finite')
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
    q = scipy.spatial.transform.Rotation.from_matrix(R).as_quat()
    return -q if q[3] < 0 else q


def from_quaternion(q: Array) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w), normalised first."""
    return scipy.spatial.transform.Rotation.from_quat(q).as_matrix()


def to_pose_vector(T: Array) -> Array:
    """Position and quaternion (7,) of a transform, as pose files hold them: x, y, z, qx, qy, qz, qw."""
    return np.concatenate([T[:3, 3], to_quaternion(T[:3, :3])])


def from_pose_vector(v: Array) -> Array:
    """The inverse of :func:`to_pose_vector`.

    Raises:
        ValueError: not seven finite numbers, or the quaternion is not of unit length.
    """
    if v.shape != (7,):
        raise ValueError(f'a pose has 7 numbers, not {v.size}')
    if not np.isfinite(v).all():
        raise ValueError('a number is not finite')
    if abs(float(np.linalg.norm(v[3:])) - 1) > _UNIT_TOLERANCE:
        raise ValueError('the quaternion is not of unit length')
    return transform(from_quaternion(v[3:]), v[:3])


@kernel()
def exponential(v: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,), by Rodrigues."""
    x, y, z = v[0], v[1], v[2]
    square = x * x + y * y + z * z
    if square < _SMALL:
        a = 1.0 - square / 6.0 * (1.0 - square / 20.0)
        b = 0.5 - square / 24.0 * (1.0 - square / 30.0)
    else:
        angle = np.sqrt(square)
        half = np.sin(0.5 * angle) / angle
        a, b = np.sin(angle) / angle, 2.0 * half * half
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
    return R


@kernel()
def logarithm(R: Array) -> Array:
    """Rotation vector (3,) of a rotation matrix (3, 3), by way of its quaternion (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    q = np.empty(4)
    if trace >= max(R[0, 0], R[1, 1], R[2, 2]):
        q[3] = 1.0 + trace
        q[0], q[1], q[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        i = 0
        if R[1, 1] > R[0, 0]:
            i = 1
        if R[2, 2] > R[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 - trace + 2.0 * R[i, i]
        q[j], q[k], q[3] = R[j, i] + R[i, j], R[k, i] + R[i, k], R[k, j] - R[j, k]
    if q[3] < 0:
        q = -q
    length = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    if length == 0.0:
        return np.zeros(3)
    return q[:3] * (2.0 * np.arctan2(length, q[3]) / length)


@kernel()
def nearest_rotation(M: Array) -> tuple[Array, bool]:
    """Orthogonal factor of the polar decomposition of M (3, 3), by Newton's iteration (Higham 1986).

    It is the nearest rotation if M does not reflect. The second result is false if M is singular or reflects,
    or if the iteration does not converge.
    """
    R = M.copy()
    C = np.empty((3, 3))  # cofactors: the inverse, transposed, times the determinant
    for _ in range(_MOST_STEPS):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                c, d = (j + 1) % 3, (j + 2) % 3
                C[i, j] = R[a, c] * R[b, d] - R[a, d] * R[b, c]
        determinant = R[0, 0] * C[0, 0] + R[0, 1] * C[0, 1] + R[0, 2] * C[0, 2]
        if not determinant > _SINGULAR:
            return R, False
        change = 0.0
        for i in range(3):
            for j in range(3):
                moved = 0.5 * (R[i, j] + C[i, j] / determinant)
                change = max(change, abs(moved - R[i, j]))
                R[i, j] = moved
        if change < _CONVERGED:
            return R, True
    return R, False


def faces(vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> Array:
    """Area of each triangle times its normal (t, 3), towards where it runs counter-clockwise."""
    corners = vertices[triangles].astype(np.float64)
    return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def area(vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> float:
    """Of all triangles."""
    return float(np.linalg.norm(faces(vertices, triangles), axis=1).sum())


def vertex_normals(vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> Array:
    """Unit normals (m, 3) of mesh vertices: mean of the adjoining triangles', weighted by area.

    They point to the side from which the triangles run counter-clockwise. A vertex without area around
    it gets zeros.
    """
    face = faces(vertices, triangles)
    index = triangles.reshape(-1)
    summed = np.zeros((len(vertices), 3))
    for k in range(3):
        summed[:, k] = np.bincount(index, np.repeat(face[:, k], 3), minlength=len(vertices))
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.divide(summed, length, out=np.zeros_like(summed), where=length > 0)


def sphere_directions(count: int) -> Array:
    """Unit vectors (n, 3) spread evenly over the sphere (Fibonacci)."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - z * z)
    return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), z])
