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

"""Node preprocess, alone, over DDS: frames in, the target out, garbage counted."""

import dataclasses
import itertools
import time
from array import array

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_srvs.srv import SetBool, Trigger

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message
from msg_adapters.target_frames import read_target_frame

pytestmark = pytest.mark.ros

CAMERA = Camera(525.0, 525.0, 79.5, 59.5, 160, 120)
FRAME = 'camera_depth_optical_frame'
NOISE = np.random.default_rng(1)


def disc_depth():
    v, u = np.mgrid[:120, :160]
    depth = 0.8 + 1e-5 * ((u - 80.0) ** 2 + (v - 60.0) ** 2)
    depth += NOISE.normal(scale=2e-4, size=depth.shape)  # no sensor measures the same twice
    return np.where((u - 80) ** 2 + (v - 60) ** 2 < 40**2, depth, 0).astype(np.float32)


def disc_cloud(stamp_ns):
    return cloud_frame_message(DepthFrame(stamp_ns, disc_depth(), CAMERA), FRAME)


def garbage():
    """One cloud of each kind that contradicts itself."""
    clouds = []
    for change in (
        {'data': array('B', b'\0' * 10)},
        {'point_step': 13},
        {'height': 60_000, 'width': 60_000},
        {'fields': [PointField(name='x', offset=0, datatype=99, count=1)]},
        {'fields': [PointField(name=n, offset=100, datatype=PointField.FLOAT32, count=1) for n in 'xyz']},
        {'fields': [PointField(name='a', offset=0, datatype=PointField.FLOAT32, count=1)]},
    ):
        cloud = disc_cloud(1)
        for name, value in change.items():
            setattr(cloud, name, value)
        clouds.append(cloud)
    return clouds


@pytest.fixture
def preprocess(nodes, peer):
    nodes.start('preprocess', ['--ros-args', '-p', 'input_reliability:=reliable'])
    return nodes


