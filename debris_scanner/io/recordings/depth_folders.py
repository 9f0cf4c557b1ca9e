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

"""Depth images in folders: ours, Open3D's recorder, TUM RGB-D and BOP.

All come down to the same: depth files in order, perhaps with colour, masks and poses, and a camera.
"""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import Array, inverse, transform
from debris_scanner.io.recordings.names import Files, nearest, ordered, paired
from debris_scanner.io.recordings.recording import (
    IMAGES,
    MILLIMETRE,
    Given,
    Recording,
    RecordingError,
    given_camera,
    make_camera,
    read_colour_image,
    read_depth_image,
    read_mask,
    read_matrix,
    read_pose,
    rigid,
)

COLOUR_FOLDERS = ('color', 'colour', 'rgb')
POSE_FOLDERS = ('poses', 'pose')
MASK_FOLDERS = ('mask', 'masks', 'mask_visib', 'segmentation')
COLOUR_FILES = ('.png', '.jpg', '.jpeg')
TUM_UNIT = 1 / 5000
TUM_HINT = '--intrinsics 525,525,319.5,239.5 is what the TUM sequences are read with'
ASK = 'give --intrinsics FX,FY,CX,CY'


@dataclass(frozen=True)
class _Images:
    """The files of a recording; lists are empty, or have one entry a frame."""

    layout: str
    depth: list[Path]
    camera: Callable[[int], Camera]
    unit: Callable[[int], float]
    colour: list[Path | None] = field(default_factory=list)
    masks: list[Path | None] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Array | None] = field(default_factory=list)

    def recording(self) -> Recording:
        """As a recording; colour of another size than the depth is left out, with a remark."""
        colour, remarks = self.colour, []
        first = next((path for path in colour if path is not None), None)
        if first is not None:
            c, shape = self.camera(0), read_colour_image(first).shape
            if shape[:2] != (c.height, c.width):
                remarks.append(
                    f'colour is not used: {first} is {shape[1]} x {shape[0]} pixels, the depth is '
                    f'{c.width} x {c.height}: not registered'
                )
                colour = []
        if self.masks:
            remarks.append(f'{sum(m is not None for m in self.masks)} masks choose the target')

        def read(index: int, stamp_ns: int) -> DepthFrame:
            camera, path = self.camera(index), self.depth[index]
            depth = read_depth_image(path, self.unit(index))
            if depth.shape != (camera.height, camera.width):
                raise RecordingError(
                    f'{path} is {depth.shape[1]} x {depth.shape[0]} pixels, '
                    f'{self.depth[0].name} is {camera.width} x {camera.height}'
                )
            mask_file = self.masks[index] if self.masks else None
            if self.masks and mask_file is None:  # the target is not in the picture
                depth = np.zeros_like(depth)
            elif mask_file is not None:
                mask = read_mask(mask_file)
                if mask.shape != depth.shape:
                    raise RecordingError(f'{mask_file} is of another size than its depth image')
                depth = np.where(mask, depth, np.float32(0))
            file = colour[index] if colour else None
            rgb = None if file is None else read_colour_image(file)
            if rgb is not None and rgb.shape[:2] != depth.shape:
                raise RecordingError(f'{file} is not registered to the depth: its size differs')
            return DepthFrame(stamp_ns, depth, camera, rgb)

        return Recording(
            self.layout,
            len(self.depth),
            read,
            self.stamps_ns,
            self.poses,
            self.unit(0),
            has_colour=bool(colour),
            remarks=remarks,
        )


def read_plain(folder: Path, given: Given) -> Recording:
    """Our own layout: depth images in the folder or its ``depth/``, with an Intrinsic.txt.

    Beside them ``color/``, ``masks/`` and ``poses/`` (4x4, T_target_sensor) if there are any.

    Raises:
        RecordingError: no depth images, no usable intrinsics, or frames without a partner.
    """
    files, shape = _depth_files(folder)
    camera = given_camera(given, shape)
    if camera is None:
        path = _matrix_file(folder)
        if path is None:
            raise RecordingError(f'no Intrinsic.txt (3 x 3 camera matrix) in {folder}: {ASK}')
        camera = make_camera(read_matrix(path, (3, 3), (4, 4))[:3, :3], shape, str(path))
    return _with_partners('depth images', folder, files, camera, given.depth_scale or MILLIMETRE)


