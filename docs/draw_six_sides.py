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

"""A closed mesh from its six sides: what was seen in grey, what fills gaps in orange.

debris-scan import bunny_primesense --out BAG && debris-scan scan BAG --out OUT_DIR
python docs/draw_six_sides.py OUT_DIR PICTURE.png
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import ClosedMesh
from debris_scanner.core.geometry import Array, inverse, transform
from debris_scanner.io.known_models import read_known_model
from debris_scanner.io.trajectories import read_tum
from debris_scanner.sensing.rendering import MeshImages

SIZE, SAMPLES = 300, 3  # pixels of a panel; samples a pixel, along each side
AWAY = 6.0  # radii: little perspective
ACROSS = 2.1  # radii
BACKGROUND = np.array([22, 25, 33])
SEEN, FILLED = np.array([196, 205, 222]), np.array([235, 140, 52])
LIGHT = np.array([-0.4, -0.5, -1.0])  # towards it, camera frame


def upright(poses: list[Array]) -> Array:
    """Rotation (3, 3) whose columns are a viewer's axes: right, down and forward, target frame.

    The target's axis of rotation is vertical.
    """
    turns = np.array([inverse(T)[:3, :3] for T in poses])
    sights = turns[:, :, 2]
    axis = np.linalg.eigh(np.cov(sights.T))[1][:, 0]  # the sights lie on a cone about it
    down = axis * np.sign(turns[:, :, 1].mean(axis=0) @ axis)
    forward = sights[0] - (sights[0] @ down) * down
    forward /= np.linalg.norm(forward)
    return np.column_stack([np.cross(down, forward), down, forward])


def panel(images: MeshImages, mesh: ClosedMesh, R_target_viewer: Array) -> NDArray[np.uint8]:
    """The mesh seen from one side."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)).astype(np.float64) / 2
    radius = float(np.linalg.norm(mesh.vertices - middle, axis=1).max())
    n = SIZE * SAMPLES
    focal = n * AWAY / ACROSS
    camera = Camera(focal, focal, (n - 1) / 2, (n - 1) / 2, n, n)
    T_target_viewer = transform(R_target_viewer, middle - AWAY * radius * R_target_viewer[:, 2])
    frame = images.frame(camera, inverse(T_target_viewer))
    assert frame.rgb is not None
    shade = 0.35 + 0.65 * np.clip(frame.normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
    picture = np.where((frame.depth > 0)[..., None], frame.rgb * shade[..., None], BACKGROUND)
    pixels = picture.reshape(SIZE, SAMPLES, SIZE, SAMPLES, 3).mean(axis=(1, 3))
    return np.asarray(np.rint(pixels), np.uint8)


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('scan', type=Path, help='output folder of a scan')
    parser.add_argument('picture', type=Path)
    args = parser.parse_args()
    mesh = read_known_model(args.scan).closed
    assert mesh is not None
    # each face has corners of its own, and so a colour of its own
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    rgb = np.repeat(np.where(mesh.observed[:, None], SEEN, FILLED), 3, axis=0).astype(np.uint8)
    images = MeshImages(corners, np.arange(len(corners)).reshape(-1, 3), rgb=rgb)
    right, down, forward = upright([p.T_sensor_target for p in read_tum(args.scan / 'target_pose.tum')]).T
    sides = [
        (right, down, forward),  # front
        (-forward, down, right),
        (right, -forward, down),  # from above
        (-right, down, -forward),
        (forward, down, -right),
        (right, forward, -down),  # from below
    ]
    panels = [panel(images, mesh, np.column_stack(side)) for side in sides]
    rows = [np.concatenate(panels[k : k + 3], axis=1) for k in (0, 3)]
    # few colours suffice, and make the file small
    Image.fromarray(np.concatenate(rows)).quantize(128).save(args.picture, optimize=True)


if __name__ == '__main__':
    main()
