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

"""A video as k4arecorder writes it: colour, depth of 16 bit in Microsoft's way, the calibration attached."""

import json
import shutil
import struct
import subprocess

import numpy as np
import pytest

from debris_scanner.io.recordings.layouts import open_recording
from debris_scanner.io.recordings.recording import Given, RecordingError

pytestmark = pytest.mark.skipif(shutil.which('ffmpeg') is None, reason='no ffmpeg here')
WIDTH, HEIGHT, FRAMES = 320, 288, 4
PARAMETERS = (0.51, 0.52, 0.49, 0.48)  # cx, cy, fx, fy, shares of the sensor's size of 512
INTRINSICS = (0.49 * 512, 0.48 * 512, 0.51 * 512 - 0.5 - 96, 0.52 * 512 - 0.5 - 90)


def depth(k):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return (500 + 40 * k + u // 4 + v // 8).astype('<u2')


def calibration(lens):
    depth_camera = {
        'Intrinsics': {'ModelParameters': [*PARAMETERS, *lens, *[0.0] * (10 - len(lens))]},
        'Location': 'CALIBRATION_CameraLocationD0',
    }
    colour_camera = {'Intrinsics': {}, 'Location': 'CALIBRATION_CameraLocationPV0'}
    return {'CalibrationInformation': {'Cameras': [depth_camera, colour_camera]}}


def video(folder, lens=(), title='DEPTH', attached=True):
    """Written by ffmpeg; it marks depth as colours of 16 bit, the recorder as ``b16g``."""
    (folder / 'raw').write_bytes(b''.join(depth(k).tobytes() for k in range(FRAMES)))
    (folder / 'calibration.json').write_text(json.dumps(calibration(lens)))
    path = folder / 'video.mkv'
    inputs = ['-f', 'lavfi', '-i', f'color=red:s=64x48:r=5:d={FRAMES / 5}', '-f', 'rawvideo']
    inputs += ['-pix_fmt', 'gray16le', '-s', f'{WIDTH}x{HEIGHT}', '-r', '5', '-i', str(folder / 'raw')]
    tracks = ['-map', '0', '-map', '1', '-c:v:0', 'mjpeg', '-c:v:1', 'rawvideo', '-allow_raw_vfw', '1']
    tracks += ['-pix_fmt:v:1', 'gray16be', '-metadata:s:v:1', f'title={title}']
    attachment = [
        '-attach',
        str(folder / 'calibration.json'),
        '-metadata:s:t',
        'mimetype=application/octet-stream',
    ]
    command = ['ffmpeg', '-v', 'error', *inputs, *tracks, *(attachment if attached else []), str(path)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    data = path.read_bytes()
    header = struct.pack('<IiiHHI', 40, WIDTH, -HEIGHT, 1, 16, 0)
    theirs = struct.pack('<IiiHH4s', 40, WIDTH, HEIGHT, 1, 16, b'b16g')
    assert data.count(header) == 1
    path.write_bytes(data.replace(header, theirs))
    return path


def test_depth_comes_in_any_order_with_its_stamps_and_camera(tmp_path):
    recording = open_recording(video(tmp_path), Given())
    assert recording.count == FRAMES
    np.testing.assert_allclose(np.diff(recording.stamps_ns), 2e8, atol=1e6)
    for k in (0, 1, 3, 2, 0):
        frame = recording.read(k, 7)
        np.testing.assert_allclose(frame.depth, depth(k) * 1e-3, atol=1e-6)
    c = frame.camera
    assert (c.fx, c.fy, c.cx, c.cy) == pytest.approx(INTRINSICS)
    assert recording.unit == 0.001


def test_its_lens_is_undone(tmp_path):
    recording = open_recording(video(tmp_path, (0.4, -0.2, 0.05, 0.3, -0.1, 0.02)), Given())
    frame = recording.read(1, 7)
    assert frame.depth.shape == (frame.camera.height, frame.camera.width)
    assert frame.camera.fx == pytest.approx(INTRINSICS[0])
    assert recording.unit != 0.001  # resampled depth is no whole number of millimetres
    centre = frame.depth[round(frame.camera.cy), round(frame.camera.cx)]
    true = depth(1)[round(INTRINSICS[3]), round(INTRINSICS[2])] * 1e-3
    assert centre == pytest.approx(true, abs=0.003)


def test_intrinsics_that_are_given_take_the_place_of_a_calibration(tmp_path):
    path = video(tmp_path, attached=False)
    with pytest.raises(RecordingError, match=r'no calibration: give --intrinsics FX,FY,CX,CY'):
        open_recording(path, Given())
    frame = open_recording(path, Given(intrinsics=(250.0, 251.0, 160.0, 144.0), depth_scale=0.002)).read(0, 1)
    assert frame.camera.fy == 251
    np.testing.assert_allclose(frame.depth, depth(0) * 2e-3, atol=1e-6)


def test_a_video_without_depth_is_named_with_its_tracks(tmp_path):
    with pytest.raises(RecordingError, match=r'no track of depth; its tracks: 0: mjpeg, 1: rawvideo'):
        open_recording(video(tmp_path, title='IR'), Given())


def test_what_is_no_video_is_refused_in_one_line(tmp_path):
    (tmp_path / 'a.mkv').write_text('no video')
    with pytest.raises(RecordingError, match='cannot be read') as refusal:
        open_recording(tmp_path / 'a.mkv', Given())
    assert '\n' not in str(refusal.value)


def test_without_ffmpeg_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / 'a.mkv').write_text('')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(RecordingError, match='needs ffmpeg: apt-get install ffmpeg'):
        open_recording(tmp_path / 'a.mkv', Given())
