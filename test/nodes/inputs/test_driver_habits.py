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

"""What drivers do beside the plain case, over DDS: compressed, latched, in body axes, in another unit."""

import io
import struct
import threading

import numpy as np
import pytest
from PIL import Image as PillowImage
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2
from std_msgs.msg import Float32
from test_preprocess import CAMERA, FRAME, disc_depth

from debris_scanner.core import camera
from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, INFO
from debris_scanner.nodes.inputs.sources import wait_for
from debris_scanner.nodes.inputs.synchroniser import COLOUR_INFO, COMPRESSED
from debris_scanner.nodes.lifecycle import qos
from msg_adapters.bag_writer import BagWriter
from msg_adapters.clouds import cloud_message
from msg_adapters.colour_images import colour_image_message
from msg_adapters.depth_images import camera_info_message, depth_image_message
from msg_adapters.inputs.static_frames import TF_STATIC, TF_TYPE
from msg_adapters.stamps import header_message
from msg_adapters.target_frames import read_target_frame

pytestmark = pytest.mark.ros
S = 1_000_000_000
RELIABLE = ('-p', 'input_reliability:=reliable')


class Driver:
    """A preprocess with parameters, and what it makes of messages."""

    def __init__(self, nodes, peer, *arguments):
        self.nodes, self.peer = nodes, peer
        self.targets = peer.listen(PointCloud2, 'target_points')
        nodes.start('preprocess', ['--ros-args', *RELIABLE, *arguments])

    def target(self, count=1):
        self.peer.until(lambda: len(self.targets) >= count, f'target {count}')
        return read_target_frame(self.targets[count - 1])

    def log(self):
        return self.nodes._children['preprocess'].log.read_text()


def median(frame):
    return float(np.median(frame.depth[frame.depth > 0]))


def png(stamp_ns, format_, pixels):
    file = io.BytesIO()
    PillowImage.fromarray(pixels).save(file, 'PNG')
    data = struct.pack('<iff', 0, 0.0, 0.0) + file.getvalue()
    return CompressedImage(header=header_message(stamp_ns, FRAME), format=format_, data=data)


