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

"""The camera drivers over DDS: images on the sensor's topics, faults in the diagnostics."""

import os
import signal
import time

import numpy as np
import pytest
from devices import build_stub, need_fakenect, need_library
from recordings import raw_disparity, write_fakenect
from sensor_msgs.msg import CameraInfo, Image

from debris_scanner.drivers.kinect_depth import ZeroPlane
from debris_scanner.nodes.inputs.camera_driver import COLOUR_IMAGE, COLOUR_INFO
from debris_scanner.nodes.inputs.cameras import DEPTH, INFO
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, OK
from msg_adapters.depth_images import read_depth
from msg_adapters.inputs.camera_infos import read_camera
from msg_adapters.stamps import read_stamp

pytestmark = pytest.mark.ros


def parameters(**values):
    return ['--ros-args', *(p for k, v in values.items() for p in ('-p', f'{k}:={v}'))]


def report_of(peer, node):
    return peer.reports.get(node)


def at(peer, node, level):
    """Wait until a node reports a level; the report."""

    def there():
        report = report_of(peer, node)
        return report if report is not None and report.level == level else None

    return peer.until(there, f'{node} at level {level}')


def log_of(nodes, node):
    return nodes._children[node].log.read_text()


def end_of(nodes, node):
    """Ctrl-C, and the exit code."""
    nodes.interrupt(node)
    assert nodes.wait(node, 15)
    return nodes.exit_code(node)


def pid_is_alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_dummy_device_on_the_topics_of_the_sensor(nodes, peer):
    need_library('openni2')
    depth, info = peer.listen(Image, DEPTH), peer.listen(CameraInfo, INFO)
    colour, colour_info = peer.listen(Image, COLOUR_IMAGE), peer.listen(CameraInfo, COLOUR_INFO)
    nodes.start(
        'openni2_camera',
        parameters(device='Dummy', fx=285.0, cx=159.5, max_rate_hz=10.0, frame_id='d', rgb_frame_id='c'),
    )
    peer.until(lambda: len(depth) >= 10 and len(colour) >= 5 and len(info) >= 10, 'images')
    image, camera = depth[0], read_camera(info[0])
    assert (image.encoding, image.width, image.height, image.header.frame_id) == ('16UC1', 320, 240, 'd')
    assert np.isclose(read_depth(image)[0], 2.0).all()
    assert image.header == info[0].header
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (285.0, 285.0, 159.5, 120.0)
    assert (colour[0].encoding, colour[0].header.frame_id) == ('rgb8', 'c')
    assert colour_info[0].header.frame_id == 'c'
    stamps = [read_stamp(m.header.stamp) for m in depth]
    assert np.all(np.diff(stamps) > 0)
    assert np.median(np.diff(stamps)) == pytest.approx(1e8, rel=0.05)  # 33 ms a frame by the dummy's clock
    assert abs(stamps[-1] - time.time_ns()) < 2e9
    report = at(peer, 'openni2_camera', OK)
    assert 'Dummy' in report.values['device']
    assert report.values['intrinsics'].startswith('fx, fy, cx given')
    peer.until(
        lambda: report_of(peer, 'openni2_camera').counts.get('published', 0) >= 10, 'the count of images'
    )
    pid = int(report.values['device_process'])
    assert end_of(nodes, 'openni2_camera') == 0
    assert not pid_is_alive(pid)
    assert 'Traceback' not in log_of(nodes, 'openni2_camera')


def test_replayed_kinect_is_published_and_the_node_ends_with_it(nodes, peer, tmp_path):
    need_fakenect()
    frames = [np.full((480, 640), 700 + 20 * k, np.uint16) for k in range(8)]
    folder = write_fakenect(tmp_path / 'kinect', frames, 10)
    depth, info = peer.listen(Image, DEPTH), peer.listen(CameraInfo, INFO)
    nodes.start('freenect_camera', parameters(device=folder, wait_for_subscribers=20.0))
    peer.until(lambda: len(depth) == 8, 'eight images')
    table = ZeroPlane().table_mm()
    for image, sent in zip(depth, frames, strict=True):
        assert image.encoding == '16UC1'
        assert image.header.frame_id == 'camera_depth_optical_frame'
        assert np.allclose(read_depth(image), table[raw_disparity(sent)] * 0.001)
    assert read_camera(info[0]).fx == pytest.approx(575.8, abs=0.1)
    peer.until(lambda: not nodes.running('freenect_camera'), 'the end')
    assert nodes.exit_code('freenect_camera') == 0