def read_open3d(folder: Path, path: Path, given: Given) -> Recording:
    """What Open3D's recorder writes: ``depth/``, ``color/`` and a JSON file of the camera.

    Raises:
        RecordingError: as :func:`read_plain`, or the file is no such JSON.
    """
    whole = _json(path)
    told = whole.get('intrinsic', whole)
    matrix = told.get('intrinsic_matrix')
    if not isinstance(matrix, list) or np.size(matrix) != 9:
        raise RecordingError(f'{path} has no intrinsic_matrix of nine numbers: {ASK}')
    K = np.asarray(matrix, np.float64).reshape(3, 3)
    K = K.T if K[0, 2] == 0 == K[1, 2] else K  # Open3D writes it column by column
    files, shape = _depth_files(folder)
    size = int(told.get('width', shape[1])), int(told.get('height', shape[0]))
    if size != (shape[1], shape[0]):
        raise RecordingError(
            f'{path} is of {size[0]} x {size[1]} pixels, the depth of {shape[1]} x {shape[0]}: {ASK}'
        )
    per_metre = float(whole.get('depth_scale', 1 / MILLIMETRE))
    if not 0 < per_metre < np.inf:
        raise RecordingError(f'{path} has a depth_scale of {per_metre}: give --depth-scale')
    camera = given_camera(given, shape) or make_camera(K, shape, str(path))
    return _with_partners("Open3D's recorder", folder, files, camera, given.depth_scale or 1 / per_metre)


def read_tum(folder: Path, given: Given) -> Recording:
    """A TUM RGB-D sequence: ``depth.txt``, ``rgb.txt`` and ``groundtruth.txt``, 5000 units a metre.

    Its poses are of the camera in the room, which is the target that stands still.

    Raises:
        RecordingError: files are missing, or nothing tells the intrinsics.
    """
    stamps, depth = _tum_files(folder / 'depth.txt')
    shape = read_depth_image(depth[0], 1.0).shape
    camera = given_camera(given, shape)
    if camera is None:
        path = _matrix_file(folder)
        if path is None:
            raise RecordingError(f'{folder} has depth.txt but no intrinsics: {ASK}; {TUM_HINT}')
        camera = make_camera(read_matrix(path, (3, 3)), shape, str(path))
    colour: list[Path | None] = []
    if (folder / 'rgb.txt').is_file():
        times, images = _tum_files(folder / 'rgb.txt')
        colour = [None if k is None else images[k] for k in nearest(stamps, times)]
    poses = _tum_poses(folder / 'groundtruth.txt', stamps)
    unit = given.depth_scale or TUM_UNIT
    chosen = camera
    return _Images(
        'TUM RGB-D',
        depth,
        lambda _k: chosen,
        lambda _k: unit,
        colour,
        stamps_ns=stamps,
        poses=poses,
    ).recording()


def read_bop(folder: Path, given: Given) -> Recording:
    """A scene of a BOP data set: ``scene_camera.json``, ``depth/``, ``rgb/``, ``mask_visib/``.

    The masks and poses (``scene_gt.json``) of one object are used; which one has to be said where there are
    several.

    Raises:
        RecordingError: files are missing, or several objects are there and none is named.
    """
    cameras = _json(folder / 'scene_camera.json')
    files, shape = _depth_files(folder)
    if missing := [k for k in files.keys if str(k) not in cameras]:
        raise RecordingError(f'{folder / "scene_camera.json"} has no camera of image {missing[0]}')
    told = [cameras[str(k)] for k in files.keys]
    try:
        Ks = [np.asarray(t['cam_K'], np.float64).reshape(3, 3) for t in told]
        units = [given.depth_scale or MILLIMETRE * float(t.get('depth_scale', 1)) for t in told]
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f'{folder / "scene_camera.json"}: no cam_K of nine numbers: {error}') from None
    given_one = given_camera(given, shape)
    made = [given_one or make_camera(K, shape, 'scene_camera.json') for K in Ks]
    masks, poses = _bop_target(folder, files, given)
    home = next((folder / name for name in (*COLOUR_FOLDERS, 'gray') if (folder / name).is_dir()), None)
    colour: list[Path | None] = []
    if home is not None:
        colour = paired(files, ordered(home, *COLOUR_FILES), 'colour image', home)
    return _Images(
        'BOP', files.paths, lambda k: made[k], lambda k: units[k], colour, masks, poses=poses
    ).recording()


def _with_partners(layout: str, folder: Path, files: Files, camera: Camera, unit: float) -> Recording:
    partners = []
    for names, endings, what in (
        (COLOUR_FOLDERS, COLOUR_FILES, 'colour image'),
        (MASK_FOLDERS, ('.png',), 'mask'),
        (POSE_FOLDERS, ('.txt',), 'pose'),
    ):
        home = next((folder / name for name in names if (folder / name).is_dir()), None)
        partners.append(paired(files, ordered(home, *endings), what, home) if home is not None else [])
    colour, masks, pose_files = partners
    return _Images(
        layout,
        files.paths,
        lambda _k: camera,
        lambda _k: unit,
        colour,
        masks,
        files.keys if files.timed else [],
        [None if path is None else read_pose(path) for path in pose_files],
    ).recording()


def _depth_files(folder: Path) -> tuple[Files, tuple[int, ...]]:
    """The depth images, and the size (h, w) of the first."""
    home = folder / 'depth' if (folder / 'depth').is_dir() else folder
    files = ordered(home, *IMAGES)
    if not len(files):
        raise RecordingError(f'no depth images (*.png) in {home}')
    return files, read_depth_image(files.paths[0], 1.0).shape


