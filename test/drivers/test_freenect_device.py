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

"""A Kinect: libfreenect itself, its replay of a recorded one, and a stub for what needs hardware.

Recordings that fakenect would abort on are found first.
"""

import numpy as np
import pytest
from devices import HASTY, Watcher, build_stub, need_fakenect, need_library
from recordings import raw_disparity, write_fakenect

from debris_scanner.drivers.captures import COLOUR, DEPTH
from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.drivers.freenect_device import check_recording
from debris_scanner.drivers.kinect_depth import ZeroPlane


@pytest.fixture
def folder(tmp_path):
    depth = np.full((480, 640), 800, np.uint16)
    return write_fakenect(tmp_path / 'kinect', [depth] * 3, 10, [np.zeros((480, 640, 3))])


def test_good_recording(folder):
    assert check_recording(folder) == 3


def test_accelerometer_is_let_pass(folder):
    (folder / 'a-1000.5-7.dump').write_bytes(b'12345678')
    index = folder / 'INDEX.txt'
    index.write_text(index.read_text() + 'a-1000.5-7.dump\n')
    assert check_recording(folder) == 3


def first(folder):
    return folder / (folder / 'INDEX.txt').read_text().splitlines()[0]


@pytest.mark.parametrize(
    ('spoil', 'said'),
    [
        (lambda f: (f / 'INDEX.txt').unlink(), 'No such file'),
        (lambda f: (f / 'INDEX.txt').write_text(''), 'empty or cut off'),
        (lambda f: (f / 'INDEX.txt').write_text(first(f).name), 'empty or cut off'),
        (lambda f: (f / 'INDEX.txt').write_text(f'{first(f).name}\n\n{first(f).name}\n'), 'empty line'),
        (lambda f: (f / 'INDEX.txt').write_text('../INDEX.txt\n'), 'not in its folder'),
        (lambda f: (f / 'INDEX.txt').write_text('r-1000.000000-1.ppm\n'), 'No such file'),
        (lambda f: first(f).unlink(), 'No such file'),
        (lambda f: first(f).write_bytes(first(f).read_bytes()[:-1]), 'not an image'),
        (lambda f: first(f).write_bytes(b'no header'), 'not an image'),
    ],
)
def test_spoiled_recording(folder, spoil, said):
    spoil(folder)
    with pytest.raises(DriverError, match=said) as caught:
        check_recording(folder)
    assert caught.value.fault == Fault.RECORDING


def ramp(k):
    """A slanted plane, with a hole."""
    depth = np.broadcast_to(np.arange(640) + 500 + k, (480, 640)).astype(np.uint16)
    depth = depth.copy()
    depth[:100] = 0
    return depth


@pytest.fixture
def kinect(tmp_path, monkeypatch):
    """A Kinect that does as told; ``say`` tells it."""
    library = build_stub(tmp_path)
    state = tmp_path / 'state'
    monkeypatch.setenv('STUB_FREENECT', str(state))

    class Kinect:
        def say(self, word):
            part = tmp_path / 'part'
            part.write_text(word)
            part.replace(state)

        def watch(self, **settings):
            return Watcher('freenect', HASTY, library=str(library), max_rate_hz=60.0, **settings)

    made = Kinect()
    made.say('there')
    return made


def test_replayed_recording_is_what_was_recorded(tmp_path):
    need_fakenect()
    frames = [ramp(k) for k in range(6)]
    colour = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    folder = write_fakenect(tmp_path / 'kinect', frames, 10, [colour] * 6)
    with Watcher('freenect', device=str(folder)) as device:
        assert device.ended.wait(30)
    assert device.faults == []
    info = device.opened[0]
    assert info.recording
    assert info.camera == ZeroPlane().camera
    assert info.intrinsics == 'the zero plane of a typical Kinect'
    depth = device.stream(DEPTH)
    table = ZeroPlane().table_mm()
    for got, sent in zip(depth, frames, strict=True):
        assert got.pixels.dtype == np.uint16
        assert np.array_equal(got.pixels, table[raw_disparity(sent)])
        assert np.all((got.pixels == 0) == (sent == 0))
    assert np.allclose(np.diff([c.device_ns for c in depth]), 1e8, atol=20)  # through a wrap of the ticks
    assert np.array_equal(device.stream(COLOUR)[0].pixels, colour)


