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

"""Colour images beside depth images, over DDS: registered ones are used, others are ignored."""

import itertools
from array import array
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from devices import need_library
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from test_preprocess import CAMERA, FRAME, disc_cloud, disc_depth

from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, INFO, MASK, POINTS
from debris_scanner.nodes.inputs.sensor_input import SensorInput
from msg_adapters.clouds import cloud_message, read_cloud
from msg_adapters.colour_images import colour_image_message
from msg_adapters.depth_images import camera_info_message, depth_image_message
from msg_adapters.stamps import time_message
from msg_adapters.target_frames import read_target_frame

pytestmark = pytest.mark.ros
S = 1_000_000_000
MS = 1_000_000


def test_a_hint_is_logged_once_whatever_comes_beside_it():
    logged = []
    node = SimpleNamespace(
        diagnostics=SimpleNamespace(rejected=Counter(no_target=9), counts={'received': 10}),
        get_logger=lambda: SimpleNamespace(warning=logged.append),
    )
    reader = SimpleNamespace(_node=node, _hinted=set())
    for hints in (('a',), ('b', 'a'), ('a', 'c'), ()):
        problem = SensorInput.oddity(reader, hints)
        assert problem is None if not hints else problem[1] == '; '.join(hints)
    assert logged == ['a', 'b', 'c']


def painted(shade=200):
    """Colours that tell every pixel from its neighbours."""
    v, u = np.mgrid[:120, :160]
    return np.stack([u, v, np.full_like(u, shade)], axis=-1).astype(np.uint8)


class Camera:
    """Sends depth, its camera_info, and colour to a running preprocess."""

    def __init__(self, nodes, peer, masked=False):
        self.peer = peer
        self.targets = peer.listen(PointCloud2, 'target_points')
        nodes.start('preprocess', ['--ros-args', '-p', 'input_reliability:=reliable'])
        self._depth, self._info = peer.talk(Image, DEPTH), peer.talk(CameraInfo, INFO)
        self._colour = peer.talk(Image, COLOUR)
        self._mask = peer.node.create_publisher(Image, MASK, 10) if masked else None

    def depth(self, stamp_ns):
        self._info.publish(camera_info_message(stamp_ns, FRAME, CAMERA))
        self._depth.publish(depth_image_message(stamp_ns, FRAME, disc_depth(), '16UC1'))

    def colour(self, stamp_ns, frame=FRAME, rgb=None):
        self._colour.publish(colour_image_message(stamp_ns, frame, painted() if rgb is None else rgb))

    def mask(self, stamp_ns, chosen, **changed):
        message = Image(height=120, width=160, encoding='mono8', step=160)
        message.header.stamp, message.header.frame_id = time_message(stamp_ns), FRAME
        message.data = array('B', (255 * chosen).astype(np.uint8).tobytes())
        for name, value in changed.items():
            setattr(message, name, value)
        self._mask.publish(message)

    def counts(self):
        report = self.peer.reports.get('preprocess')
        return report.counts if report else {}

    def until_received(self, count):
        """Until so many colour images have come."""
        key = f'input.{COLOUR}.received'
        reports = self.peer.reports
        self.peer.until(
            lambda: 'preprocess' in reports and reports['preprocess'].values.get(key) == str(count), key
        )

    def target(self, count):
        self.peer.until(lambda: len(self.targets) >= count, f'target {count}')
        return read_target_frame(self.targets[count - 1])


@pytest.fixture
def camera(nodes, peer):
    return Camera(nodes, peer)


def test_registered_colour_of_the_moment_is_carried_along(camera, nodes):
    camera.colour(S - 90 * MS, rgb=painted(1))  # of another moment
    camera.colour(S + 8 * MS)
    camera.until_received(2)
    camera.depth(S)
    frame = camera.target(1)
    v, u = np.nonzero(frame.depth)
    u0, v0 = round(CAMERA.cx - frame.camera.cx), round(CAMERA.cy - frame.camera.cy)
    assert np.array_equal(frame.rgb[v, u], painted()[v + v0, u + u0])

    camera.depth(2 * S)  # none comes: the frame is not lost
    assert camera.target(2).rgb is None
    camera.peer.until(lambda: camera.counts().get('coloured') == 1, 'the count of colours')
    nodes.check()


