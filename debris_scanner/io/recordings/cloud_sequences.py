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

"""Sequences of clouds: PCD and PLY files, organised or not, and grids in an npz file."""

import re
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, from_quaternion, inverse, rotation_angle, transform
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.io.recordings.names import ordered
from debris_scanner.io.recordings.recording import Given, Recording, RecordingError, read_pose
from debris_scanner.sensing.cloud_axes import AXES_HELP, lies_along

SUFFIXES = ('.pcd', '.ply')
_HEADER = 4096  # bytes that hold the lines of a PCD's header that count
_POSE = '_extrinsic.txt'  # beside a cloud, T_sensor_target
_GRID = re.compile(r'points_?(\d+)')
_TRUTH = 'truth_txyz_qxyzw'  # of an npz file, T_target_sensor of each grid

Cloud = tuple[NDArray[np.float32], NDArray[np.uint8] | None]


def read_cloud_folder(folder: Path, given: Given) -> Recording:
    """PCD or PLY files, ordered by the numbers or times of their names.

    Files of several series, such as L_000 and R_000, follow each other where their poses are nearest.

    Raises:
        RecordingError: no such files, or nothing tells their order.
    """
    suffix = next(s for s in SUFFIXES if any(p.suffix.lower() == s for p in folder.iterdir()))
    numbered = [
        p for p in sorted(folder.iterdir()) if p.suffix.lower() == suffix and re.search(r'\d', p.stem)
    ]
    if not numbered:
        raise RecordingError(f'no {suffix} file in {folder} has a number in its name to order it by')
    series: dict[str, list[Path]] = {}
    for path in numbered:
        series.setdefault(re.sub(r'\d+(\.\d+)?\D*$', '', path.stem), []).append(path)
    stamps: list[int] = []
    if len(series) == 1:
        files = ordered(folder, suffix, only=set(numbered))
        paths, stamps = files.paths, files.keys if files.timed else []
    else:
        paths = _joined(folder, series)
    beside = [path.with_name(path.stem + _POSE) for path in paths]
    poses: list[Array | None] = []
    if all(path.is_file() for path in beside):
        poses = [inverse(read_pose(path)) for path in beside]
    return _recording(
        f'{suffix[1:].upper()} clouds', [partial(_read, path) for path in paths], poses, stamps, given
    )


def read_grids(path: Path, given: Given) -> Recording:
    """Arrays points_<n>, (rows, columns, 3) or (n, 3) in metres, of an npz file, in the order of n.

    Raises:
        RecordingError: it cannot be read, or has no such arrays.
    """
    try:
        arrays = dict(np.load(path))
    except (OSError, ValueError) as error:
        raise RecordingError(f'cannot read {path}: {error}') from None
    found = sorted((int(m[1]), name) for name in arrays if (m := _GRID.fullmatch(name)))
    clouds = [np.asarray(arrays[name], np.float32) for _, name in found]
    if not clouds or any(c.ndim not in (2, 3) or c.shape[-1] != 3 for c in clouds):
        raise RecordingError(f'{path} has no arrays points_<n> of x, y, z')
    poses: list[Array | None] = []
    truth = arrays.get(_TRUTH)
    if truth is not None and truth.shape == (len(clouds), 7):
        # as in Stanford's lists of scans, whose quaternions turn the other way
        poses = [transform(from_quaternion(row[3:]).T, row[:3]) for row in truth]
    return _recording('grids', [partial(_bare, cloud) for cloud in clouds], poses, [], given)


def _bare(points: NDArray[np.float32]) -> Cloud:
    return points, None


def _recording(
    layout: str,
    readers: list[Callable[[], Cloud]],
    poses: list[Array | None],
    stamps: list[int],
    given: Given,
) -> Recording:
    """A recording of clouds; those in other axes than the optical ones are turned."""
    scale = np.float32(given.depth_scale or 1.0)
    first = readers[0]()[0]
    T = given.axes
    if T is None and (along := lies_along(first)):
        raise RecordingError(
            f'points lie along {along}: not an optical frame (x right, y down, z forward); '
            f'give --axes, {AXES_HELP}'
        )
    T = np.eye(4) if T is None else T

    def cloud(index: int) -> Cloud:
        points, rgb = readers[index]()
        turned = scale * points @ T[:3, :3].T.astype(np.float32) + T[:3, 3].astype(np.float32)
        return turned.astype(np.float32), rgb

    def read(index: int, stamp_ns: int) -> DepthFrame:
        with np.errstate(all='ignore'):
            return DepthFrame.from_cloud(stamp_ns, *cloud(index))

    T_cloud_optical = inverse(T)
    return Recording(
        layout,
        len(readers),
        read,
        stamps,
        [None if pose is None else pose @ T_cloud_optical for pose in poses],
        cloud=cloud,
    )


def _joined(folder: Path, series: dict[str, list[Path]]) -> list[Path]:
    """The files of two series in one row, each forwards or backwards, where their poses are nearest."""
    names = ', '.join(f'{name}*' for name in series)
    if len(series) != 2 or not all(
        p.with_name(p.stem + _POSE).is_file() for files in series.values() for p in files
    ):
        raise RecordingError(
            f'{folder} has {len(series)} series of clouds ({names}), and no poses tell how they follow each '
            'other: import each from a folder of its own'
        )
    runs = [ordered(folder, files[0].suffix.lower(), only=set(files)).paths for files in series.values()]

    def gap(a: list[Path], b: list[Path]) -> float:
        before, after = (read_pose(p.with_name(p.stem + _POSE)) for p in (a[-1], b[0]))
        return rotation_angle(before[:3, :3].T @ after[:3, :3])

    ways = [(a[::x], b[::y]) for a, b in (runs, runs[::-1]) for x, y in product((1, -1), repeat=2)]
    a, b = min(ways, key=lambda way: gap(*way))
    return [*a, *b]


def _read(path: Path) -> Cloud:
    """Points (h, w, 3) or (n, 3) of a file, and their colours."""
    o3d = load_open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        read = o3d.io.read_point_cloud(str(path), remove_nan_points=False, remove_infinite_points=False)
    points = np.asarray(read.points, np.float32)
    if not len(points):
        raise RecordingError(f'{path} holds no points')
    rgb = np.rint(255 * np.asarray(read.colors)).astype(np.uint8) if read.has_colors() else None
    shape = _organised(path)
    if shape[0] > 1 and shape[0] * shape[1] == len(points):
        return points.reshape(*shape, 3), None if rgb is None else rgb.reshape(*shape, 3)
    return points, rgb


def _organised(path: Path) -> tuple[int, int]:
    """Rows and columns by a PCD's header; 1 row of any other file."""
    if path.suffix.lower() != '.pcd':
        return 1, 0
    with path.open('rb') as file:
        head = file.read(_HEADER)
    size = [re.search(rb'^%s\s+(\d+)' % name, head, re.MULTILINE) for name in (b'HEIGHT', b'WIDTH')]
    return (int(size[0][1]), int(size[1][1])) if size[0] and size[1] else (1, 0)
