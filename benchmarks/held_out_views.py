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

"""How well the textured mesh looks: rendered where frames were taken that its texture was not made of.

The painted target is scanned; every frame that is no key frame is held out. The mesh is rendered at their
true poses and compared, inside the target's true outline, with the paint at the true surface. Where the mesh
is missing it shows the background. The bound is the same with the true poses in place of the scan's.

python -m benchmarks.held_out_views [TARGET ...] [--motion spin] [--sensor kinect1] [--exposures 0.2]
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import ClosedMesh, DepthFrame, LazyFrames
from debris_scanner.core.geometry import Array, compose, inverse, transform
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.evaluation.trajectory_errors import align, by_stamp
from debris_scanner.io.mesh_exports import glb, obj, png
from debris_scanner.modelling.closing import close
from debris_scanner.modelling.fusion import FusionSettings
from debris_scanner.modelling.refinement import integrated
from debris_scanner.modelling.texture import textured
from debris_scanner.scanner import Scanner
from debris_scanner.sensing.normals import NormalSettings
from debris_scanner.sensing.packing import PackedFrame
from debris_scanner.sim.motions import MOTION_NAMES, SPIN
from debris_scanner.sim.session import Simulation, SimulationSettings
from debris_scanner.sim.targets import BACKGROUND, paint_at

TARGETS = ('shuttle_stack', 'cubesat', 'defunct_satellite', 'asteroid', 'prism')
HELD_OUT = 24  # frames that are rendered, drawn evenly

Colours = Callable[[ClosedMesh, NDArray[np.int64], Array], Array]  # mesh, triangles (n,), shares (n, 3)


@dataclass(frozen=True)
class Likeness:
    """Of rendered images to true ones: PSNR over all pixels and channels, dB."""

    whole: float  # inside the true outline
    covered: float  # where the mesh is, too
    missing: float  # share of the outline's pixels where it is not


class Caster:
    """Casts a camera's rays at a mesh: vertices (m, 3), triangles (t, 3)."""

    def __init__(self, vertices: NDArray[np.floating], triangles: NDArray[np.integer]) -> None:
        self._o3d = load_open3d()
        self._scene = self._o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32)),
        )

    def cast(
        self, camera: Camera, T_sensor_mesh: Array
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array, Array]:
        """Which pixels (h, w) see the mesh; their triangles (n,), shares (n, 3) of corners, points (n, 3)."""
        T = inverse(T_sensor_mesh)
        v, u = np.mgrid[: camera.height, : camera.width]
        ray = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
        rays = np.empty((*u.shape, 6), np.float32)
        rays[..., :3], rays[..., 3:] = T[:3, 3], ray @ T[:3, :3].T
        cast = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        far = cast['t_hit'].numpy()
        met = np.isfinite(far)
        of_b, of_c = cast['primitive_uvs'].numpy()[met].T.astype(np.float64)
        points = rays[met][:, :3] + far[met][:, None].astype(np.float64) * rays[met][:, 3:]
        shares = np.column_stack([1 - of_b - of_c, of_b, of_c])
        return met, cast['primitive_ids'].numpy()[met].astype(np.int64), shares, points


def of_texture(mesh: ClosedMesh, faces: NDArray[np.int64], shares: Array) -> Array:
    """Colours (n, 3) of the texture, interpolated between texels as graphics cards do."""
    texture = mesh.texture
    assert texture is not None
    image = texture.image.astype(np.float64)
    size = np.array(image.shape[1::-1])
    uv = np.einsum('nk,nki->ni', shares, texture.uv[texture.triangles[faces]].astype(np.float64))
    at = np.clip(uv * size - 0.5, 0, size - 1.001)
    u, v = at.astype(int).T
    x, y = (at % 1).T[..., None]
    upper = (1 - x) * image[v, u] + x * image[v, u + 1]
    return np.asarray((1 - y) * upper + y * ((1 - x) * image[v + 1, u] + x * image[v + 1, u + 1]))


def of_vertices(mesh: ClosedMesh, faces: NDArray[np.int64], shares: Array) -> Array:
    """Colours (n, 3) of the vertices, interpolated on the triangles."""
    assert mesh.rgb is not None
    return np.asarray(np.einsum('nk,nki->ni', shares, mesh.rgb[mesh.triangles[faces]].astype(np.float64)))