def test_garbage_is_counted_by_reason_and_good_clouds_go_on(preprocess, peer):
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points')
    points.publish(disc_cloud(1_000_000_000))
    peer.until(lambda: len(targets) == 1, 'the first target')
    sent = garbage()
    for cloud in sent:
        points.publish(cloud)
    points.publish(disc_cloud(500_000_000))  # back in time
    empty = disc_cloud(1_100_000_000)
    empty.data = array('B', np.full(len(empty.data) // 4, np.nan, np.float32).tobytes())
    points.publish(empty)
    points.publish(disc_cloud(1_200_000_000))
    peer.until(lambda: len(targets) == 2, 'the target after the garbage')
    preprocess.check()
    expected = {'malformed': len(sent), 'non_monotone_stamp': 1, 'no_target': 1}
    peer.until(lambda: peer.rejected('preprocess') == expected, f'a report of {expected}')
    assert peer.reports['preprocess'].counts['received'] == len(sent) + 4
    frame = read_target_frame(targets[1])
    assert frame.stamp_ns == 1_200_000_000
    assert targets[1].header.frame_id == FRAME
    assert np.count_nonzero(frame.depth) == np.count_nonzero(disc_depth())


def test_depth_images_wait_for_their_camera_info(preprocess, peer):
    targets = peer.listen(PointCloud2, 'target_points')
    image = peer.talk(Image, 'depth/image_raw')
    info = peer.talk(CameraInfo, 'depth/camera_info')
    image.publish(depth_image_message(1_000_000_000, FRAME, disc_depth(), '16UC1'))
    peer.until(lambda: 'preprocess' in peer.reports, 'a report')
    assert not targets
    info.publish(camera_info_message(1_000_000_000, FRAME, CAMERA))
    peer.until(lambda: len(targets) == 1, 'the target')
    image.publish(depth_image_message(1_100_000_000, FRAME, disc_depth(), '16UC1'))
    peer.until(lambda: len(targets) == 2, 'the next target')


def images_with(peer, info, depth, until, what):
    """Publish depth images with a camera_info, until the report of preprocess says so."""
    image, infos = peer.talk(Image, 'depth/image_raw'), peer.talk(CameraInfo, 'depth/camera_info')
    stamps = itertools.count(10)

    def told():
        stamp_ns = next(stamps) * 100_000_000
        infos.publish(info(stamp_ns))
        fresh = depth.copy()
        fresh[0, 0] = 1e-9 * stamp_ns  # an image that comes again to the bit is none
        image.publish(depth_image_message(stamp_ns, FRAME, fresh, '32FC1'))
        time.sleep(1 / 30)
        report = peer.reports.get('preprocess')
        return report if report and until(report) else None

    return peer.until(told, what)


def test_a_wrong_camera_info_is_counted_as_such_and_its_values_are_said(preprocess, peer):
    def of_another_size(stamp_ns):
        return camera_info_message(stamp_ns, FRAME, dataclasses.replace(CAMERA, width=320))

    said = 'camera_info is of 320x120, the image has 160x120'
    report = images_with(peer, of_another_size, disc_depth(), lambda r: said in r.message, 'the values')
    assert report.rejected.keys() == {'camera_info'}
    assert report.level == DiagnosticStatus.WARN
    assert report.values['hint'] == said


def test_depth_in_another_unit_is_hinted_at(preprocess, peer):
    def info(stamp_ns):
        return camera_info_message(stamp_ns, FRAME, CAMERA)

    said = 'depth looks like millimetres in a format that is in metres'
    report = images_with(peer, info, disc_depth() * 1000, lambda r: said in r.message, 'the hint')
    assert report.level == DiagnosticStatus.WARN
    images_with(peer, info, disc_depth(), lambda r: not r.values['hint'], 'no hint')


def test_pause_drops_and_reset_lets_an_earlier_stamp_in(preprocess, peer):
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points')
    assert peer.call(SetBool, 'preprocess/pause', SetBool.Request(data=True)).success
    points.publish(disc_cloud(1_000_000_000))
    peer.until(lambda: peer.rejected('preprocess').get('paused') == 1, 'the drop')
    assert peer.call(SetBool, 'preprocess/pause', SetBool.Request(data=False)).success
    points.publish(disc_cloud(2_000_000_000))
    peer.until(lambda: len(targets) == 1, 'the target')
    answer = peer.call(Trigger, 'preprocess/reset')
    assert answer.success
    assert 'new scan' in answer.message
    points.publish(disc_cloud(1_500_000_000))
    peer.until(lambda: len(targets) == 2, 'the target of the new scan')


def test_says_who_is_silent(preprocess, peer):
    report = peer.until(lambda: peer.reports.get('preprocess'), 'a report')
    assert '/points has no publisher' in report.message
    assert '/depth/image_raw has no publisher' in report.message


def test_a_value_out_of_range_ends_it_with_one_line(nodes, peer):
    nodes.start('preprocess', ['--ros-args', '-p', 'isolation.min_pixels:=3'])
    assert nodes.wait('preprocess', 30)
    with pytest.raises(Exception, match=r'exit code 2.*isolation.min_pixels') as failure:
        nodes.check()
    assert 'Traceback' not in str(failure.value)


def test_background_in_the_box_is_said(preprocess, peer):
    targets = peer.listen(PointCloud2, 'target_points')
    points = peer.talk(PointCloud2, 'points')
    v, u = np.mgrid[:120, :160]
    numbers = itertools.count(10)

    def warned():
        time.sleep(1 / 60)  # what overruns the node is shed, and gaps take longer to learn
        k = next(numbers)
        depth = np.where((u < 30) & (v > 20), 0.9, 0).astype(np.float32)
        ball = (u - 90 - 8 * np.sin(1.9 * k)) ** 2 + (v - 60) ** 2 < 30**2
        depth[ball] = 0.7 + 0.02 * np.sin(1.3 * k)
        points.publish(cloud_frame_message(DepthFrame(k * 100_000_000, depth, CAMERA), FRAME))
        report = peer.reports.get('preprocess')
        return report if report and 'stand still' in report.message else None

    report = peer.until(warned, 'the warning')
    assert 'narrow isolation.box_min and box_max' in report.message
    peer.until(lambda: targets, 'a target')
    assert np.count_nonzero(read_target_frame(targets[-1]).depth) < 3000  # the ball alone
