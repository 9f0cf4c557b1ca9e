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

"""A folder of depth images with its intrinsics, and colour and poses if it has them.

Layout: ``depth/depth_<i>.png`` (16 bit, millimetres, 0 where invalid), ``color/color_<i>.png``,
``poses/poses_<i>.txt`` (4x4, camera to board), ``Intrinsic.txt`` (3x3). The depth images may lie in the
folder itself. Files belong together by the last number in their name and are ordered by it.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, project_so3

_COLOUR_FOLDERS = ('color', 'colour', 'rgb')
_POSE_FOLDERS = ('poses', 'pose')
# A measured rotation's singular values stray from 1 by a per cent; beyond this it is no rotation.
_ROTATION_TOLERANCE = 0.05


class DepthFolderError(ValueError):
    """A folder that cannot be read as depth images; the message names the file and what is wrong."""


@dataclass(frozen=True)
class DepthFolder:
    """The files of a folder, in the frames' order. ``poses`` is empty where the folder has none."""

    depth: list[Path]
    colour: list[Path]  # empty, or one a frame
    camera: Camera
    poses: list[Array]  # T_target_sensor of each frame, or empty

    def __len__(self) -> int:
        return len(self.depth)

    def frame(self, index: int, stamp_ns: int) -> DepthFrame:
        """One frame, with colour where the folder has it.

        Raises:
            DepthFolderError: the image is unreadable, not 16 bit, or of another size than the first.
        """
        depth = _read_depth(self.depth[index])
        if depth.shape != (self.camera.height, self.camera.width):
            raise DepthFolderError(
                f'{self.depth[index]} is {depth.shape[1]} x {depth.shape[0]} pixels, '
                f'{self.depth[0].name} is {self.camera.width} x {self.camera.height}'
            )
        rgb = _read_colour(self.colour[index], depth.shape) if self.colour else None
        return DepthFrame(stamp_ns, depth, self.camera, rgb)


def open_depth_folder(folder: Path) -> DepthFolder:
    """Find and pair the files of a folder; the images themselves are read one by one later.

    Raises:
        DepthFolderError: not a folder, no depth images, no usable intrinsics, or frames without a partner.
    """
    if not folder.is_dir():
        raise DepthFolderError(f'{folder} is not a folder' if folder.exists() else f'{folder} does not exist')
    home = folder / 'depth' if (folder / 'depth').is_dir() else folder
    depth = _numbered(home, '.png')
    if not depth:
        raise DepthFolderError(f'no depth images (*.png) in {home}')
    camera = _read_camera(folder, _read_depth(next(iter(depth.values()))).shape)
    colour = _partners(folder, _COLOUR_FOLDERS, ('.png', '.jpg'), depth, 'colour image')
    poses = _partners(folder, _POSE_FOLDERS, ('.txt',), depth, 'pose')
    return DepthFolder(list(depth.values()), colour, camera, [_read_pose(path) for path in poses])


def _numbered(folder: Path, *endings: str) -> dict[int, Path]:
    """Files by the last number in their name, in its order."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in endings or path.name.startswith('.'):
            continue
        numbers = re.findall(r'\d+', path.stem)
        if not numbers:
            raise DepthFolderError(f'{path} has no number in its name to order it by')
        other = found.setdefault(int(numbers[-1]), path)
        if other is not path:
            raise DepthFolderError(f'{path} and {other.name} have the same number')
    return dict(sorted(found.items()))


def _partners(
    folder: Path, names: tuple[str, ...], endings: tuple[str, ...], depth: dict[int, Path], what: str
) -> list[Path]:
    """One file per depth image, from the first of the named folders that exists; empty without one."""
    home = next((folder / name for name in names if (folder / name).is_dir()), None)
    files = _numbered(home, *endings) if home else {}
    if not files:
        return []
    if missing := [path.name for number, path in depth.items() if number not in files]:
        raise DepthFolderError(
            f'{home} has no {what} for {missing[0]} ({len(missing)} of {len(depth)} missing)'
        )
    return [files[number] for number in depth]


def _read_depth(path: Path) -> NDArray[np.float32]:
    try:
        with Image.open(path) as image:
            mode, pixels = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError) as error:  # Pillow raises these for broken files
        raise DepthFolderError(f'cannot read {path}: {error}') from error
    if not mode.startswith('I') or pixels.ndim != 2:
        raise DepthFolderError(f'{path} is not a 16-bit depth image in millimetres (image mode {mode})')
    return pixels.astype(np.float32) * np.float32(0.001)


def _read_colour(path: Path, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    try:
        with Image.open(path) as image:
            rgb = np.asarray(image.convert('RGB'))
    except (OSError, SyntaxError, ValueError) as error:
        raise DepthFolderError(f'cannot read {path}: {error}') from error
    if rgb.shape[:2] != shape:
        raise DepthFolderError(f'{path} is not registered to the depth: its size differs')
    return rgb


def _read_camera(folder: Path, shape: tuple[int, ...]) -> Camera:
    path = next((p for p in sorted(folder.iterdir()) if re.fullmatch(r'(?i)intrinsics?\.txt', p.name)), None)
    if path is None:
        raise DepthFolderError(f'no Intrinsic.txt (3 x 3 camera matrix) in {folder}')
    K = _read_matrix(path, (3, 3))
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise DepthFolderError(f'{path} has no positive focal lengths')
    return Camera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], shape[1], shape[0])


def _read_pose(path: Path) -> Array:
    T = _read_matrix(path, (4, 4))
    stretch = np.linalg.svd(T[:3, :3], compute_uv=False)
    if np.abs(stretch - 1).max() > _ROTATION_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
        raise DepthFolderError(f'{path} is no rigid transform: its 3 x 3 block is not a rotation')
    T[:3, :3] = project_so3(T[:3, :3])
    T[3] = (0.0, 0.0, 0.0, 1.0)
    return T


def _read_matrix(path: Path, shape: tuple[int, int]) -> Array:
    try:
        values = np.array([float(word) for word in path.read_text().split()])
    except (OSError, ValueError) as error:
        raise DepthFolderError(f'cannot read {path}: {error}') from error
    if values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise DepthFolderError(f'{path} does not hold {shape[0]} x {shape[1]} finite numbers')
    return values.reshape(shape)