@pytest.mark.parametrize(
    ('node', 'driver', 'values', 'said'),
    [
        ('openni2_camera', 'openni2', {}, 'plugged in'),
        ('freenect_camera', 'freenect', {}, 'plugged in'),
        ('openni2_camera', 'openni2', {'library': '/none.so'}, 'apt-get install libopenni2-0'),
        ('freenect_camera', None, {'library': '/none.so'}, 'apt-get install libfreenect0.5'),
        ('freenect_camera', None, {'device': '/no/such/folder'}, 'bad recording'),
    ],
)
def test_without_a_device_the_node_lives_says_so_each_second_and_logs_it_once(
    nodes, peer, node, driver, values, said
):
    if driver is not None:
        need_library(driver)
    nodes.start(node, parameters(**values))
    report = at(peer, node, ERROR)
    assert said in report.message
    first = report.stamp_ns

    def later():
        report = report_of(peer, node)
        return report.counts.get('faults', 0) >= 3 and report.stamp_ns > first

    peer.until(later, 'a later report, of three tries')  # the first one that came may have been of as many
    assert report_of(peer, node).level == ERROR
    assert end_of(nodes, node) == 0
    assert log_of(nodes, node).count('[ERROR]') == 1
    assert 'Traceback' not in log_of(nodes, node)


@pytest.fixture
def kinect(tmp_path, monkeypatch, nodes, peer):
    """A node with a stub of libfreenect that follows a script."""
    library, state = build_stub(tmp_path), tmp_path / 'state'
    monkeypatch.setenv('STUB_FREENECT', str(state))

    def say(word):
        (tmp_path / 'part').write_text(word)
        (tmp_path / 'part').replace(state)

    say('there')
    nodes.start('freenect_camera', parameters(library=library))
    return say


def test_unplugged_and_plugged_in_again(kinect, nodes, peer):
    depth = peer.listen(Image, DEPTH)
    peer.until(lambda: len(depth) > 5, 'images')
    at(peer, 'freenect_camera', OK)
    kinect('gone')
    assert 'unplugged' in at(peer, 'freenect_camera', ERROR).message
    kinect('none')
    peer.until(lambda: 'no device' in report_of(peer, 'freenect_camera').message, 'word of no device')
    kinect('there')
    seen = len(depth)
    peer.until(lambda: len(depth) > seen + 5, 'images again')
    at(peer, 'freenect_camera', OK)
    stamps = [read_stamp(m.header.stamp) for m in depth]
    assert np.all(np.diff(stamps) > 0)
    assert nodes.running('freenect_camera')


def test_no_permission(kinect, peer):
    kinect('denied')
    peer.until(lambda: 'udev' in getattr(report_of(peer, 'freenect_camera'), 'message', ''), 'the udev rule')


def test_device_process_that_is_killed_comes_back(kinect, nodes, peer):
    depth = peer.listen(Image, DEPTH)
    peer.until(lambda: len(depth) > 5, 'images')
    pid = int(at(peer, 'freenect_camera', OK).values['device_process'])
    os.kill(pid, signal.SIGKILL)
    peer.until(lambda: report_of(peer, 'freenect_camera').counts.get('faults') == 1, 'the fault')
    seen = len(depth)
    peer.until(lambda: len(depth) > seen + 5, 'images again')
    assert 'SIGKILL' in log_of(nodes, 'freenect_camera')


def test_a_node_that_is_killed_takes_the_device_process_along(kinect, nodes, peer):
    depth = peer.listen(Image, DEPTH)
    peer.until(lambda: depth, 'images')
    pid = int(at(peer, 'freenect_camera', OK).values['device_process'])
    nodes._children['freenect_camera'].process.kill()
    peer.until(lambda: not pid_is_alive(pid), 'the end of the device process', 10)


def test_wrong_parameter_ends_the_node_with_one_line(nodes, peer):
    nodes.start('freenect_camera', parameters(max_rate_hz=-1.0))
    peer.until(lambda: not nodes.running('freenect_camera'), 'the end')
    assert nodes.exit_code('freenect_camera') == 2
    assert 'max_rate_hz' in nodes.last_words('freenect_camera')
