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

"""Animation of a scan for the README: what the sensor sees, and the model that comes of it.

debris-scan simulate shuttle_stack --out BAG && debris-scan scan BAG --out OUT_DIR
python docs/draw_demo.py BAG OUT_DIR ANIMATION.gif
"""

import argparse
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from debris_scanner.core.frames import TargetFrame
from debris_scanner.core.geometry import Array, apply, compose, exp_so3, inverse
from debris_scanner.io.mesh_files import load_open3d
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sensing.preprocessing import Preprocessor
from debris_scanner.settings import Settings
from msg_adapters.bags import open_session

SIZE, CAPTION = 400, 40  # pixels: one panel, and the line of text below it
SAMPLES = 2  # a pixel, along each side
EVERY, HOLD = 3, 8  # frames of the recording shown, and how often the last one is repeated
FRAME_MS = 80
SHADES = 20  # of each colour
EXTENT = 0.235  # m, half the width of the right panel
RING = 0.215  # m: the sensor is drawn this far from the target, which it is not
VOXEL = 0.0018  # m, of the points gathered
TILT = np.radians(16.0)
START, DRIFT = np.radians(-65.0), np.radians(60.0)  # of the viewer: at first, and over all frames

BACKGROUND = np.array([22, 25, 33], np.uint8)
DEPTH = np.array([0.75, 0.9, 1.0]) * 235
CLOUD, MESH, NOW = np.array([120, 170, 205]), np.array([196, 205, 222]), np.array([255, 172, 64])
PATH, EDGE, INK = np.array([96, 108, 132]), np.array([110, 220, 150]), np.array([216, 222, 232])


class Canvas:
    """Orthographic picture with a depth buffer, seen along the third axis of R_viewer_target."""

    def __init__(self, R_viewer_target: Array) -> None:
        self.R = R_viewer_target
        n = SIZE * SAMPLES
        self.colour = np.broadcast_to(BACKGROUND, (n, n, 3)).copy()
        self.depth = np.full((n, n), np.inf)

    def splat(self, points: Array, colours: NDArray[Any], half: int = 1, nearer: float = 0.0) -> None:
        """Squares of ``2 half + 1`` samples at points (n, 3), target frame; colours (n, 3) or (3,)."""
        p = points @ self.R.T
        n = SIZE * SAMPLES
        column = ((p[:, 0] / EXTENT + 1) / 2 * n).astype(int)
        row = ((p[:, 1] / EXTENT + 1) / 2 * n).astype(int)
        far_first = np.argsort(-p[:, 2], kind='stable')
        column, row, z = column[far_first], row[far_first], p[far_first, 2] - nearer
        colours = np.broadcast_to(colours, points.shape)[far_first].astype(np.uint8)
        for dv in range(-half, half + 1):
            for du in range(-half, half + 1):
                v, u = row + dv, column + du
                seen = (v >= 0) & (u >= 0) & (v < n) & (u < n)
                v, u = v[seen], u[seen]
                front = z[seen] < self.depth[v, u]
                self.colour[v[front], u[front]] = colours[seen][front]
                self.depth[v[front], u[front]] = z[seen][front]

    def line(self, a: Array, b: Array, colour: Array, half: int = 1) -> None:
        """From a (3,) to b (3,)."""
        steps = np.linspace(0, 1, max(2, int(np.linalg.norm(b - a) / EXTENT * SIZE * SAMPLES)))[:, None]
        self.splat(a + steps * (b - a), colour, half)

    def mesh(self, scene: Any) -> None:
        """The surface of a raycasting scene, lit from the viewer's left shoulder."""
        o3d = load_open3d()
        n = SIZE * SAMPLES
        grid = ((np.arange(n) + 0.5) / n * 2 - 1) * EXTENT
        x, y = np.meshgrid(grid, grid)
        origin = np.stack([x, y, np.full_like(x, -1.0)], axis=-1) @ self.R
        direction = np.broadcast_to(self.R[2], origin.shape)
        hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([origin, direction], -1).astype(np.float32)))
        z = hit['t_hit'].numpy() - 1.0
        shade = shading(hit['primitive_normals'].numpy(), self.R)
        front = z < self.depth
        self.colour[front] = (shade[..., None] * MESH)[front].astype(np.uint8)
        self.depth[front] = z[front]

    def image(self) -> NDArray[np.uint8]:
        """(SIZE, SIZE, 3)."""
        samples = self.colour.reshape(SIZE, SAMPLES, SIZE, SAMPLES, 3)
        return samples.mean(axis=(1, 3)).astype(np.uint8)


