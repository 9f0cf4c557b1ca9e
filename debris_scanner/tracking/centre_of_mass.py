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

"""Centre of mass: the point of the target that moves as a free point does, and where it goes on.

It moves on a straight line; near an orbit of a given mean motion n, along the motion of Clohessy and
Wiltshire. Each coordinate of that is a sum of 1, t, cos nt and sin nt, whatever way the sensor looks and
wherever on its craft it sits, as long as it does not turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import Array
from debris_scanner.core.results import StampedPose

SURELY = 4.0  # standard deviations of the attitudes: as much information as they would give does not count
CURVATURE = 7.0  # acceleration of a relative orbit, in n² d of the distance d: 3, and 2 n v with v = 2 n d


@dataclass(frozen=True)
class Centre:
    """The centre of mass and the path that it moves on, in the frame of the poses."""

    point: Array  # of mass (3,), target frame, m
    covariance: Array  # (3, 3) m², of the point
    poses: Sequence[StampedPose]  # that it was found from
    scatter: float  # m, standard deviation of a coordinate about the path
    line_sigma: float  # m, the same of a pose as if poses were independent
    mean_motion: float  # rad/s, of the orbit; 0 for a straight line
    held: Array  # (k, p): see _held

    @property
    def sigma(self) -> Array:
        """Standard deviations (3,) of the point, m."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def target_at(self, from_ns: int, seconds: Array, R: Array) -> tuple[Array, Array]:
        """Positions (n, 3) of the target, with covariances (n, 3, 3), while its centre keeps to its path.

        Args:
            from_ns: stamp from which the time counts.
            seconds: (n,).
            R: (n, 3, 3), attitudes then.
        """
        origin_ns = self.poses[-1].stamp_ns
        t = _seconds(self.poses, origin_ns)
        before = np.array([pose.T_sensor_target for pose in self.poses])
        basis = np.vstack([_columns(t, self.mean_motion), self.held])
        ahead = _columns(seconds + (from_ns - origin_ns) * 1e-9, self.mean_motion)
        to_path = ahead @ np.linalg.pinv(basis)  # (n, poses and what is held)
        of_poses = to_path[:, : len(t)]
        p = of_poses @ (before[:, :3, 3] + before[:, :3, :3] @ self.point) - R @ self.point
        of_centre = np.einsum('nk,kij->nij', of_poses, before[:, :3, :3]) - R
        covariance = of_centre @ self.covariance @ of_centre.transpose(0, 2, 1)
        of_path = self.line_sigma**2 * np.einsum('nk,nk->n', to_path, to_path) + self.scatter**2
        return p, covariance + of_path[:, None, None] * np.eye(3)


def fit_centre(
    poses: Sequence[StampedPose], noise_rad: float, extent: float, mean_motion: float = 0.0
) -> Centre:
    """Centre of mass: R c + p is on the path.

    Errors of the attitudes look like information on the centre, as much as they would move it; that much does
    not count. Along the axis of a pure spin nothing is left, and a prior of the target's extent holds it.

    Args:
        poses: T_sensor_target, in order of time.
        noise_rad: standard deviation of a single pose's rotation about each axis.
        extent: of the target, m.
        mean_motion: of the orbit, rad/s; 0 for a straight line.
    """
    n, t = len(poses), _seconds(poses, poses[-1].stamp_ns)
    held = _held(poses, noise_rad * extent, mean_motion)
    rows = ((0, len(held)), (0, 0), (0, 0))
    R = np.pad(np.array([pose.T_sensor_target[:3, :3] for pose in poses]), rows)
    p = np.pad(np.array([pose.T_sensor_target[:3, 3] for pose in poses]), rows[:2])
    basis = np.vstack([_columns(t, mean_motion), held])
    fixed = basis @ np.linalg.pinv(basis)
    A, y = R - np.einsum('ij,jkl->ikl', fixed, R), fixed @ p - p  # A c = y where the path is taken out
    seen, along = np.einsum('nij,nik->jk', A, A), np.einsum('nij,ni->j', A, y)
    values, axes = np.linalg.eigh(seen)
    values = np.maximum(values - n * (SURELY * noise_rad) ** 2, 0.0)
    seen_surely: Array = axes @ np.diag(values) @ axes.T
    centre: Array = np.zeros(3)
    sigma = 0.01 * extent
    for _ in range(5):
        residuals = (A @ centre - y)[:n]
        sigma = max(float(np.sqrt(np.mean(residuals**2))), 1e-5 * extent) if centre.any() else sigma
        weight = independent_share(residuals) / sigma**2
        information = weight * seen_surely + np.eye(3) / extent**2
        known = axes @ np.diag(values > 0) @ axes.T
        centre = np.asarray(np.linalg.solve(information, weight * known @ along))
    covariance = np.asarray(np.linalg.inv(information))
    return Centre(centre, covariance, poses, sigma, float(weight**-0.5), mean_motion, held)


def independent_share(residuals: Array) -> float:
    """Share of the residuals (n, 3), in order of time, that counts, for neighbours err alike.

    One over the integrated autocorrelation, summed while pairs of lags are positive (Geyer 1992).
    """
    n = len(residuals)
    square = max(float(np.mean(residuals**2)), 1e-18)
    alike = np.array([np.sum(residuals[k:] * residuals[: n - k]) / (3 * n * square) for k in range(n // 2)])
    pairs = alike[0 : len(alike) // 2 * 2 : 2] + alike[1::2]
    positive = int(np.argmax(np.append(pairs, -1.0) <= 0))
    return float(1 / max(2 * pairs[:positive].sum() - 1, 1.0))


def _seconds(poses: Sequence[StampedPose], origin_ns: int) -> Array:
    return np.array([(pose.stamp_ns - origin_ns) * 1e-9 for pose in poses])


def _columns(t: Array, mean_motion: float) -> NDArray[np.float64]:
    """What a coordinate of a free point is a sum of, at times (n,): (n, 2), or (n, 4) near an orbit.

    The last two tend to t²/2 and t³/6 for a slow orbit, so that they stay apart from the first.
    """
    columns = [np.ones(len(t)), t]
    if mean_motion:
        angle = mean_motion * t
        columns += [(1 - np.cos(angle)) / mean_motion**2, (angle - np.sin(angle)) / mean_motion**3]
    return np.column_stack(columns)


def _held(poses: Sequence[StampedPose], pose_sigma: float, mean_motion: float) -> NDArray[np.float64]:
    """Rows (2, 4) that hold the path's curvature to what the orbit can do, (0, 2) of a straight line.

    Of a slow orbit a short scan does not show it. The rows are relative to a pose's standard deviation, m.
    """
    if not mean_motion:
        return np.zeros((0, 2))
    distance = float(np.median([np.linalg.norm(pose.T_sensor_target[:3, 3]) for pose in poses]))
    curvature = CURVATURE * mean_motion**2 * distance
    ratios = pose_sigma / np.array([curvature, curvature * mean_motion])
    return np.column_stack([np.zeros((2, 2)), np.diag(ratios)])
