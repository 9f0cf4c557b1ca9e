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

"""Picture of a scan for the README: one input frame, then the model from four sides.

python docs/draw_scan.py OUT_DIR PICTURE.png [--simulate TARGET]
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from debris_scanner.core.geometry import exp_so3
from debris_scanner.io.mesh_files import load_open3d
from debris_scanner.sim.session import Simulation, SimulationSettings

SIZE = 420  # pixels, of one panel
BACKGROUND = np.array([250, 250, 252])
INK = (70, 74, 84)


def render(mesh_file: Path, turn: float, tilt: float) -> NDArray[np.uint8]:
    """The mesh from one side, lit from the viewer's left shoulder; orthographic, (SIZE, SIZE, 3)."""
    o3d = load_open3d()
    mesh = o3d.t.io.read_triangle_mesh(str(mesh_file))
    vertices = mesh.vertex.positions.numpy()
    middle = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    radius = np.linalg.norm(vertices - middle, axis=1).max() * 1.02
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh)
    R = exp_so3(np.array([0.0, turn, 0.0])) @ exp_so3(np.array([tilt, 0.0, 0.0]))
    samples = SIZE * 2
    grid = (np.arange(samples) + 0.5) / samples * 2 - 1
    x, y = np.meshgrid(grid * radius, grid * radius)
    origin = np.stack([x, y, np.full_like(x, -2 * radius)], axis=-1) @ R.T + middle
    direction = np.broadcast_to(R @ [0.0, 0.0, 1.0], origin.shape)
    hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([origin, direction], -1).astype(np.float32)))
    normal = hit['primitive_normals'].numpy()
    light = R @ (np.array([-0.5, -0.6, -0.8]) / np.linalg.norm([0.5, 0.6, 0.8]))
    shade = 0.35 + 0.65 * np.clip(np.abs(normal @ light), 0, 1)
    colour = shade[..., None] * np.array([196, 205, 222])
    seen = np.isfinite(hit['t_hit'].numpy())[..., None]
    image = np.where(seen, colour, BACKGROUND)
    return image.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3)).astype(np.uint8)


def depth_panel(target: str) -> NDArray[np.uint8]:
    """First simulated depth frame, near bright and far dark, cut to the target."""
    depth = Simulation(SimulationSettings(target=target)).frame(0).depth_mm.astype(float)
    v, u = np.nonzero(depth)
    half = max(np.ptp(v), np.ptp(u)) // 2 + 12
    cv, cu = (v.max() + v.min()) // 2, (u.max() + u.min()) // 2
    window = np.pad(depth, half)[cv : cv + 2 * half, cu : cu + 2 * half]
    near, far = np.percentile(window[window > 0], [1, 99])
    grey = 235 - 190 * np.clip((window - near) / (far - near), 0, 1)
    image = np.where(window[..., None] > 0, grey[..., None] * np.array([0.75, 0.9, 1.0]), [24, 26, 34])
    return np.asarray(Image.fromarray(image.astype(np.uint8)).resize((SIZE, SIZE), Image.Resampling.NEAREST))


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scan', type=Path)
    parser.add_argument('picture', type=Path)
    parser.add_argument('--simulate', default='shuttle_stack')
    args = parser.parse_args()
    sides = [(0.4, -0.35), (1.9, -0.35), (3.5, -0.35)]
    panels = [depth_panel(args.simulate), *(render(args.scan / 'mesh.ply', *side) for side in sides)]
    captions = ['one of the depth frames', 'the mesh', 'turned', 'and turned again']
    sheet = Image.new('RGB', (SIZE * len(panels), SIZE + 34), tuple(BACKGROUND))
    draw = ImageDraw.Draw(sheet)
    for k, (panel, caption) in enumerate(zip(panels, captions, strict=True)):
        sheet.paste(Image.fromarray(panel), (k * SIZE, 0))
        draw.text((k * SIZE + 12, SIZE + 8), caption, fill=INK, font_size=16)
    sheet.save(args.picture, optimize=True)


if __name__ == '__main__':
    main()