def test_colour_that_comes_after_its_depth_is_waited_for(camera, peer):
    camera.colour(0)
    camera.until_received(1)
    stamps = iter(range(S, 1000 * S, S))

    def waited():  # a frame waits for milliseconds, so a busy machine may need more than one attempt
        count = len(camera.targets) + 1
        camera.depth(stamp := next(stamps))
        camera.colour(stamp)
        return camera.target(count).rgb is not None

    peer.until(waited, 'a frame with the colour that came after it')


def test_colour_that_cannot_be_read_costs_no_frame(camera, nodes):
    broken = colour_image_message(S, FRAME, painted())
    broken.encoding = 'yuv422'
    camera._colour.publish(broken)
    camera.until_received(1)
    camera.depth(S)
    assert camera.target(1).rgb is None
    camera.peer.until(lambda: camera.counts().get('malformed_colour') == 1, 'the count')
    camera.colour(2 * S)
    camera.until_received(2)
    camera.depth(2 * S)
    assert camera.target(2).rgb is not None
    assert camera.peer.rejected('preprocess') == {}


@pytest.mark.parametrize(
    ('frame', 'rgb', 'said'),
    [
        ('camera_rgb_optical_frame', None, 'it is seen from camera_rgb_optical_frame, depth from'),
        (FRAME, np.zeros((240, 320, 3), np.uint8), '320x240 pixels, depth has 160x120'),
    ],
)
def test_colour_of_another_view_is_ignored_and_the_log_says_why(camera, nodes, peer, frame, rgb, said):
    stamps = iter(range(S, 1000 * S, S))

    def left():
        camera.colour(stamp := next(stamps), frame, rgb)
        camera.depth(stamp)
        return f'{COLOUR} is ignored: {said}' in nodes._children['preprocess'].log.read_text()

    peer.until(left, 'the reason')
    peer.until(lambda: camera._colour.get_subscription_count() == 0, 'nobody to listen')
    camera.target(1)
    assert all(read_target_frame(t).rgb is None for t in camera.targets)
    count = len(camera.targets) + 1

    def another():  # a busy node sheds frames
        camera.depth(next(stamps))
        return len(camera.targets) >= count

    peer.until(another, f'target {count}')
    assert camera.target(count).rgb is None


def test_a_coloured_cloud_needs_no_colour_image(camera, peer):
    cloud = disc_cloud(S)

    xyz = read_cloud(cloud).xyz
    peer.talk(PointCloud2, 'points').publish(
        cloud_message(S, FRAME, {axis: xyz[..., i] for i, axis in enumerate('xyz')}, painted(77))
    )
    assert camera.target(1).rgb[..., 2].max() == 77
    peer.until(lambda: camera._colour.get_subscription_count() == 0, 'nobody to listen to colour images')


@pytest.mark.timing  # colour that comes late is not waited for
def test_an_image_that_waits_for_its_camera_info_takes_no_cloud_away(camera, peer):
    """A driver sends both, the camera_info last: the clouds that are scanned by then stay the input."""
    cloud = peer.talk(PointCloud2, POINTS)
    camera._depth.publish(depth_image_message(S, FRAME, disc_depth(), '16UC1'))
    key = f'input.{DEPTH}.received'
    peer.until(
        lambda: 'preprocess' in peer.reports and peer.reports['preprocess'].values.get(key) == '1', key
    )
    cloud.publish(disc_cloud(2 * S))
    camera.target(1)
    camera._info.publish(camera_info_message(3 * S, FRAME, CAMERA))
    key = f'input.{INFO}.received'
    peer.until(lambda: peer.reports['preprocess'].values.get(key) == '1', key)
    cloud.publish(disc_cloud(4 * S))
    assert camera.target(2).stamp_ns == 4 * S