def likeness(
    mesh: ClosedMesh,
    simulation: Simulation,
    poses: Sequence[Array],
    T_target_mesh: Array,
    colours: Colours = of_texture,
    any_exposure: bool = False,
) -> Likeness:
    """How a mesh looks beside the simulated target, without the sensor's noise.

    Args:
        mesh: with colours.
        simulation: of a painted target.
        poses: T_sensor_target (4, 4), true.
        T_target_mesh: (4, 4) where the mesh lies in the target's true frame.
        colours: of the mesh.
        any_exposure: one gain a channel, the same in all images, does not count.
    """
    true_surface = Caster(simulation.target.vertices, simulation.target.triangles)
    surface = Caster(mesh.vertices, mesh.triangles)
    true, found, covered = [], [], []
    for T in poses:
        outline, _, _, points = true_surface.cast(simulation.camera, T)
        met, faces, shares, _ = surface.cast(simulation.camera, compose(T, T_target_mesh))
        image = np.tile(np.array(BACKGROUND, np.float64), (*met.shape, 1))
        image[met] = colours(mesh, faces, shares)
        true.append(paint_at(points).astype(np.float64))
        found.append(image[outline])
        covered.append(met[outline])
    right, rendered, seen = np.concatenate(true), np.concatenate(found), np.concatenate(covered)
    if any_exposure:
        gains = (right[seen] * rendered[seen]).sum(axis=0) / (rendered[seen] ** 2).sum(axis=0)
        rendered = rendered * gains
    squared = (np.clip(rendered, 0, 255) - right) ** 2
    return Likeness(_psnr(squared), _psnr(squared[seen]), float(1 - seen.mean()))


def _psnr(squared: Array) -> float:
    return float(10 * np.log10(255**2 / squared.mean()))


def _figures(settings: SimulationSettings, exposures: float) -> list[str]:
    """A row of the table."""
    simulation, scanner = Simulation(settings), Scanner()
    rng = np.random.default_rng(1)
    packed: dict[int, PackedFrame] = {}
    truth: dict[int, Array] = {}
    for frame in tqdm(simulation, desc=settings.target, leave=False, total=len(simulation), disable=None):
        assert frame.rgb is not None
        gains = rng.uniform(1 - exposures, 1 + exposures, 3)
        rgb = np.clip(np.rint(frame.rgb * gains), 0, 255).astype(np.uint8)
        step = scanner.process(DepthFrame(frame.stamp_ns, frame.depth, frame.camera, rgb))
        truth[frame.stamp_ns] = frame.T_sensor_target
        if step.target is not None:
            packed[frame.stamp_ns] = PackedFrame(step.target)
    result = scanner.finish()
    if result.model is None or result.model.closed is None:
        return [settings.target, f'no model: {result.reason}']
    closed = result.model.closed
    used = {p.stamp_ns for p in result.keyframe_poses}
    unused = [stamp for stamp in truth if stamp not in used]
    held_out = [truth[unused[n]] for n in np.linspace(0, len(unused) - 1, HELD_OUT).astype(int)]

    # a simulated target's own axes are parallel to its faces; a scan's are not
    R = truth[min(truth)][:3, :3]
    T_target_mesh = transform(R.T, np.zeros(3))

    def posed(stamps: Sequence[int]) -> LazyFrames[int]:
        return LazyFrames(
            stamps,
            lambda s: (packed[s].restore(NormalSettings()), inverse(compose(truth[s], T_target_mesh))),
        )

    fused = [s for s in packed if s in by_stamp(result.poses)]
    frames = posed(fused)
    ideal = close(integrated(frames, FusionSettings()), frames)
    assert ideal is not None
    views = list(posed([s for s in fused if s in used]))  # restored, as at the end of a scan
    began = time.process_time()
    ideal = textured(ideal, views)
    cost = time.process_time() - began
    found = align(truth, by_stamp(result.poses))
    rows = [
        likeness(closed, simulation, held_out, found, of_vertices, exposures > 0),
        likeness(closed, simulation, held_out, found, of_texture, exposures > 0),
        likeness(ideal, simulation, held_out, T_target_mesh, of_texture, exposures > 0),
    ]
    texture = closed.texture
    assert texture is not None
    sizes = [len(data) / 1e6 for data in (glb(closed), obj(closed), png(texture))]
    return [
        settings.target,
        *(f'{row.covered:.1f}' for row in rows),
        f'{rows[1].whole:.1f}',
        f'{100 * rows[1].missing:.1f}',
        str(len(used)),
        f'{cost:.1f}',
        f'{texture.image.shape[1]} x {texture.image.shape[0]}',
        *(f'{size:.1f}' for size in sizes),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('targets', nargs='*', default=TARGETS)
    parser.add_argument('--motion', default=SPIN, choices=MOTION_NAMES)
    parser.add_argument('--sensor', default='kinect1')
    parser.add_argument('--exposures', type=float, default=0.0, help='spread of gains, by frame and channel')
    args = parser.parse_args()
    print(
        '| target | vertex colours, dB | texture, dB | true poses, dB | whole outline, dB | mesh missing, % '
        '| views | CPU, s | texels | glb, MB | obj, MB | png, MB |'
    )
    print('|' + '---|' * 12)
    for target in args.targets:
        settings = SimulationSettings(target=target, motion=args.motion, sensor=args.sensor, colour=True)
        print('| ' + ' | '.join(_figures(settings, args.exposures)) + ' |', flush=True)


if __name__ == '__main__':
    main()
