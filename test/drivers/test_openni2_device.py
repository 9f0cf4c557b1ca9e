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

"""OpenNI2 itself: its dummy device, recordings played by it, and what is not there."""

import numpy as np
import pytest
from devices import HASTY, Watcher, need_library
from recordings import PIXEL_100_UM, write_oni

from debris_scanner.drivers.captures import COLOUR, DEPTH
from debris_scanner.drivers.faults import Fault

FOV = (1.0226, 0.7966)


@pytest.fixture(autouse=True)
def library():
    need_library('openni2')


def images(count=4, width=64, height=48):
    base = np.arange(width * height, dtype=np.uint16).reshape(height, width) % 97 + 600
    return [base + k for k in range(count)]


def play(path, **settings):
    """A recording played to its end."""
    with Watcher('openni2', device=str(path), **settings) as device:
        assert device.ended.wait(40), device.faults
    assert device.faults == []
    return device


def test_dummy_device_streams_millimetres_no_faster_than_asked():
    with Watcher('openni2', device='Dummy', fx=285.0, max_rate_hz=10.0) as device:
        device.until(lambda: len(device.stream(DEPTH)) >= 20, 'images')
    info, depth = device.opened[0], device.stream(DEPTH)
    assert not info.recording
    assert 'Dummy' in info.name
    assert (info.camera.width, info.camera.height, info.camera.cx, info.camera.cy) == (320, 240, 160, 120)
    assert depth[0].pixels.shape == (240, 320)
    assert depth[0].pixels.dtype == np.uint16
    assert set(np.unique(depth[0].pixels[0])) == {2000}  # the dummy's first row
    arrivals = np.array([c.arrival_ns for c in depth])
    assert (len(depth) - 1) / (np.ptp(arrivals) * 1e-9) == pytest.approx(10, abs=1)
    colour = device.stream(COLOUR)
    assert colour[0].pixels.shape == (240, 320, 3)
    assert abs(len(colour) - len(depth)) <= 1


def test_dummy_device_tells_no_field_of_view():
    with Watcher('openni2', HASTY, device='Dummy') as device:
        device.until(lambda: device.faults, 'the fault')
    assert device.faults[0].fault == Fault.INTRINSICS
    assert 'give fx' in str(device.faults[0])


def test_recording_is_what_was_recorded(tmp_path):
    frames = images()
    device = play(write_oni(tmp_path / 'a.oni', frames, 10, FOV))
    info = device.opened[0]
    assert info.recording
    assert info.intrinsics == "the device's field of view"
    assert info.camera.fx == pytest.approx(32 / np.tan(FOV[0] / 2), rel=1e-5)
    depth = device.stream(DEPTH)
    assert [c.device_ns for c in depth] == [k * 10**8 for k in range(4)]
    for got, sent in zip(depth, frames, strict=True):
        assert np.array_equal(got.pixels, sent)


def test_tenths_of_millimetres_become_metres(tmp_path):
    device = play(write_oni(tmp_path / 'a.oni', images(), 10, FOV, PIXEL_100_UM))
    pixels = device.stream(DEPTH)[0].pixels
    assert pixels.dtype == np.float32
    assert np.allclose(pixels, images()[0] * 1e-4, rtol=1e-6)


def test_mirrored_recording_is_turned_round(tmp_path):
    device = play(write_oni(tmp_path / 'a.oni', images(), 10, FOV, mirror=1))
    assert np.array_equal(device.stream(DEPTH)[0].pixels, images()[0][:, ::-1])


def test_cropped_recording_keeps_its_place(tmp_path):
    path = write_oni(tmp_path / 'a.oni', images(), 10, FOV, cropping=(16, 8, 160, 120))
    device = play(path)
    pixels = device.stream(DEPTH)[0].pixels
    assert pixels.shape == (120, 160)
    assert np.array_equal(pixels[8:56, 16:80], images()[0])
    assert pixels.astype(int).sum() == images()[0].astype(int).sum()
    assert device.opened[0].camera.cx == 80


def test_recording_that_repeats(tmp_path):
    path = write_oni(tmp_path / 'a.oni', images(), 10, FOV)
    with Watcher('openni2', device=str(path), repeat=True) as device:
        device.until(lambda: len(device.stream(DEPTH)) >= 10, 'the third time round')
    assert not device.ended.is_set()


@pytest.mark.parametrize(
    ('device', 'settings', 'fault', 'said'),
    [
        ('', {}, None, 'plugged in'),
        ('Nobody', {}, Fault.DEVICE, 'Nobody'),
        ('{tmp}/missing.oni', {}, Fault.RECORDING, 'does not exist'),
        ('{tmp}/text.oni', {}, Fault.RECORDING, 'text.oni'),
        ('Dummy', {'width': 111, 'height': 99}, Fault.MODE, 'there are 320x240'),
        ('Dummy', {'registered': True}, Fault.MODE, 'register'),
        ('Dummy', {'library': '{tmp}/none.so'}, Fault.LIBRARY, 'apt-get install libopenni2-0'),
    ],
)
def test_what_cannot_be_opened_is_said(tmp_path, device, settings, fault, said):
    (tmp_path / 'text.oni').write_text('no recording')
    given = {k: v.format(tmp=tmp_path) if isinstance(v, str) else v for k, v in settings.items()}
    with Watcher('openni2', HASTY, device=device.format(tmp=tmp_path), **given) as watcher:
        watcher.until(lambda: watcher.faults, 'the fault')
    assert said in str(watcher.faults[0])
    assert watcher.faults[0].fault in ({Fault.DEVICE, Fault.PERMISSION} if fault is None else {fault})
