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

"""Open3D and small_gicp on the same clouds, one thread each; left out with a word where not installed."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.performance.measure import Cost, Row, cpu_ms
from benchmarks.performance.ours import summary
from benchmarks.performance.scene import Shot, drifted, pair_error, pose_errors
from debris_scanner.core.geometry import Array, compose, inverse
from debris_scanner.core.open3d_library import load_open3d

try:
    import small_gicp
except ImportError:
    small_gicp = None

MAX_DISTANCE = 0.05  # m, of a correspondence, as PCL's
COLOURED_DISTANCE = 0.02  # m, of a pair with colours: what 8 degrees move the surface by, twice
Register = Callable[[Shot, Shot, Any], tuple[Array, Any]]


def pairs(shots: list[Shot]) -> list[Row]:
    """Target points to registered pose, from the identity, at 2 and 4 mm."""
    rows = []
    for edge in (0.002, 0.004):
        suffix = f' {edge * 1e3:.0f} mm'
        rows.append(
            _measured(f'Open3D: voxel grid, normals, point to plane{suffix}', shots, _Open3dPairs(edge))
        )
        rows += small_gicp_pair(shots, edge)
    return rows


def coloured_pairs(shots: list[Shot]) -> list[Row]:
    """Target points with colours to registered pose by Open3D's coloured ICP, at 2 and 4 mm."""
    return [
        _measured(
            f'Open3D: voxel grid, normals, coloured ICP {edge * 1e3:.0f} mm',
            shots,
            _Open3dColours(edge),
            'coloured',
        )
        for edge in (0.002, 0.004)
    ]


def small_gicp_pair(shots: list[Shot], edge: float) -> list[Row]:
    """Target points to registered pose by small_gicp, voxels of ``edge``, m; nothing without it."""
    if small_gicp is None:
        return []
    who = f'small_gicp: voxel grid, GICP {edge * 1e3:.0f} mm'
    return [_measured(who, shots, _SmallGicpPairs(edge))]


def pose_graph(shots: list[Shot], edges: list[tuple[int, int]], name: str) -> list[Row]:
    """Edges registered by small_gicp, then Open3D's global optimisation of them."""
    if small_gicp is None:
        return []
    o3d = load_open3d()
    start = drifted(shots)
    registration = o3d.pipelines.registration
    result: list[Array] = []

    def task() -> None:
        prepared = [small_gicp.preprocess_points(s.cloud, 0.002, 20, 1) for s in shots]
        graph = registration.PoseGraph()
        graph.nodes.extend(registration.PoseGraphNode(T) for T in start)
        for i, j in edges:
            (target, tree), (source, _) = prepared[j], prepared[i]
            guess = compose(inverse(start[j]), start[i])
            found = small_gicp.align(
                target, source, tree, init_T_target_source=guess, registration_type='GICP',
                max_correspondence_distance=0.02, num_threads=1,
            )  # fmt: skip
            graph.edges.append(
                registration.PoseGraphEdge(
                    i, j, found.T_target_source, np.asarray(found.H), uncertain=i != j + 1
                )
            )
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            registration.GlobalOptimizationOption(0.02, 0.25, 1.0, 0),
        )
        result[:] = [np.asarray(node.pose) for node in graph.nodes]

    milliseconds = cpu_ms(task)
    degrees, shift = pose_errors(result, shots)
    who = 'small_gicp edges, Open3D pose graph'
    return [Row(name, who, Cost.of([milliseconds]), f'{degrees:.2f}°, {shift:.2f} mm')]


class _Open3dPairs:
    def __init__(self, edge: float) -> None:
        self.edge = edge
        self.o3d = load_open3d()
        self.registration = self.o3d.pipelines.registration
        self.most = self.registration.ICPConvergenceCriteria(1e-8, 1e-8, 50)

    def prepare(self, shot: Shot) -> Any:
        o3d, met = self.o3d, np.isfinite(shot.organised[:, 2])
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(shot.organised[met].astype(np.float64)))
        if shot.target.rgb is not None:
            cloud.colors = o3d.utility.Vector3dVector(shot.target.rgb.reshape(-1, 3)[met] / 255)
        cloud = cloud.voxel_down_sample(self.edge)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
        return cloud

    def align(self, target: Any, source: Any) -> Array:
        by = self.registration.TransformationEstimationPointToPlane()
        found = self.registration.registration_icp(source, target, MAX_DISTANCE, np.eye(4), by, self.most)
        return np.asarray(found.transformation)


class _Open3dColours(_Open3dPairs):
    def align(self, target: Any, source: Any) -> Array:
        found = self.registration.registration_colored_icp(
            source, target, COLOURED_DISTANCE, np.eye(4), criteria=self.most
        )
        return np.asarray(found.transformation)


class _SmallGicpPairs:
    def __init__(self, edge: float) -> None:
        self.edge = edge

    def prepare(self, shot: Shot) -> Any:
        points = shot.organised[np.isfinite(shot.organised[:, 2])]
        return small_gicp.preprocess_points(points, self.edge, 20, 1)

    def align(self, target: Any, source: Any) -> Array:
        found = small_gicp.align(
            target[0], source[0], target[1], registration_type='GICP',
            max_correspondence_distance=MAX_DISTANCE, num_threads=1, max_iterations=50,
        )  # fmt: skip
        return np.asarray(found.T_target_source)


def _measured(who: str, shots: list[Shot], peer: _Open3dPairs | _SmallGicpPairs, what: str = 'pair') -> Row:
    milliseconds, errors = [], []
    before = peer.prepare(shots[0])
    peer.align(before, before)
    for target, source in itertools.pairwise(shots):
        T, prepared = np.eye(4), before

        def scan(source: Shot = source, before: Any = before) -> None:
            nonlocal T, prepared
            prepared = peer.prepare(source)
            T = peer.align(before, prepared)

        milliseconds.append(cpu_ms(scan))
        errors.append(pair_error(T, target, source))
        before = prepared
    return Row(what, who, Cost.of(milliseconds), str(summary(errors)))
