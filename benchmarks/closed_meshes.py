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

"""What closed meshes are worth: targets are scanned, and their closed meshes compared with the true shapes.

The true volume is what lies inside any of the shells that a target is made of. A mesh whose shells do not
close has none. Thickness is compared along the true normals, at true points that are as thin as given, where
both sides were observed. "Exact" columns are of the same frames, fused at their true poses.

python -m benchmarks.closed_meshes [TARGET ...] [--motions spin tumble] [--store closed_meshes.json]

Finished rows are kept in the store, and not made again.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from tqdm import tqdm

from debris_scanner.core.frames import ClosedMesh, DepthFrame, LazyFrames, Posed
from debris_scanner.core.geometry import Array, apply, compose, inverse, transform
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.evaluation.trajectory_errors import align, by_stamp
from debris_scanner.evaluation.true_surface import TrueSurface
from debris_scanner.io.files import write_atomically
from debris_scanner.modelling.closing import close, open_mesh
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import integrated
from debris_scanner.modelling.solid import solid
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import PackedFrame
from debris_scanner.sim.motions import MOTION_NAMES, TUMBLES
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.surface import sample_mesh
from debris_scanner.sim.targets import TARGET_NAMES

SECONDS, SECONDS_TUMBLE = 15.0, 40.0
RAYS = 500  # across a target, along each axis
VOLUMES_AGREE = 0.01  # between the three axes, of a mesh whose shells close
SAMPLES = 20_000  # points of a surface
THIN = 0.010  # m
APART = 0.006  # m, from a thin panel, where rays at it start
COLUMNS = (
    'target', 'motion', 'seen', 'watertight', 'bodies', 'volume, %', 'exact, %',
    'RMSE of observed / open, mm', 'panels', 'thickness error, mm', 'exact, mm', 'CPU, s',
)  # fmt: skip


@dataclass(frozen=True)
class Quality:
    """A closed mesh beside the true shape."""

    seen: float  # share of its surface
    watertight: bool
    bodies: int
    volume: float | None  # its error, a share of the true one; None where that is not known
    rmse: tuple[float, float]  # m, of observed faces and of the open mesh
    panels: float  # share of thin true points that have both sides observed in the mesh
    thickness: (
        tuple[float, float] | None
    )  # m, error of these points: median, and 90 % of them below; None of none


class Shells:
    """A mesh as a set of shells, oriented outward: vertices (m, 3), triangles (t, 3)."""

    def __init__(self, vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> None:
        self._o3d = load_open3d()
        self.vertices = np.asarray(vertices, np.float64)
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )
        corners = self.vertices[triangles]
        self.normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def first(self, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int64]]:
        """Distance (n,) along rays to the first hit, inf without, and the triangle (n,) there."""
        rays = np.column_stack([origins, directions]).astype(np.float32)
        hit = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        return hit['t_hit'].numpy().astype(np.float64), hit['primitive_ids'].numpy().astype(np.int64)

    def volume(self) -> float | None:
        """Volume, m³, inside any shell; None if rays along the three axes do not agree about it."""
        found = [self._volume_along(axis) for axis in range(3)]
        if max(found) - min(found) > VOLUMES_AGREE * max(found):
            return None
        return float(np.median(found))

    def _volume_along(self, axis: int) -> float:
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        step = float((high - low).max()) / RAYS
        others = [k for k in range(3) if k != axis]
        # an odd fraction of a step, so that no ray runs along a face
        grid = np.meshgrid(*(np.arange(low[k] + 0.37 * step, high[k], step) for k in others), indexing='ij')
        rays = np.zeros((grid[0].size, 6), np.float32)
        for k, at in zip(others, grid, strict=True):
            rays[:, k] = at.ravel()
        rays[:, axis], rays[:, 3 + axis] = low[axis] - step, 1
        hits = self._scene.list_intersections(self._o3d.core.Tensor(rays))
        ray, far = hits['ray_ids'].numpy().astype(np.int64), hits['t_hit'].numpy().astype(np.float64)
        turn = -np.sign(
            self.normals[hits['primitive_ids'].numpy().astype(np.int64), axis]
        )  # +1: into a shell
        order = np.lexsort([far, ray])
        ray, far, turn = ray[order], far[order], turn[order]
        depth = np.cumsum(turn)
        starts = np.concatenate([[True], ray[1:] != ray[:-1]])
        depth -= np.concatenate([[0.0], depth[:-1]])[
            np.maximum.accumulate(np.where(starts, np.arange(len(ray)), 0))
        ]
        inside = (depth[:-1] > 0) & ~starts[1:]
        return float((far[1:] - far[:-1])[inside].sum() * step**2)


def quality(
    mesh: ClosedMesh, true: Shells, surface: TrueSurface, T_true_mesh: Array, volume: float | None
) -> Quality:
    """Compare a closed mesh with the true shape.

    Args:
        mesh: closed.
        true: the target's shells.
        surface: the same, for distances.
        T_true_mesh: (4, 4) where the mesh lies.
        volume: true, m³, or None.
    """
    placed = apply(T_true_mesh, mesh.vertices.astype(np.float64))
    body = trimesh.Trimesh(placed, mesh.triangles, process=False)
    found = Shells(placed, mesh.triangles)
    used, triangles = open_mesh(mesh)
    rmse = [
        float(np.sqrt(np.mean(surface.distance(sample_mesh(*of, SAMPLES)) ** 2)))
        for of in ((placed, mesh.triangles[mesh.observed]), (placed[used], triangles))
    ]
    area = np.linalg.norm(found.normals, axis=1)
    panels, thickness = _panels(mesh, found, true, surface)
    return Quality(
        float(area[mesh.observed].sum() / area.sum()),
        bool(body.is_watertight and body.is_winding_consistent),
        int(body.body_count),
        None if volume is None else solid(mesh).volume / volume - 1,
        (rmse[0], rmse[1]),
        panels,
        thickness,
    )


def _panels(
    mesh: ClosedMesh, found: Shells, true: Shells, surface: TrueSurface
) -> tuple[float, tuple[float, float] | None]:
    """Share of thin true points both sides of which the mesh observed, and errors of the thickness there."""
    points = surface.samples[:: max(1, len(surface.samples) // SAMPLES)]
    eps = 1e-5
    normals = _normals(points, true)
    clear, _ = true.first(points + eps * normals, normals)
    depth, face = true.first(points - eps * normals, -normals)
    depth = np.where(np.isfinite(depth), depth + eps, 1.0)  # beyond any panel
    out = np.einsum('ni,ni->n', true.normals[np.minimum(face, len(true.normals) - 1)], normals) < 0
    beyond, _ = true.first(points - (depth[:, None] + 2 * eps) * normals, -normals)
    thin = (depth < THIN) & out & (clear > 2 * APART) & (beyond > 2 * APART)
    if thin.sum() < SAMPLES // 200:
        return 0.0, None
    points, normals, depth = points[thin], normals[thin], depth[thin]
    near, here = found.first(points + APART * normals, -normals)
    far, there = found.first(points - (depth + APART)[:, None] * normals, normals)
    reached = (near < 2 * APART) & (far < 2 * APART)
    reached[reached] &= mesh.observed[here[reached]] & mesh.observed[there[reached]]
    if not reached.any():
        return 0.0, None
    wrong = depth + 2 * APART - near - far - depth
    middle = float(np.median(wrong[reached]))
    return float(reached.mean()), (middle, float(np.quantile(np.abs(wrong[reached]), 0.9)))


def _normals(points: Array, shells: Shells) -> Array:
    """Unit normals (n, 3) of the shells at points on them."""
    query = shells._o3d.core.Tensor(points.astype(np.float32))
    nearest = shells._scene.compute_closest_points(query)['primitive_ids'].numpy().astype(np.int64)
    normals = shells.normals[nearest]
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def measure(settings: SimulationSettings) -> dict[str, Any]:
    """Scan a simulated target; a row of the table, by column."""
    simulation, scanner = Simulation(settings), Scanner()
    began = time.process_time()
    packed: dict[int, PackedFrame] = {}
    truth: dict[int, Array] = {}
    for frame in tqdm(
        simulation, desc=Path(settings.target).stem, leave=False, total=len(simulation), disable=None
    ):
        step = scanner.process(DepthFrame(frame.stamp_ns, frame.depth, frame.camera))
        truth[frame.stamp_ns] = frame.T_sensor_target
        if step.target is not None:
            packed[frame.stamp_ns] = PackedFrame(step.target)
    result = scanner.finish()
    row: dict[str, Any] = {'target': Path(settings.target).stem, 'motion': settings.motion}
    if result.model is None or result.model.closed is None:
        return row | {'seen': f'no model: {result.reason}'}
    target = simulation.target
    true = Shells(target.vertices, target.triangles)
    surface = TrueSurface((np.asarray(target.vertices, np.float64), np.asarray(target.triangles, np.int32)))
    volume = true.volume()
    poses = by_stamp(result.poses)
    found = quality(result.model.closed, true, surface, align(truth, poses), volume)
    exact = _exact([s for s in packed if s in poses], packed, truth)
    ideal = quality(exact[0], true, surface, exact[1], volume)
    return row | {
        'seen': f'{found.seen:.3f}',
        'watertight': 'yes' if found.watertight else 'no',
        'bodies': str(found.bodies),
        'volume, %': _percent(found.volume),
        'exact, %': _percent(ideal.volume),
        'RMSE of observed / open, mm': ' / '.join(f'{1e3 * x:.3f}' for x in found.rmse),
        'panels': '' if found.thickness is None else f'{found.panels:.2f}',
        'thickness error, mm': _millimetres(found.thickness),
        'exact, mm': _millimetres(ideal.thickness),
        'CPU, s': f'{time.process_time() - began:.0f}',
    }


def _exact(
    stamps: Sequence[int], packed: dict[int, PackedFrame], truth: dict[int, Array]
) -> tuple[ClosedMesh, Array]:
    """The closed mesh of frames at their true poses, and T_true_mesh (4, 4)."""
    # a simulated target's own axes are parallel to its faces; a scan's are not
    T_true_mesh = transform(truth[min(truth)][:3, :3].T, np.zeros(3))

    def restore(stamp: int) -> Posed:
        return packed[stamp].restore(NormalSettings()), inverse(compose(truth[stamp], T_true_mesh))

    frames = LazyFrames(stamps, restore)
    mesh = close(integrated(frames, FusionSettings()), frames)
    assert mesh is not None
    return mesh, T_true_mesh


def _percent(share: float | None) -> str:
    return 'no true one' if share is None else f'{100 * share:+.1f}'


def _millimetres(errors: tuple[float, float] | None) -> str:
    return '' if errors is None else f'{1e3 * errors[0]:+.2f} (90 %: {1e3 * errors[1]:.2f})'


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shapes = [name for name in TARGET_NAMES if name != 'empty']
    parser.add_argument('targets', nargs='*', default=shapes, metavar='TARGET', help='names or mesh files')
    parser.add_argument('--motions', nargs='+', default=['spin', 'tumble'], choices=MOTION_NAMES)
    parser.add_argument('--seconds', type=float, help=f'length ({SECONDS:.0f}, tumbles {SECONDS_TUMBLE:.0f})')
    parser.add_argument('--store', type=Path, default=Path('closed_meshes.json'), help='of finished rows')
    args = parser.parse_args()
    rows: dict[str, dict[str, Any]] = json.loads(args.store.read_text()) if args.store.is_file() else {}
    cases = [(target, motion) for target in args.targets for motion in args.motions]
    for target, motion in tqdm(cases, desc='scans', disable=None):
        seconds = args.seconds or (SECONDS_TUMBLE if motion in TUMBLES else SECONDS)
        key = f'{Path(target).stem} {motion} {seconds:g}'
        if key not in rows:
            rows[key] = measure(SimulationSettings(target=target, motion=motion, seconds=seconds))
            write_atomically(args.store, json.dumps(rows, indent=1).encode())
    print('| ' + ' | '.join(COLUMNS) + ' |\n|' + '---|' * len(COLUMNS))
    for row in rows.values():
        print('| ' + ' | '.join(str(row.get(name, '')) for name in COLUMNS) + ' |')


if __name__ == '__main__':
    main()