def test_replay_refuses_registered_depth_in_words(tmp_path):
    need_fakenect()
    folder = write_fakenect(tmp_path / 'kinect', [ramp(0)], 10)
    with Watcher('freenect', HASTY, device=str(folder), registered=True) as device:
        device.until(lambda: device.faults, 'the refusal')
    assert device.faults[0].fault in (Fault.MODE, Fault.CRASHED)
    assert device.opened == []


def test_no_kinect_and_no_library(tmp_path):
    need_library('freenect')
    with Watcher('freenect', HASTY) as device:
        device.until(lambda: len(device.faults) == 2, 'a second try')
    assert {f.fault for f in device.faults} <= {Fault.DEVICE, Fault.PERMISSION}
    with Watcher('freenect', HASTY, library=str(tmp_path / 'none.so')) as device:
        device.until(lambda: device.faults, 'the fault')
    assert device.faults[0].fault == Fault.LIBRARY
    assert 'apt-get install libfreenect0.5' in str(device.faults[0])


def test_depth_and_intrinsics_follow_the_zero_plane_that_the_device_tells(kinect):
    with kinect.watch() as device:
        device.until(lambda: device.stream(DEPTH) and device.stream(COLOUR), 'images')
    plane = ZeroPlane(7.5, np.float32(118.0), float(np.float32(0.1)), 200.0)
    info = device.opened[0]
    assert info.intrinsics == "the device's zero plane"
    assert info.camera.fx == pytest.approx(590.0, abs=0.01)
    depth = device.stream(DEPTH)[0].pixels
    assert np.all(depth[:, :320] == plane.table_mm()[600])
    assert np.all(depth[:, 320:] == 0)
    assert np.all(device.stream(COLOUR)[0].pixels == 77)


def test_registered_depth_comes_in_millimetres_seen_by_the_colour_camera(kinect):
    with kinect.watch(registered=True) as device:
        device.until(lambda: device.stream(DEPTH), 'images')
    info = device.opened[0]
    assert info.registered
    assert info.camera == info.colour_camera
    assert info.camera.fx == 525
    assert np.unique(device.stream(DEPTH)[0].pixels).tolist() == [0, 700]


def test_unplugged_while_streaming_and_plugged_in_again(kinect):
    with kinect.watch() as device:
        device.until(lambda: device.stream(DEPTH), 'images')
        kinect.say('gone')
        device.until(lambda: device.faults, 'the loss')
        kinect.say('none')
        device.until(lambda: any(f.fault == Fault.DEVICE for f in device.faults), 'no device')
        kinect.say('there')
        seen = len(device.captures)
        device.until(lambda: len(device.captures) > seen + 3, 'images again')
    assert device.faults[0].fault == Fault.LOST
    assert 'unplugged' in str(device.faults[0])


@pytest.mark.parametrize(
    ('word', 'fault'), [('hangs', Fault.SILENT), ('crashes', Fault.CRASHED), ('mute', Fault.SILENT)]
)
def test_a_library_that_hangs_or_crashes_is_started_anew(kinect, word, fault):
    with kinect.watch() as device:
        device.until(lambda: device.stream(DEPTH), 'images')
        kinect.say(word)
        device.until(lambda: device.faults, 'the fault')
        kinect.say('there')
        seen = len(device.captures)
        device.until(lambda: len(device.captures) > seen + 3, 'images again')
    assert device.faults[0].fault == fault


def test_no_permission_says_the_udev_rule(kinect):
    kinect.say('denied')
    with kinect.watch() as device:
        device.until(lambda: device.faults, 'the fault')
    assert device.faults[0].fault == Fault.PERMISSION
    assert 'ATTR{idVendor}=="045e", ATTR{idProduct}=="02ae"' in device.faults[0].advice
    assert '/etc/udev/rules.d' in device.faults[0].advice


@pytest.mark.parametrize(('name', 'said'), [('3', 'index 3: 1 plugged in'), ('B0002', 'serial number B0002')])
def test_a_kinect_that_is_not_there_by_name(kinect, name, said):
    with kinect.watch(device=name) as device:
        device.until(lambda: device.faults, 'the fault')
    assert said in str(device.faults[0])


def test_a_kinect_by_its_serial_number(kinect):
    with kinect.watch(device='A0001', colour=False) as device:
        device.until(lambda: device.stream(DEPTH), 'images')
    assert device.stream(COLOUR) == []
