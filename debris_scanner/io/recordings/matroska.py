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

"""Videos of an Azure Kinect or Femto (.mkv): depth by ffmpeg, the camera by the calibration in the file."""

import json
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.io.recordings.recording import (
    MILLIMETRE,
    Given,
    Recording,
    RecordingError,
    given_camera,
)
from debris_scanner.sensing.rectification import Distortion, Rectifier

# Size of a depth mode's images: the size that the calibration is of, and where the images begin in it.
_MODES = {
    (640, 576): (1024, 192, 180),  # narrow
    (320, 288): (512, 96, 90),  # narrow, binned
    (1024, 1024): (1024, 0, 0),  # wide
    (512, 512): (512, 0, 0),  # wide, binned
}
# Order of its model's parameters: cx, cy, fx, fy, k1..k6, codx, cody, p2, p1.
_PARAMETERS = 14


def read_video(path: Path, given: Given) -> Recording:
    """The depth of a video, its lens undone.

    Raises:
        RecordingError: no ffmpeg, no track of depth, or no calibration.
    """
    if shutil.which('ffmpeg') is None or shutil.which('ffprobe') is None:
        raise RecordingError(f'{path} needs ffmpeg: apt-get install ffmpeg')
    track, width, height = _depth_track(path)
    stamps = _stamps(path, track)
    camera, lens = _camera(path, given, width, height)
    rectifier = None if lens is None else Rectifier(camera, lens)
    unit = given.depth_scale or MILLIMETRE
    frames = _Frames(path, track, (height, width))

    def read(index: int, stamp_ns: int) -> DepthFrame:
        depth = frames.read(index) * np.float32(unit)
        if rectifier is None:
            return DepthFrame(stamp_ns, depth, camera)
        return DepthFrame(stamp_ns, rectifier.depth(depth), rectifier.camera)

    remarks = ['colour of a video is not used: it is of another camera']
    # resampled depth is no whole number of millimetres any more
    written = unit if rectifier is None else 0.0
    return Recording('Azure Kinect video', len(stamps), read, stamps, unit=written, remarks=remarks)


class _Frames:
    """Frames of a track, read one after another; going back starts anew."""

    def __init__(self, path: Path, track: int, shape: tuple[int, int]) -> None:
        self._path, self._track, self._shape = path, track, shape
        self._process: subprocess.Popen[bytes] | None = None
        self._next = 0
        self._last: NDArray[np.float32] | None = None

    def read(self, index: int) -> NDArray[np.float32]:
        """A frame (h, w) in the file's unit.

        Raises:
            RecordingError: the video ends before.
        """
        if self._process is None or index < self._next - 1:
            self._start()
        while self._last is None or self._next <= index:
            self._last = self._read_next()
        return self._last

    def _start(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        command = ['ffmpeg', '-v', 'error', '-i', str(self._path), '-map', f'0:{self._track}']
        command += ['-f', 'rawvideo', '-pix_fmt', 'gray16le', '-']
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        self._next, self._last = 0, None

    def _read_next(self) -> NDArray[np.float32]:
        assert self._process is not None
        assert self._process.stdout is not None
        count = self._shape[0] * self._shape[1] * 2
        data = self._process.stdout.read(count)
        if len(data) < count:
            raise RecordingError(f'{self._path} ends after {self._next} frames of depth')
        self._next += 1
        return np.frombuffer(data, '<u2').reshape(self._shape).astype(np.float32)


def _depth_track(path: Path) -> tuple[int, int, int]:
    """Index, width and height of the track of depth."""
    streams = _probe(path, '-show_streams').get('streams', [])
    for stream in streams:
        tags = {k.lower(): str(v).upper() for k, v in stream.get('tags', {}).items()}
        name = tags.get('title', '') + tags.get('k4a_depth_mode', '')
        if stream.get('codec_type') == 'video' and ('DEPTH' in name or 'k4a_depth_mode' in tags):
            return int(stream['index']), int(stream['width']), int(stream['height'])
    listed = ', '.join(f'{s.get("index")}: {s.get("codec_name")}' for s in streams)
    raise RecordingError(f'{path} has no track of depth; its tracks: {listed or "none"}')


def _stamps(path: Path, track: int) -> list[int]:
    """Time of each frame, ns."""
    packets = _probe(path, '-select_streams', str(track), '-show_entries', 'packet=pts_time').get(
        'packets', []
    )
    times = [round(float(p['pts_time']) * 1e9) for p in packets if 'pts_time' in p]
    if not times:
        raise RecordingError(f'{path} has no frames of depth')
    return sorted(times)


def _camera(path: Path, given: Given, width: int, height: int) -> tuple[Camera, Distortion | None]:
    """Camera and lens of the depth images, by the user or by the calibration that is attached."""
    own = given_camera(given, (height, width))
    if own is not None:
        return own, None
    mode = _MODES.get((width, height))
    told = _calibration(path)
    if told is None or mode is None:
        why = 'no calibration' if told is None else f'an unknown depth mode of {width} x {height}'
        raise RecordingError(f'{path} has {why}: give --intrinsics FX,FY,CX,CY')
    size, left, top = mode
    try:
        cameras = told['CalibrationInformation']['Cameras']
        depth = next(c for c in cameras if str(c['Location']).endswith('D0'))
        p = [float(x) for x in depth['Intrinsics']['ModelParameters'][:_PARAMETERS]]
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = p
    except (KeyError, TypeError, ValueError, StopIteration):
        raise RecordingError(f'{path}: its calibration has no model of the depth camera') from None
    camera = Camera(fx * size, fy * size, cx * size - 0.5 - left, cy * size - 0.5 - top, width, height)
    return camera, Distortion.of('rational_polynomial', (k1, k2, p1, p2, k3, k4, k5, k6))


def _calibration(path: Path) -> dict[str, Any] | None:
    """The calibration that the recorder attached; None without one."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'calibration.json'
        subprocess.run(
            ['ffmpeg', '-v', 'quiet', '-y', '-dump_attachment:t:0', str(file), '-i', str(path)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,  # it writes the attachment, and then misses an output
        )
        try:
            told = json.loads(file.read_bytes().rstrip(b'\0'))
        except (OSError, ValueError):
            return None
    return told if isinstance(told, dict) else None


def _probe(path: Path, *what: str) -> dict[str, Any]:
    done = subprocess.run(
        ['ffprobe', '-v', 'error', '-of', 'json', *what, str(path)],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    if done.returncode:
        raise RecordingError(f'{path} cannot be read: {" ".join(done.stderr.split())[:200]}')
    told = json.loads(done.stdout or '{}')
    return told if isinstance(told, dict) else {}