@pytest.mark.timing  # a colour image waits for its depth no longer than some periods
def test_a_drivers_colour_is_paired_with_its_depth(nodes, peer):
    need_library('openni2')
    given = {'device': 'Dummy', 'fx': 285.0, 'rgb_frame_id': FRAME, 'max_rate_hz': 10.0}  # as if registered
    nodes.start('preprocess')
    nodes.start('openni2_camera', ['--ros-args', *(p for k, v in given.items() for p in ('-p', f'{k}:={v}'))])

    def coloured(count):
        report = peer.until(lambda: peer.reports.get('preprocess'), 'a report')
        return report.counts.get('coloured', 0) >= count and report.counts

    first = peer.until(lambda: coloured(3), 'coloured frames')  # depth may have come first
    counts = peer.until(lambda: coloured(first['coloured'] + 20), 'twenty more')
    plain = counts['received'] - counts['coloured'] - (first['received'] - first['coloured'])
    assert plain <= 10, counts  # most are paired; under way, or their colour came later than they may wait


def test_a_mask_chooses_the_target_and_frames_without_one_are_left_out(nodes, peer):
    camera = Camera(nodes, peer, masked=True)
    peer.until(camera._mask.get_subscription_count, 'a subscriber of the mask')
    chosen = np.zeros((120, 160), bool)
    chosen[:, :80] = True  # the left half of the disc
    for k in range(10):
        camera.mask(S + k * 100 * MS, chosen)
        camera.depth(S + k * 100 * MS)
        peer.executor.spin_once(0.05)
    peer.until(lambda: camera.targets, 'a target')
    seen = read_target_frame(camera.targets[-1])
    assert np.count_nonzero(seen.depth) == np.count_nonzero(disc_depth()[chosen])
    left_out = peer.rejected('preprocess').get('no_mask', 0)
    camera.depth(3 * S)
    peer.until(lambda: peer.rejected('preprocess').get('no_mask', 0) > left_out, 'a frame without a mask')
    camera.mask(4 * S, chosen[:60], height=60)
    camera.depth(4 * S)
    peer.until(lambda: peer.rejected('preprocess').get('malformed') == 1, 'a mask of another size')
    assert max(read_target_frame(target).stamp_ns for target in camera.targets) < 3 * S


def test_two_targets_of_one_camera_are_told_by_a_mask_and_a_namespace_each(nodes, peer):
    halves = {'left': np.zeros((120, 160), bool), 'right': np.zeros((120, 160), bool)}
    halves['left'][:, :80] = halves['right'][:, 80:] = True
    targets, masks = {}, {}
    for name in halves:
        targets[name] = peer.listen(PointCloud2, f'/{name}/target_points')
        masks[name] = peer.node.create_publisher(Image, f'/seg/{name}', 10)
        topics = {DEPTH: '/cam/depth', INFO: '/cam/info', MASK: f'/seg/{name}'}
        remapped = [part for ours, theirs in topics.items() for part in ('-r', f'{ours}:={theirs}')]
        nodes.start('preprocess', ['--ros-args', '-r', f'__ns:=/{name}', *remapped], name)
    infos, images = peer.talk(CameraInfo, '/cam/info'), peer.talk(Image, '/cam/depth')
    stamps = itertools.count(S, 100 * MS)

    def both():
        stamp_ns = next(stamps)
        for name, half in halves.items():
            message = Image(height=120, width=160, encoding='mono8', step=160)
            message.header.stamp, message.header.frame_id = time_message(stamp_ns), FRAME
            message.data = array('B', (255 * half).astype(np.uint8).tobytes())
            masks[name].publish(message)
        infos.publish(camera_info_message(stamp_ns, FRAME, CAMERA))
        images.publish(depth_image_message(stamp_ns, FRAME, disc_depth(), '16UC1'))
        peer.executor.spin_once(0.05)
        return all(targets.values())

    peer.until(both, 'a target of each')
    for name, half in halves.items():
        seen = np.count_nonzero(read_target_frame(targets[name][-1]).depth)
        assert seen == np.count_nonzero(disc_depth()[half]), name