def _matrix_file(folder: Path) -> Path | None:
    """A text file of the camera matrix."""
    named = (p for p in sorted(folder.iterdir()) if re.fullmatch(r'(?i)intrinsics?\.txt', p.name))
    return next(named, None)


def _json(path: Path) -> dict[str, Any]:
    try:
        told = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise RecordingError(f'cannot read {path}: {error}') from None
    if not isinstance(told, dict):
        raise RecordingError(f'{path} holds no JSON object')
    return told


def _tum_files(path: Path) -> tuple[list[int], list[Path]]:
    """Stamps, ns, and files of a list of TUM's."""
    rows = _tum_rows(path)
    if not rows:
        raise RecordingError(f'{path} names no files')
    files = [path.parent / row[1] for row in rows]
    if (lost := next((f for f in files if not f.is_file()), None)) is not None:
        raise RecordingError(f'{path} names {lost.relative_to(path.parent)}, which is not there')
    return [_ns(row[0], path) for row in rows], files


def _tum_rows(path: Path) -> list[list[str]]:
    try:
        lines = path.read_text().splitlines()
    except OSError as error:
        raise RecordingError(f'cannot read {path}: {error.strerror}') from None
    rows = [line.replace(',', ' ').split() for line in lines if line.strip() and not line.startswith('#')]
    if any(len(row) < 2 for row in rows):
        raise RecordingError(f'{path} has a line that is not a time and what was then')
    return sorted(rows, key=lambda row: _ns(row[0], path))


def _ns(text: str, path: Path) -> int:
    try:
        return int(Decimal(text) * 10**9)
    except (InvalidOperation, ValueError, OverflowError):
        raise RecordingError(f'{path}: {text[:40]!r} is no time in seconds') from None


def _tum_poses(path: Path, stamps: list[int]) -> list[Array | None]:
    """T_room_camera at the stamps, None outside the file's times; empty without a file."""
    if not path.is_file():
        return []
    rows = _tum_rows(path)
    try:
        values = np.array([[float(x) for x in row[1:8]] for row in rows])
        if values.shape[1] != 7 or not np.isfinite(values).all() or len(rows) < 2:
            raise ValueError
        times = np.array([_ns(row[0], path) for row in rows])
        keep = np.flatnonzero(np.diff(times, prepend=times[0] - 1) > 0)
        turns = scipy.spatial.transform.Slerp(
            (times[keep] - times[0]) * 1e-9, scipy.spatial.transform.Rotation.from_quat(values[keep, 3:])
        )
    except (ValueError, IndexError):
        raise RecordingError(f'{path} does not hold lines of t tx ty tz qx qy qz qw') from None
    poses: list[Array | None] = []
    for stamp in stamps:
        if not times[0] <= stamp <= times[-1]:
            poses.append(None)
            continue
        at = [np.interp(float(stamp - times[0]), times[keep] - times[0], values[keep, k]) for k in range(3)]
        poses.append(transform(turns((stamp - times[0]) * 1e-9).as_matrix(), np.array(at)))
    return poses


def _bop_target(folder: Path, files: Files, given: Given) -> tuple[list[Path | None], list[Array | None]]:
    """Masks and poses of the one object that is looked at."""
    path = folder / 'scene_gt.json'
    if not path.is_file():
        return [], []
    truth = _json(path)
    entries = [truth.get(str(k), []) for k in files.keys]
    known = sorted({str(e.get('obj_id')) for found in entries for e in found})
    wanted = given.target or (known[0] if len(known) == 1 else '')
    if wanted not in known:
        raise RecordingError(
            f'{folder} shows {len(known)} objects ({", ".join(known[:20])}): choose one by --target'
        )
    masks: list[Path | None] = []
    poses: list[Array | None] = []
    home = next((folder / name for name in ('mask_visib', 'mask') if (folder / name).is_dir()), None)
    for path_of_depth, found in zip(files.paths, entries, strict=True):
        index = [n for n, e in enumerate(found) if str(e.get('obj_id')) == wanted]
        if len(index) > 1:
            raise RecordingError(f'object {wanted} is {len(index)} times in {path_of_depth.name}')
        mask = home / f'{path_of_depth.stem}_{index[0]:06d}.png' if home is not None and index else None
        masks.append(mask if mask is not None and mask.is_file() else None)
        poses.append(_bop_pose(found[index[0]], path) if index else None)
    return (masks if any(m is not None for m in masks) else []), poses


def _bop_pose(entry: dict[str, Any], path: Path) -> Array:
    try:
        R = np.asarray(entry['cam_R_m2c'], np.float64).reshape(3, 3)
        t = np.asarray(entry['cam_t_m2c'], np.float64).reshape(3, 1) * MILLIMETRE
    except (KeyError, ValueError, TypeError):
        raise RecordingError(f'{path} has an object without cam_R_m2c and cam_t_m2c') from None
    return inverse(rigid(np.hstack([R, t]), str(path)))
