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

"""Drivers of other authors, as they send: topics, encodings, frames, QoS, padding. ``camera:=`` is enough."""

import itertools
import re
import time
from array import array
from typing import NamedTuple

import numpy as np
import pytest
from launching import ROOT, Launched, install
from live_runs import LiveRun
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from test_preprocess import CAMERA, disc_depth

from debris_scanner.core.frames import DepthFrame
from debris_scanner.nodes.inputs.cameras import CAMERAS
from msg_adapters.bags import open_session
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message
from msg_adapters.stamps import header_message
from msg_adapters.target_frames import read_target_frame

pytestmark = pytest.mark.ros
SCAN = ROOT / 'launch' / 'scan.launch.py'
RELIABLE = QoSProfile(depth=10)
SENSOR = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Driver(NamedTuple):
    """What a driver sends: the topics of depth and camera_info, or of a cloud; and colour."""

    depth: str
    info: str
    encoding: str
    frame: str
    qos: QoSProfile
    colour: tuple[str, str, str] | None = None  # topic, encoding, frame
    padding: int = 0  # bytes behind each row
    info_qos: QoSProfile = RELIABLE


DRIVERS = {
    'realsense': Driver(
        '/camera/camera/depth/image_rect_raw',
        '/camera/camera/depth/camera_info',
        '16UC1',
        'camera_depth_optical_frame',
        RELIABLE,
        ('/camera/camera/color/image_raw', 'rgb8', 'camera_color_optical_frame'),
    ),
    'orbbec': Driver(
        '/camera/depth/image_raw',
        '/camera/depth/camera_info',
        '16UC1',
        'camera_color_optical_frame',
        SENSOR,
        ('/camera/color/image_raw', 'rgb8', 'camera_color_optical_frame'),
    ),
    'azure': Driver(
        '/depth/image_raw',
        '/depth/camera_info',
        '16UC1',
        'depth_camera_link',
        RELIABLE,
        ('/rgb_to_depth/image_raw', 'bgra8', 'depth_camera_link'),
    ),
    'openni2': Driver(
        '/camera/depth_registered/points', '', '', 'camera_rgb_optical_frame', SENSOR, padding=16
    ),
    'kinect': Driver(
        '/depth/image_raw',
        '/depth/camera_info',
        'mono16',
        'kinect_depth',
        RELIABLE,
        ('/image_raw', 'rgb8', 'kinect_rgb'),
        info_qos=LATCHED,
    ),
    'oak': Driver(
        '/oak/stereo/image_raw',
        '/oak/stereo/camera_info',
        '16UC1',
        'oak_rgb_camera_optical_frame',
        RELIABLE,
        ('/oak/rgb/image_raw', 'bgr8', 'oak_rgb_camera_optical_frame'),
        padding=64,
    ),
    'zed': Driver(
        '/zed/zed_node/depth/depth_registered',
        '/zed/zed_node/depth/camera_info',
        '32FC1',
        'zed_left_camera_frame_optical',
        RELIABLE,
        ('/zed/zed_node/rgb/color/rect/image', 'bgra8', 'zed_left_camera_frame_optical'),
    ),
}
COLOURED = {'orbbec', 'azure', 'oak', 'zed'}  # registered, by frame and size


def padded(message, padding):
    """The message with bytes behind each of its rows."""
    step = 'row_step' if isinstance(message, PointCloud2) else 'step'
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, -1)
    wide = np.pad(rows, ((0, 0), (0, padding)), constant_values=255)
    setattr(message, step, wide.shape[1])
    message.data = array('B', wide.tobytes())
    return message


def colour_of(encoding, frame, stamp):
    channels = 4 if encoding.endswith('a8') else 3
    image = Image(height=120, width=160, encoding=encoding, step=160 * channels)
    image.header.stamp, image.header.frame_id = stamp, frame
    image.data = array('B', bytes([200] * (120 * 160 * channels)))
    return image


class Preprocess(Launched):
    """Of a launch file the node that takes the sensor's frames, with what the launch gives it."""

    def start(self, node, arguments, environment):
        if node.executable == 'preprocess':
            super().start(node, arguments, environment)


@pytest.mark.parametrize('camera', DRIVERS)
def test_frames_of_each_driver_arrive_and_are_used(peer, monkeypatch, tmp_path, camera):
    driver = DRIVERS[camera]
    install(monkeypatch)
    targets = peer.listen(PointCloud2, 'target_points')
    create = peer.node.create_publisher
    depth = create(Image if driver.info else PointCloud2, driver.depth, driver.qos)
    info = create(CameraInfo, driver.info, driver.info_qos) if driver.info else None
    colour = create(Image, driver.colour[0], driver.qos) if driver.colour else None
    if driver.info_qos is LATCHED:
        info.publish(camera_info_message(0, driver.frame, CAMERA))  # once, before anybody listens
    with Preprocess(SCAN, {'camera': camera, 'out': str(tmp_path)}, tmp_path / 'launch'):
        stamps = itertools.count(peer.node.get_clock().now().nanoseconds, 33_000_000)

        def told():
            stamp_ns = next(stamps)
            if driver.info:
                message = depth_image_message(
                    stamp_ns, driver.frame, disc_depth(), driver.encoding.replace('mono16', '16UC1')
                )
                message.encoding = driver.encoding
            else:
                message = cloud_frame_message(DepthFrame(stamp_ns, disc_depth(), CAMERA), driver.frame)
            if colour is not None:
                colour.publish(colour_of(*driver.colour[1:], message.header.stamp))
            if info is not None and driver.info_qos is not LATCHED:
                info.publish(camera_info_message(stamp_ns, driver.frame, CAMERA))
            depth.publish(padded(message, driver.padding))
            peer.executor.spin_once(0.05)
            return peer.reports.get('preprocess') if len(targets) > 20 else None

        peer.until(told, 'targets')
        report = peer.until(lambda: peer.reports.get('preprocess'), 'a report')
        asked = peer.node.get_subscriptions_info_by_topic(driver.depth)
    frames = [read_target_frame(target) for target in targets[-10:]]
    frame = frames[-1]
    assert targets[-1].header.frame_id == driver.frame
    assert abs(np.median(frame.depth[frame.depth > 0]) - np.median(disc_depth()[disc_depth() > 0])) < 2e-3
    assert any(f.rgb is not None for f in frames) == (camera in COLOURED)
    assert set(report.rejected) <= {'settling', 'shed', 'no_camera_info'}, report.rejected
    assert [s.qos_profile.reliability for s in asked] == [driver.qos.reliability]  # as the publisher's


