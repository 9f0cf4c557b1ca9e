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

"""One recording, whatever its layout: depth frames or clouds, in order, with stamps and poses if any."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, project_so3

MILLIMETRE = 0.001  # metres a unit of 16-bit depth, where nothing else is said
IMAGES = ('.png', '.tif', '.tiff', '.pgm')
# A measured rotation's singular values stray from 1 by a per cent; beyond this it is no rotation.
_ROTATION_TOLERANCE = 0.05


class RecordingError(ValueError):
    """A folder or file that cannot be read as a recording; the message names it and what is wrong."""


@dataclass(frozen=True)
class Given:
    """What the user says of a recording beside its files; None and '': nothing."""

    depth_scale: float = 0.0  # metres a unit; 0: the layout's
    intrinsics: tuple[float, float, float, float] | None = None  # fx, fy, cx, cy
    axes: Array | None = None  # T_optical_cloud (4, 4)
    target: str = ''  # the object or mask that is the target


@dataclass(frozen=True)
class Recording:
    """The frames of a recording, in order."""

    layout: str  # in words
    count: int
    read: Callable[[int, int], DepthFrame]  # index, stamp in ns
    stamps_ns: list[int] = field(default_factory=list)  # empty: it has none
    poses: list[Array | None] = field(default_factory=list)  # T_target_sensor (4, 4) of each, or empty
    unit: float = MILLIMETRE  # of its depth; what holds no whole millimetres is not written as such
    cloud: Callable[[int], tuple[NDArray[np.float32], NDArray[np.uint8] | None]] | None = None
    has_colour: bool = False
    remarks: list[str] = field(default_factory=list)  # lines that the user should read


def read_depth_image(path: Path, unit: float) -> NDArray[np.float32]:
    """Depth (h, w), metres, of an image file of 16 bit.

    Raises:
        RecordingError: it cannot be read, or has not 16 bit.
    """
    mode, pixels = _opened(path, '')
    if not mode.startswith('I') or pixels.ndim != 2:
        raise RecordingError(f'{path} is not a 16-bit depth image (image mode {mode})')
    return pixels.astype(np.float32) * np.float32(unit)


def read_colour_image(path: Path) -> NDArray[np.uint8]:
    """Colours (h, w, 3) of an image file.

    Raises:
        RecordingError: it cannot be read.
    """
    return _opened(path, 'RGB')[1]


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Pixels (h, w) of a mask that are not black.

    Raises:
        RecordingError: it cannot be read.
    """
    return np.asarray(_opened(path, 'L')[1] > 0)


def read_matrix(path: Path, *shapes: tuple[int, int]) -> Array:
    """Numbers of a text file as a matrix of the first shape that has as many.

    Raises:
        RecordingError: it does not hold so many finite numbers.
    """
    try:
        values = np.array([float(word) for word in path.read_text().replace(',', ' ').split()])
    except (OSError, ValueError) as error:
        raise RecordingError(f'cannot read {path}: {error}') from error
    for shape in shapes:
        if values.size == shape[0] * shape[1] and np.isfinite(values).all():
            return values.reshape(shape)
    rows, columns = shapes[0]
    raise RecordingError(f'{path} does not hold {rows} x {columns} finite numbers')


def read_pose(path: Path) -> Array:
    """Rigid transform (4, 4) of a text file, its 3 x 3 block made a rotation.

    Raises:
        RecordingError: it is none.
    """
    return rigid(read_matrix(path, (4, 4), (3, 4)), str(path))


def rigid(matrix: Array, name: str) -> Array:
    """A rigid transform (4, 4) of a measured one, (4, 4) or (3, 4).

    Raises:
        RecordingError: its 3 x 3 block is no rotation.
    """
    T = np.eye(4)
    T[:3] = matrix[:3]
    stretch = np.linalg.svd(T[:3, :3], compute_uv=False)
    if np.abs(stretch - 1).max() > _ROTATION_TOLERANCE or np.linalg.det(T[:3, :3]) < 0:
        raise RecordingError(f'{name} is no rigid transform: its 3 x 3 block is not a rotation')
    T[:3, :3] = project_so3(T[:3, :3])
    return T


def make_camera(K: Array, shape: tuple[int, ...], name: str) -> Camera:
    """Camera of a matrix (3, 3) and an image's shape (h, w).

    Raises:
        RecordingError: the focal lengths are not positive.
    """
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise RecordingError(f'{name} has no positive focal lengths')
    return Camera(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), shape[1], shape[0])


def given_camera(given: Given, shape: tuple[int, ...]) -> Camera | None:
    """Camera of the intrinsics that the user gives, if any."""
    if given.intrinsics is None:
        return None
    fx, fy, cx, cy = given.intrinsics
    return Camera(fx, fy, cx, cy, shape[1], shape[0])


def _opened(path: Path, mode: str) -> tuple[str, NDArray[np.uint8]]:
    try:
        with Image.open(path) as image:
            return image.mode, np.asarray(image.convert(mode) if mode else image)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:  # as Pillow pleases
        raise RecordingError(f'cannot read {path}: {error}') from error
