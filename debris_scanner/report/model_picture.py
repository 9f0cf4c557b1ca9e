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

"""A picture of the model, for who has no program that shows a mesh."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.geometry import exp_so3
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.mesh_files import read_mesh
from debris_scanner.io.result_files import PICTURE

SIZE = 420  # pixels, of one panel
SIDES = ((0.4, -0.35), (1.9, -0.35), (3.5, -0.35))  # rad: how far the viewer turns about y, and tilts
BACKGROUND = np.array([250, 250, 252])
_SAMPLES = 2  # a pixel, along each side


def draw_side(mesh_file: Path, turn: float, tilt: float) -> NDArray[np.uint8]:
    """The mesh from one side, lit from the viewer's left shoulder; orthographic, (SIZE, SIZE, 3).

    Raises:
        MeshFileError: the file holds no mesh.
    """
    o3d = load_open3d()
    vertices, triangles = read_mesh(mesh_file)
    middle = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    radius = np.linalg.norm(vertices - middle, axis=1).max() * 1.02
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(triangles.astype(np.uint32))
    )
    R = exp_so3(np.array([0.0, turn, 0.0])) @ exp_so3(np.array([tilt, 0.0, 0.0]))
    samples = SIZE * _SAMPLES
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
    return np.asarray(image.reshape(SIZE, _SAMPLES, SIZE, _SAMPLES, 3).mean(axis=(1, 3)).astype(np.uint8))


def write_picture(directory: Path) -> Path:
    """Draw the mesh of a result from three sides, beside it; returns the file.

    Raises:
        MeshFileError: the folder has no mesh.
        OSError: the picture cannot be written.
    """
    from PIL import Image

    panels = [draw_side(directory / 'mesh.ply', *side) for side in SIDES]
    path = directory / PICTURE
    Image.fromarray(np.concatenate(panels, axis=1)).save(path, optimize=True)
    return path
