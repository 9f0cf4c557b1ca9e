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

"""Real recordings: what each is, what a person expects of it, and how its frames are read.

The product's own readers do that; what they do not know is turned into what they do: axes, and bits.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.geometry import (
    Array,
    apply,
    compose,
    from_quaternion,
    inverse,
    project_so3,
    transform,
)
from debris_scanner.core.open3d_library import load_open3d
from debris_scanner.core.results import (
    INCONSISTENT_MODEL,
    NO_CLOSURE,
    NO_TARGET,
    TOO_FEW_FRAMES,
    UNOBSERVABLE_ROTATION,
)
from debris_scanner.evaluation.truth_cloud import fuse_depth
from debris_scanner.io.recordings.depth_folders import read_plain
from debris_scanner.io.recordings.recording import MILLIMETRE, Given, read_depth_image
from debris_scanner.sim.session import FIRST_STAMP_NS
from msg_adapters.bags import open_session

RATE_HZ = 5.0  # as ``debris-scan import``: the recordings have no time

Posed = tuple[DepthFrame, Array | None]  # a frame with its true T_sensor_target (4, 4), where there is one
Reader = Callable[[Path], Iterator[Posed]]


def depth_folder(folder: Path, undecoded: bool = False) -> Iterator[Posed]:
    """A folder of depth images; ``undecoded``: those beside them, whose format is another."""
    source = read_plain(folder, Given())
    raw = sorted((folder / 'raw').glob('*.depth.png')) if undecoded else []
    for k in range(source.count):
        frame = source.read(k, _stamp(k))
        depth = read_depth_image(raw[k], MILLIMETRE) if undecoded else frame.depth
        pose = source.poses[k] if source.poses else None
        yield DepthFrame(frame.stamp_ns, depth, frame.camera), None if pose is None else inverse(pose)


def range_grids(folder: Path) -> Iterator[Posed]:
    """Grids of a laser, y up, which looks along -z from 0.7 m.

    The truth's translations are of a grid in the target's frame, its quaternions turn the other way.
    """
    T_grid_sensor = np.diag([1.0, -1.0, -1.0, 1.0])
    T_grid_sensor[2, 3] = 0.7
    with np.load(folder / 'range_grids.npz') as grids:
        names = sorted(name for name in grids.files if name.startswith('points_'))
        for k, (name, truth) in enumerate(zip(names, grids['truth_txyz_qxyzw'], strict=True)):
            points = grids[name].reshape(-1, 3) * np.array([1, -1, -1], np.float32) + np.array(
                [0, 0, 0.7], np.float32
            )
            T_target_grid = transform(from_quaternion(truth[3:]).T, truth[:3])
            frame = DepthFrame.from_cloud(_stamp(k), points[np.isfinite(points).all(axis=1)])
            yield frame, inverse(compose(T_target_grid, T_grid_sensor))


def kinect2_clouds(folder: Path) -> Iterator[Posed]:
    """Clouds that turn from the last left one to the last right one, y up and x left; poses of a board."""
    found = {}
    for path in folder.glob('[LR]_*.ply'):
        if (number := re.search(r'(\d+)$', path.stem)) is not None:
            found[int(number[1]) + 1 if path.name[0] == 'R' else -int(number[1])] = path
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    for k, (_, path) in enumerate(sorted(found.items())):
        cloud = load_open3d().io.read_point_cloud(str(path))
        words = path.with_name(f'{path.stem}_extrinsic.txt').read_text().split()
        T = turned @ np.array([float(w) for w in words]).reshape(4, 4)
        T[:3, :3] = project_so3(T[:3, :3])
        points = (np.asarray(cloud.points) @ turned[:3, :3]).astype(np.float32)
        yield DepthFrame.from_cloud(_stamp(k), points), T


def bag(path: Path) -> Iterator[Posed]:
    """What another program recorded."""
    with open_session(path) as session:
        for _, frame in session:
            if isinstance(frame, DepthFrame):
                yield frame, None


def all_points(frames: Iterable[tuple[DepthFrame, Array]]) -> NDArray[np.float32]:
    """Points (n, 3) of a laser's frames with their T_target_sensor: they are exact, and sparse."""
    clouds = [apply(T, frame.camera.back_project(frame.depth)[frame.depth > 0]) for frame, T in frames]
    return np.concatenate(clouds).astype(np.float32)


