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

"""Small bags of every storage, damaged: they give frames, or one line that says why there are none."""

import tempfile
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
from message_cases import CAMERA, S
from mutations import damaged
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from sessions import clouds, images, mcap_bytes, ros1_active_bytes, write_rosbag1, write_rosbag2

from debris_scanner.core.frames import DepthFrame
from msg_adapters.bags import BagError, open_session
from msg_adapters.errors import MalformedMessage

Files = dict[str, bytes]  # by name, of a bag


@cache
def bags() -> dict[str, Files]:
    """Whole bags of three frames each."""
    depth = np.full((48, 64), 0.6, np.float32)
    colour = np.zeros((48, 64, 3), np.uint8)
    three = [DepthFrame(S + i * 10**8, depth, CAMERA, colour) for i in range(3)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = {
            f'{storage.name}_{compression.name}': contents(
                write_rosbag2(
                    folder / f'{storage.name}{compression.name}', images(three), storage, compression
                )
            )
            for storage in (StoragePlugin.MCAP, StoragePlugin.SQLITE3)
            for compression in (CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE)
        }
        made['MCAP_CHUNKS'] = contents(
            write_rosbag2(folder / 'chunks', images(three), compression=CompressionMode.STORAGE)
        )
        for kind in (None, *Writer1.CompressionFormat):
            path = write_rosbag1(folder / f'{kind}.bag', images(three), kind)
            made[f'ROS1_{kind}'] = {'bag.bag': path.read_bytes()}
    for compression in ('', 'lz4', 'zstd'):
        made[f'mcap_{compression}'] = {'bag.mcap': mcap_bytes(clouds(three), compression, 2)}
    made['ROS1_ACTIVE'] = {'bag.bag.active': ros1_active_bytes(clouds(three), opened=1)}
    return made


def contents(folder: Path) -> Files:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def run_bag(random: Random) -> None:
    """One file of a bag damaged, or gone; a folder's files beside it or alone."""
    files = dict(random.choice(list(bags().values())))
    victim = random.choice(sorted(files))
    files[victim] = damaged(files[victim], random)
    if len(files) > 1 and random.random() < 0.2:
        del files[random.choice(sorted(files))]
    with tempfile.TemporaryDirectory(dir=memory()) as name:
        folder = Path(name) / 'bag'
        folder.mkdir()
        for file, content in files.items():
            (folder / file).write_bytes(content)
        whole = len(files) > 1 or random.random() < 0.2
        read(folder if whole else folder / next(iter(files)))


@cache
def memory() -> str | None:
    """A folder that costs no disk, where there is one."""
    return '/dev/shm' if Path('/dev/shm').is_dir() else None


def read(path: Path) -> None:
    try:
        with open_session(path) as session, np.errstate(all='ignore'):
            for stamp, frame in session:
                assert isinstance(stamp, int)
                assert isinstance(frame, DepthFrame | MalformedMessage)
            said = session.warnings
    except BagError as error:
        said = [str(error)]
    for line in said:
        assert '\n' not in line
        assert len(line) < 5000