def test_compressed_depth_is_read_where_the_image_is_remapped_to(nodes, peer):
    """image_transport names it after the image, which alone is remapped; its camera_info came once."""
    driver = Driver(nodes, peer, '-r', f'{DEPTH}:=/cam/depth/image', '-r', f'{INFO}:=/cam/depth/camera_info')
    image = peer.talk(CompressedImage, '/cam/depth/image/compressedDepth')
    infos = peer.node.create_publisher(CameraInfo, '/cam/depth/camera_info', qos.latched())
    infos.publish(camera_info_message(0, FRAME, CAMERA))
    for k in range(2):
        pixels = np.rint(1000 * disc_depth()).astype(np.uint16)
        image.publish(png(S + k * S // 10, '16UC1; compressedDepth png', pixels))
        assert median(driver.target(k + 1)) == pytest.approx(0.81, abs=0.01)


def test_a_compression_that_changes_depths_is_refused_by_name(nodes, peer):
    driver = Driver(nodes, peer)
    image, info = peer.talk(CompressedImage, COMPRESSED), peer.talk(CameraInfo, INFO)
    info.publish(camera_info_message(S, FRAME, CAMERA))
    message = png(S, '16UC1; jpeg compressed mono8', np.zeros((4, 4), np.uint8))
    message.data = b'\xff\xd8 a JPEG'
    image.publish(message)
    peer.until(lambda: peer.rejected('preprocess') == {'malformed': 1}, 'the refusal')
    assert "compressed as '16UC1; jpeg compressed mono8' is not PNG" in driver.log()


def test_a_camera_info_that_was_sent_before_we_came_is_received(nodes, peer):
    infos = peer.node.create_publisher(CameraInfo, INFO, qos.latched())
    infos.publish(camera_info_message(0, FRAME, CAMERA))
    driver = Driver(nodes, peer)
    image = peer.talk(Image, DEPTH)
    image.publish(depth_image_message(S, FRAME, disc_depth(), '16UC1'))
    driver.target()


def body_cloud(stamp_ns, frame_id, flat=True):
    points = CAMERA.back_project(disc_depth())[..., [2, 0, 1]] * np.float32([1, -1, -1])
    points = points[np.isfinite(points).all(axis=-1)] if flat else points
    fields = {axis: np.ascontiguousarray(points[..., i]) for i, axis in enumerate('xyz')}
    return cloud_message(stamp_ns, frame_id, fields)


def test_a_cloud_in_body_axes_is_recognised_or_refused_by_its_frame(nodes, peer):
    driver = Driver(nodes, peer)
    points = peer.talk(PointCloud2, 'points')
    points.publish(body_cloud(S, 'rig'))
    peer.until(lambda: peer.rejected('preprocess') == {'malformed': 1}, 'the refusal')
    assert "points of frame 'rig' lie along +x: not an optical frame" in driver.log()
    points.publish(body_cloud(S + S // 10, 'lidar_link'))
    assert median(driver.target(1)) == pytest.approx(0.81, abs=0.02)
    points.publish(body_cloud(S + S // 5, 'zed_left_camera_frame', flat=False))
    assert median(driver.target(2)) == pytest.approx(0.81, abs=0.01)
    assert 'looks along +x' in driver.log()


def test_a_depth_image_is_scanned_beside_a_cloud_that_is_refused(nodes, peer):
    driver = Driver(nodes, peer)
    points = peer.talk(PointCloud2, 'points')
    image, info = peer.talk(Image, DEPTH), peer.talk(CameraInfo, INFO)
    points.publish(body_cloud(S, 'rig'))
    peer.until(lambda: peer.rejected('preprocess') == {'malformed': 1}, 'the refusal')
    info.publish(camera_info_message(S, FRAME, CAMERA))
    image.publish(depth_image_message(S, FRAME, disc_depth(), '16UC1'))
    assert median(driver.target()) == pytest.approx(0.81, abs=0.01)


def test_axes_and_scale_are_parameters(nodes, peer):
    driver = Driver(nodes, peer, '-p', 'axes:="-y,-z,x"', '-p', 'depth_scale:=2.0')
    points = peer.talk(PointCloud2, 'points')
    points.publish(body_cloud(S, 'rig'))
    assert median(driver.target()) == pytest.approx(1.62, abs=0.03)


@pytest.mark.skipif(TF_TYPE is None, reason='tf2_msgs is not installed')
def test_static_transforms_tell_the_axes(nodes, peer):
    from geometry_msgs.msg import TransformStamped

    link = TransformStamped(child_frame_id='camera_optical_frame')
    link.header.frame_id = 'rig'
    r = link.transform.rotation
    r.x, r.y, r.z, r.w = -0.5, 0.5, -0.5, 0.5
    frames = peer.node.create_publisher(TF_TYPE, TF_STATIC, qos.kept())
    frames.publish(TF_TYPE(transforms=[link]))
    driver = Driver(nodes, peer)
    points = peer.talk(PointCloud2, 'points')
    points.publish(body_cloud(S, 'rig'))
    assert median(driver.target()) == pytest.approx(0.81, abs=0.02)


def test_colour_of_another_camera_is_not_used_though_its_frame_is_called_alike(nodes, peer):
    driver = Driver(nodes, peer)
    image, info, colour, colour_info = (
        peer.talk(kind, name)
        for kind, name in ((Image, DEPTH), (CameraInfo, INFO), (Image, COLOUR), (CameraInfo, COLOUR_INFO))
    )
    other = camera.Camera(620.0, 620.0, 79.5, 59.5, 160, 120)
    stamps = iter(range(S, 1000 * S, S))

    def said():
        stamp_ns = next(stamps)
        colour_info.publish(camera_info_message(stamp_ns, FRAME, other))
        info.publish(camera_info_message(stamp_ns, FRAME, CAMERA))
        colour.publish(colour_image_message(stamp_ns, FRAME, np.full((120, 160, 3), 90, np.uint8)))
        image.publish(depth_image_message(stamp_ns, FRAME, disc_depth(), '16UC1'))
        return 'its camera_info is of another camera' in driver.log()

    peer.until(said, 'the reason')
    driver.target()
    assert all(read_target_frame(target).rgb is None for target in driver.targets)


def test_the_same_image_twice_is_one_frame(nodes, peer):
    driver = Driver(nodes, peer)
    image, info = peer.talk(Image, DEPTH), peer.talk(CameraInfo, INFO)
    info.publish(camera_info_message(S, FRAME, CAMERA))
    depth = disc_depth()
    for k in range(3):
        image.publish(depth_image_message(S + k * S // 30, FRAME, depth, '16UC1'))
    peer.until(lambda: peer.rejected('preprocess') == {'duplicate': 2}, 'the duplicates')
    assert len(driver.targets) == 1


def test_a_bag_of_compressed_depth_is_played_as_it_is(nodes, peer, tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        for k in range(3):
            stamp_ns = S + k * S // 10
            pixels = np.rint(1000 * disc_depth()).astype(np.uint16)
            bag.write('/cam/image_rect/camera_info', camera_info_message(stamp_ns, FRAME, CAMERA))
            topic = '/cam/image_rect/compressedDepth'
            bag.write(topic, png(stamp_ns, '16UC1; compressedDepth png', pixels))
    driver = Driver(nodes, peer)
    # the bag waits for preprocess, and not for whoever listens to that
    peer.until(lambda: peer.node.count_publishers('target_points'), 'a publisher of targets')
    nodes.start('play_bag', ['--ros-args', '-p', f'bag:={tmp_path / "bag"}'])
    assert median(driver.target(3)) == pytest.approx(0.81, abs=0.01)
    silent = '/depth/image_raw/compressedDepth has no publisher'
    peer.until(lambda: silent in peer.reports['preprocess'].message, 'what the sensor lacks')


def test_a_bag_that_tells_its_unit_of_depth_says_what_scans_it(nodes, tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write('/device_0/sensor_0/option/Depth_Units/value', Float32(data=1e-4), S)
        bag.write('/device_0/sensor_0/info', camera_info_message(S, FRAME, CAMERA))
        bag.write('/device_0/sensor_0/depth', depth_image_message(S, FRAME, disc_depth(), '16UC1'))
    nodes.start('play_bag', ['--ros-args', '-p', f'bag:={tmp_path / "bag"}'])
    log = nodes._children['play_bag'].log
    wait_for(lambda: 'depth_scale:=0.0001' in log.read_text(), threading.Event(), 30.0)
    assert 'its depth is in units of 0.0001 m' in log.read_text()