@dataclass(frozen=True)
class Real:
    """A real recording, and what a person who sees it expects."""

    name: str
    path: str  # in the folder of data
    read: Reader
    sensor: str
    expected: str
    may_be_modelled: bool = False
    reasons: tuple[str, ...] = ()  # for no model that are right
    surface: Callable[[Iterable[tuple[DepthFrame, Array]]], NDArray[np.float32]] = fuse_depth  # the true one
    says: str = ''  # words that the hint, or the line that refuses the input, must have


_FEW_OR_OPEN = (TOO_FEW_FRAMES, NO_CLOSURE)

REAL = {
    r.name: r
    for r in (
        Real('bunny', 'bunny_primesense', depth_folder, 'Carmine', 'a model', may_be_modelled=True),
        Real(
            'custard_box',
            'real/custard_box',
            depth_folder,
            'D415',
            'a model, or an honest refusal; half a turn looks alike',
            may_be_modelled=True,
            reasons=(NO_CLOSURE, INCONSISTENT_MODEL, UNOBSERVABLE_ROTATION),
        ),
        Real(
            'dragon_stand',
            'real/dragon_stand',
            range_grids,
            'laser',
            'a model',
            may_be_modelled=True,
            surface=all_points,
        ),
        *(
            Real(
                toy,
                f'real/kinect2_toys/{toy}',
                kinect2_clouds,
                'Kinect v2',
                'no full turn: 90°',
                reasons=(NO_CLOSURE,),
            )
            for toy in ('tiger', 'superman', 'berrybox')
        ),
        Real(
            'bear_turntable',
            'real/bear_turntable',
            depth_folder,
            'D435',
            'a refusal: 8 frames, 45° apart',
            reasons=_FEW_OR_OPEN,
        ),
        Real(
            'dog_sitting',
            'real/dog_sitting',
            depth_folder,
            'D435',
            'a refusal, but a target: 6 frames, 60° apart',
            reasons=_FEW_OR_OPEN,
        ),
        Real(
            'metal_dome',
            'real/metal_dome',
            depth_folder,
            'D4xx',
            'a refusal: a body of revolution, half of the frames twice',
            reasons=(UNOBSERVABLE_ROTATION, NO_CLOSURE, TOO_FEW_FRAMES),
        ),
        Real(
            'apc_box_shelf',
            'real/apc_box_shelf',
            depth_folder,
            'SR300',
            'a refusal: no full turn',
            reasons=_FEW_OR_OPEN,
        ),
        Real(
            'apc_undecoded',
            'real/apc_box_shelf',
            partial(depth_folder, undecoded=True),
            'SR300',
            'no scan, but a hint: 30 m by its units',
            reasons=(NO_TARGET,),
            says='m away',
        ),
        Real(
            'realsense_sdk',
            'real/bags/librealsense_sdk/single_depth_color_640x480.bag',
            bag,
            'D4xx',
            'two frames, or a line that says what is missing',
            reasons=(TOO_FEW_FRAMES,),
            says='its topics',
        ),
        Real(
            'embag',
            'real/bags/embag/test.bag',
            bag,
            'Luminar',
            'a refusal that names the frame',
            reasons=(NO_TARGET,),
            says='optical frame',
        ),
        Real('ros_numpy', 'real/bags/ros_numpy/test.bag', bag, '-', 'no target', reasons=(NO_TARGET,)),
    )
}


def _stamp(k: int) -> int:
    return FIRST_STAMP_NS + round(k * 1e9 / RATE_HZ)
