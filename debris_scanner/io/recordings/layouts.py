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

"""Which layout a folder or file has; see the table in docs/import.md."""

from pathlib import Path

from debris_scanner.io.recordings.cloud_sequences import SUFFIXES, read_cloud_folder, read_grids
from debris_scanner.io.recordings.depth_folders import read_bop, read_open3d, read_plain, read_tum
from debris_scanner.io.recordings.matroska import read_video
from debris_scanner.io.recordings.recording import IMAGES, Given, Recording, RecordingError

_OPEN3D = ('camera_intrinsic.json', 'intrinsic.json', 'intrinsics.json')
VIDEO = '.mkv'


def open_recording(path: Path, given: Given) -> Recording:
    """Find the frames of a folder or file; they are read one by one later.

    Raises:
        RecordingError: none of the known layouts, or something of it is missing; the line names it.
    """
    if not path.exists():
        raise RecordingError(f'{path} does not exist')
    if path.is_file():
        if path.suffix.lower() == VIDEO:
            return read_video(path, given)
        if path.suffix.lower() == '.npz':
            return read_grids(path, given)
        raise RecordingError(f'{path} is not a folder, nor a bag, .mkv or .npz file')
    if (path / 'scene_camera.json').is_file():
        return read_bop(path, given)
    if (path / 'depth.txt').is_file():
        return read_tum(path, given)
    for name in _OPEN3D:
        if (path / name).is_file():
            return read_open3d(path, path / name, given)
    files = [p for p in sorted(path.iterdir()) if p.is_file()]
    home = path / 'depth'
    if home.is_dir() or any(p.suffix.lower() in IMAGES for p in files):
        return read_plain(path, given)
    if any(p.suffix.lower() in SUFFIXES for p in files):
        return read_cloud_folder(path, given)
    grids = [p for p in files if p.suffix.lower() == '.npz']
    if len(grids) == 1:
        return read_grids(grids[0], given)
    scenes = [p.name for p in sorted(path.iterdir()) if (p / 'scene_camera.json').is_file()]
    if scenes:
        raise RecordingError(
            f'{path} holds {len(scenes)} scenes of BOP: name one, such as {path / scenes[0]}'
        )
    raise RecordingError(f'no depth images (*.png), clouds (*.pcd, *.ply) or grids (*.npz) in {path}')