def shading(normals: NDArray[Any], R_viewer_target: Array) -> NDArray[Any]:
    """Brightness (...) of unit normals (..., 3), target frame."""
    light = np.array([-0.5, -0.6, -0.8]) / np.linalg.norm([0.5, 0.6, 0.8]) @ R_viewer_target
    return np.asarray(0.35 + 0.65 * np.clip(normals @ light, 0, 1))


def surface(frame: TargetFrame, T_target_sensor: Array) -> tuple[Array, Array]:
    """Points and normals (n, 3) of a frame, target frame."""
    z = np.where((frame.depth > 0) & (frame.depth_fit > 0), frame.depth_fit, 0)
    points = frame.camera.back_project(z)
    good = z > 0
    return apply(T_target_sensor, points[good]), frame.normals[good] @ T_target_sensor[:3, :3].T


def depth_panel(depth: NDArray[Any], box: tuple[int, int, int], low: float, high: float) -> Image.Image:
    """A window of a depth image, near bright and far dark."""
    row, column, side = box
    window = depth[row : row + side, column : column + side]
    bright = np.rint((1 - 0.75 * np.clip((window - low) / (high - low), 0, 1)) * SHADES) / SHADES
    image = np.where(window[..., None] > 0, bright[..., None] * DEPTH, BACKGROUND)
    return Image.fromarray(image.astype(np.uint8)).resize((SIZE, SIZE), Image.Resampling.NEAREST)


