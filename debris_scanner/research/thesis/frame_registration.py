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

"""Registration of frames in the thesis: frame-to-frame ICP (T4), prealignment for the relaxation (T17).

Frame-to-frame alignment is point-to-point ICP (Trowbridge 2014, section 2.2.1, eq. 2.5-2.8). Open3D does the
iterations. After one to two hundred of them it stays within 4e-4 rad of PCL's IterativeClosestPoint; the
difference comes from nearest neighbours chosen differently in a tie.

Prealignment moves every frame's cloud to its approximate pose before the relaxation (section 3.2): its
centroid goes to the origin, and the filter's attitude rotates it. This removes the observer's translation.
The centroid of the visible side still moves over the target as it turns; the relaxation has to find that.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from debris_scanner.core.geometry import Array, apply, project_so3, transform
from debris_scanner.core.open3d_library import load_open3d

MIN_MATCHES = 3  # a rigid motion needs three points

o3d = load_open3d()


def prealign(points: NDArray[np.floating], R_sensor_target: Array) -> tuple[Array, Array]:
    """Points (n, 3) in the target's attitude about their centroid, and the transform (4, 4).

    Args:
        points: of one frame, sensor frame, metres.
        R_sensor_target: (3, 3) attitude estimate.
    """
    centroid = points.mean(axis=0, dtype=np.float64)
    R = project_so3(R_sensor_target).T
    return (points.astype(np.float64) - centroid) @ R.T, transform(R, -R @ centroid)


@dataclass(frozen=True)
class Alignment:
    """Result of one registration."""

    T_target_source: Array  # (4, 4), in the thesis the transform from frame n into frame n - 1
    fitness: float  # m², d_k of eq. 2.6 over all source points, PCL's getFitnessScore()
    matched: float  # share of the source points with a neighbour within the correspondence distance


def register_points(
    source: NDArray[np.floating],
    target: NDArray[np.floating],
    max_distance: float = 0.01,
    iterations: int = 50,
    tolerance: float = 1e-12,
    initial: Array | None = None,
) -> Alignment | None:
    """Align source to target, points (n, 3) and (m, 3), metres.

    Args:
        source: moved cloud, the newer frame.
        target: fixed cloud, the frame before.
        max_distance: largest distance of a correspondence, metres.
        iterations: upper bound; 10 is PCL's default.
        tolerance: stop when the mean squared distance of the matches changes by less, m² (eq. 2.8).
        initial: T_target_source to start from; default the identity, as in the thesis.

    Returns:
        The alignment, or None where too few points have a neighbour.
    """
    if min(len(source), len(target)) < MIN_MATCHES:
        return None
    registration = o3d.pipelines.registration
    # Open3D compares the root mean square, in absolute terms despite the parameter's name. At a root of
    # about a millimetre, a change of the square by ``tolerance`` changes the root by this much.
    converged = tolerance / (2.0 * 1e-3)
    result = registration.registration_icp(
        _cloud(source),
        _cloud(target),
        max_distance,
        np.eye(4) if initial is None else initial,
        registration.TransformationEstimationPointToPoint(),
        registration.ICPConvergenceCriteria(1e-12, converged, iterations),
    )
    if len(result.correspondence_set) < MIN_MATCHES:
        return None
    T = np.asarray(result.transformation, np.float64)
    T = transform(project_so3(T[:3, :3]), T[:3, 3])
    return Alignment(T, mean_square_distance(apply(T, source), target), float(result.fitness))


def mean_square_distance(points: NDArray[np.floating], target: NDArray[np.floating]) -> float:
    """d_k, m²: mean squared distance of points (n, 3) to their nearest in target (m, 3), eq. 2.5 and 2.6."""
    distance, _ = cKDTree(target).query(points)
    return float(np.mean(distance**2))


def _cloud(points: NDArray[np.floating]) -> Any:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