LIVOX = np.dtype(  # livox_ros_driver2, xfer_format 0: packed without alignment
    [
        ('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '<f4'),
        ('tag', 'u1'), ('line', 'u1'), ('timestamp', '<f8'),
    ]
)  # fmt: skip
SIZES = {'<f4': PointField.FLOAT32, '|u1': PointField.UINT8, '<f8': PointField.FLOAT64}


def livox_cloud(stamp_ns, depth):
    """A cloud as the driver sends it: one row, x forward, misses at the origin."""
    right, down, forward = CAMERA.back_project(depth).reshape(-1, 3).T
    points = np.zeros(depth.size, LIVOX)
    points['x'], points['y'], points['z'] = forward, -right, -down
    points['intensity'], points['timestamp'] = 30.0, float(stamp_ns)
    fields = [
        PointField(name=name, offset=LIVOX.fields[name][1], datatype=SIZES[kind], count=1)
        for name, kind in LIVOX.descr
    ]
    cloud = PointCloud2(height=1, width=len(points), fields=fields, point_step=LIVOX.itemsize, is_dense=True)
    cloud.row_step, cloud.data = points.nbytes, array('B', points.tobytes())
    cloud.header = header_message(stamp_ns, 'livox_frame')
    return cloud


def test_clouds_of_a_lidar_arrive_and_are_used(peer, monkeypatch, tmp_path):
    """Its frame's name tells no axes; the camera's name does."""
    install(monkeypatch)
    targets = peer.listen(PointCloud2, 'target_points')
    clouds = peer.node.create_publisher(PointCloud2, '/livox/lidar', RELIABLE)
    given = {'camera': 'livox', 'out': str(tmp_path)}
    with Preprocess(SCAN, given, tmp_path / 'launch'):
        stamps = itertools.count(peer.node.get_clock().now().nanoseconds, 100_000_000)

        def scanned():
            clouds.publish(livox_cloud(next(stamps), disc_depth()))
            peer.executor.spin_once(0.1)
            return len(targets) > 10

        peer.until(scanned, 'targets')
        report = peer.until(lambda: peer.reports.get('preprocess'), 'a report')
    frame = read_target_frame(targets[-1])
    assert targets[-1].header.frame_id == 'livox_frame'
    assert np.median(frame.depth[frame.depth > 0]) == pytest.approx(0.81, abs=5e-3)
    assert set(report.rejected) <= {'settling', 'shed'}, report.rejected


@pytest.mark.slow
def test_live_scans_a_realsense_by_its_name_alone(domain, peer, brief_bag, tmp_path):
    driver = DRIVERS['realsense']
    images = peer.node.create_publisher(Image, driver.depth, driver.qos)
    infos = peer.node.create_publisher(CameraInfo, driver.info, driver.info_qos)
    given = ['--camera', 'realsense', '--idle-seconds', '3']
    live = LiveRun(tmp_path / 'out', *given, ROS_DOMAIN_ID=str(domain))
    peer.until(lambda: images.get_subscription_count() and infos.get_subscription_count(), 'the scan', 90.0)
    peer.until(lambda: len(peer.reports) == 4, 'all nodes')
    with open_session(brief_bag) as session:
        for _, frame in session:
            due_s = time.monotonic() + 0.15
            stamp_ns = peer.node.get_clock().now().nanoseconds
            infos.publish(camera_info_message(stamp_ns, driver.frame, frame.camera))
            images.publish(depth_image_message(stamp_ns, driver.frame, frame.depth, driver.encoding))
            while time.monotonic() < due_s:
                peer.executor.spin_once(0.02)
    assert live.end() == 0, live.errors
    summary = live.summary
    assert (summary['result'], summary['reason']) == ('model', None)
    assert summary['frames']['rejected'].keys() <= {'settling', 'shed', 'lost_in_transport', 'not_registered'}


def test_the_documents_name_the_topics_of_each_camera():
    text = (ROOT / 'docs' / 'cameras.md').read_text()
    rows = dict(re.findall(r'^\| `camera:=(\w+)` \|(.*)$', text, re.MULTILINE))
    assert rows.keys() == CAMERAS.keys()
    for camera, topics in CAMERAS.items():
        assert re.findall(r'`(/\S+)`', rows[camera]) == list(topics.values())