def sensor(canvas: Canvas, T_target_sensor: Array) -> None:
    """A small camera on the ring around the target, and where it looks."""
    eye = T_target_sensor[:3, 3] / np.linalg.norm(T_target_sensor[:3, 3]) * RING
    R = T_target_sensor[:3, :3]
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = [eye + R @ np.array([0.028 * i, 0.021 * j, 0.05]) for i, j in signs]
    for k, corner in enumerate(corners):
        canvas.line(eye, corner, NOW)
        canvas.line(corner, corners[k - 1], NOW)


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('scan', type=Path)
    parser.add_argument('animation', type=Path)
    args = parser.parse_args()
    summary = json.loads((args.scan / 'summary.json').read_text())
    closed = next(c for c in summary['closures'] if c['accepted'])
    final = {p.stamp_ns: p.T_sensor_target for p in read_tum(args.scan / 'target_pose.tum')}
    scanned = {p.stamp_ns: p.T_sensor_target for p in read_tum(args.scan / 'odometry.tum')}
    first = min(set(final) & set(scanned))
    T_model_scan = compose(inverse(final[first]), scanned[first])

    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.io.read_triangle_mesh(str(args.scan / 'mesh.ply')))

    settings = Settings()
    preprocessor = Preprocessor(settings.isolation, settings.normals)
    with open_session(args.bag) as session:
        depths = [frame for _, frame in session]
    targets = [preprocessor.process(frame) for frame in depths]
    rows = np.concatenate([np.flatnonzero((f.depth > 0).any(axis=1))[[0, -1]] for f in depths])
    columns = np.concatenate([np.flatnonzero((f.depth > 0).any(axis=0))[[0, -1]] for f in depths])
    side = int(max(np.ptp(rows), np.ptp(columns))) + 24
    box = ((rows.min() + rows.max() - side) // 2, (columns.min() + columns.max() - side) // 2, side)
    box = (max(0, int(box[0])), max(0, int(box[1])), side)
    low, high = np.percentile(np.concatenate([f.depth[f.depth > 0][::50] for f in depths]), [1, 99])

    # the viewer stands upright on the spin axis
    up = inverse(final[first])[:3, :3] @ np.array(summary['rotation_axis_sensor'])
    up *= -np.sign((inverse(final[first])[:3, :3] @ [0.0, 1.0, 0.0]) @ up)
    z = np.cross(np.cross(up, inverse(final[first])[:3, 2]), up)
    upright = np.stack([np.cross(-up, z / np.linalg.norm(z)), -up, z / np.linalg.norm(z)])

    gathered: dict[tuple[int, ...], tuple[Array, Array]] = {}
    path: list[Array] = []
    images = []
    shown = range(0, len(targets), EVERY)
    for n in shown:
        target = targets[n]
        tracking = target.stamp_ns > closed['to_stamp_ns']
        T_sensor_target = final.get(target.stamp_ns)
        if not tracking and target.stamp_ns in scanned:
            T_sensor_target = compose(scanned[target.stamp_ns], inverse(T_model_scan))
        if T_sensor_target is None:
            continue
        T = inverse(T_sensor_target)
        turn = START + DRIFT * n / len(targets)
        canvas = Canvas(exp_so3(np.array([TILT, 0, 0])) @ exp_so3(np.array([0, turn, 0])) @ upright)
        points, normals = surface(target, T)
        if tracking:
            canvas.mesh(scene)
        else:
            for key, p, m in zip((points // VOXEL).astype(int), points, normals, strict=True):
                gathered.setdefault(tuple(key), (p, m))
            cloud, directions = (np.array(values) for values in zip(*gathered.values(), strict=True))
            facing = directions @ canvas.R[2] < 0.2
            canvas.splat(cloud[facing], shading(directions[facing], canvas.R)[:, None] * CLOUD, 2)
        canvas.splat(points, shading(normals, canvas.R)[:, None] * NOW, 2, nearer=0.002)
        path.append(T[:3, 3] / np.linalg.norm(T[:3, 3]) * RING)
        for a, b in pairwise(path):
            canvas.line(a, b, EDGE if tracking else PATH)
        sensor(canvas, T)
        seconds = (target.stamp_ns - targets[0].stamp_ns) * 1e-9
        images.append(
            sheet(
                depth_panel(depths[n].depth, box, low, high),
                Image.fromarray(canvas.image()),
                f'depth frames, {seconds:4.1f} s',
                'loop closed: tracking the model' if tracking else 'scanning, without a prior model',
            )
        )
    images = [i.quantize(palette=palette(), dither=Image.Dither.NONE) for i in images]
    durations = [FRAME_MS] * (len(images) - 1) + [FRAME_MS * HOLD]
    images[0].save(
        args.animation, save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=True
    )
    print(f'{args.animation}: {args.animation.stat().st_size // 1000} kB, {sum(durations) / 1000:.1f} s')


def palette() -> Image.Image:
    """Background, and every colour in all its shades."""
    share = np.linspace(0.2, 1, SHADES)[:, None]
    ramps = [share * colour for colour in (DEPTH, CLOUD, MESH, NOW)]
    lines = [BACKGROUND + k / 6 * (colour - BACKGROUND) for colour in (PATH, EDGE, INK) for k in range(1, 7)]
    colours = np.concatenate([BACKGROUND[None], *ramps, np.array(lines)])
    image = Image.new('P', (1, 1))
    image.putpalette(colours.astype(np.uint8).ravel().tolist())
    return image


def sheet(left: Image.Image, right: Image.Image, below_left: str, below_right: str) -> Image.Image:
    """Two panels side by side with a line of text below each."""
    page = Image.new('RGB', (2 * SIZE, SIZE + CAPTION), tuple(int(c) for c in BACKGROUND))
    page.paste(left, (0, 0))
    page.paste(right, (SIZE, 0))
    draw = ImageDraw.Draw(page)
    draw.text((16, SIZE + 8), below_left, fill=tuple(INK.tolist()), font_size=17)
    draw.text((SIZE + 16, SIZE + 8), below_right, fill=tuple(INK.tolist()), font_size=17)
    return page


if __name__ == '__main__':
    main()
