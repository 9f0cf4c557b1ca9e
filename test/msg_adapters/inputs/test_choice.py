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

"""Bags as other people's recorders write them: which topics belong together, and what is left out."""

import math

import numpy as np
import pytest
from sessions import CAMERA, CLOUD, IMAGE, INFO, ROS2, frames, images, message, write_rosbag1, write_rosbag2

from debris_scanner.core.camera import Camera
from msg_adapters.bags import BagError, open_session
from msg_adapters.clouds import cloud_message
from msg_adapters.colour_images import colour_image_message
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message
from msg_adapters.inputs.decoder import InputOptions

FRAMES = frames(4)
OTHER = Camera(61.0, 61.0, 31.5, 23.5, 64, 48)
SENSOR = '/device_0/sensor_0/Depth_0'
COLOUR = '/device_0/sensor_1/Color_0'


def colour_images(topic, frame_id, info=None):
    """Colour images beside FRAMES, with a camera_info of their own where a camera is given."""
    made = [message(topic, colour_image_message(f.stamp_ns, frame_id, f.rgb), f.stamp_ns + 3) for f in FRAMES]
    if info is not None:
        own = f'{topic.rpartition("/")[0]}/camera_info'
        made.append(message(own, camera_info_message(0, frame_id, info), FRAMES[0].stamp_ns))
    return made


def viewer_bag(unit=None, colour=OTHER):
    """What the RealSense Viewer's record button writes: names, encodings, frame ids and options."""
    start = FRAMES[0].stamp_ns
    made = [
        message(f'{SENSOR}/info/camera_info', _info(CAMERA), start),
        message(f'{COLOUR}/info/camera_info', _info(colour), start),
    ]
    if unit is not None:
        floats = ROS2.types['std_msgs/msg/Float32']
        for name, value in (('Depth_Units', unit), ('Stereo_Baseline', 50.1)):
            data = bytes(ROS2.serialize_cdr(floats(data=value), 'std_msgs/msg/Float32'))
            topic = f'/device_0/sensor_0/option/{name}/value'
            made.append((topic, 'std_msgs/msg/Float32', start, data))
    for f in FRAMES:
        depth = depth_image_message(f.stamp_ns, '0', f.depth, '16UC1')
        depth.encoding = 'mono16'
        made.append(message(f'{SENSOR}/image/data', depth, f.stamp_ns))
        made.append(message(f'{COLOUR}/image/data', colour_image_message(f.stamp_ns, '0', f.rgb), f.stamp_ns))
    return sorted(made, key=lambda m: m[2])


def _info(camera):
    info = camera_info_message(0, '', camera)
    info.distortion_model, info.p, info.r = 'Brown Conrady', [0.0] * 12, [0.0] * 9
    return info


@pytest.mark.parametrize('write', [write_rosbag1, write_rosbag2])
def test_what_the_realsense_viewer_records_is_scanned_without_the_other_cameras_colour(tmp_path, write):
    with open_session(write(tmp_path / 'viewer.bag', viewer_bag())) as session:
        assert (session.topic, session.info_topic) == (
            f'{SENSOR}/image/data',
            f'{SENSOR}/info/camera_info',
        )
        assert session.colour_topic is None
        read = [frame for _, frame in session]
        (said,) = session.warnings
    assert f'{COLOUR}/image/data is not used' in said
    assert 'another camera' in said
    for frame, true in zip(read, FRAMES, strict=True):
        assert frame.camera == CAMERA
        np.testing.assert_allclose(frame.depth, true.depth, atol=6e-4)
        assert frame.rgb is None


def test_colour_that_was_aligned_before_it_was_recorded_is_used(tmp_path):
    with open_session(write_rosbag2(tmp_path / 'bag', viewer_bag(colour=CAMERA))) as session:
        assert session.colour_topic == f'{COLOUR}/image/data'
        assert all(frame.rgb is not None for _, frame in session)


def test_the_depth_units_that_were_recorded_apply_unless_the_user_knows_better(tmp_path):
    bag = write_rosbag2(tmp_path / 'bag', viewer_bag(unit=0.0001))
    for options, factor in ((None, 0.1), (InputOptions(depth_scale=0.002), 2.0)):
        with open_session(bag, options=options) as session:
            _, frame = next(iter(session))
        np.testing.assert_allclose(frame.depth, factor * FRAMES[0].depth, atol=6e-4 * factor)


@pytest.mark.parametrize(
    ('frame_id', 'info', 'why'),
    [
        ('s', None, ''),
        ('s', CAMERA, ''),
        ('s', OTHER, 'its camera_info is of another camera'),
        ('other', None, 'seen from other, depth from s'),
    ],
)
def test_colour_of_the_depths_own_pixels_alone_is_used(tmp_path, frame_id, info, why):
    messages = images(FRAMES) + colour_images('/camera/rgb/image_raw', frame_id, info)
    with open_session(write_rosbag2(tmp_path / 'bag', sorted(messages, key=lambda m: m[2]))) as session:
        assert (session.colour_topic is None) == bool(why)
        assert why in ' '.join(session.warnings)


def infrared_images(topic, encoding):
    """Infrared beside FRAMES; Kinect v2's driver calls it 16UC1, as it does the depth."""
    made = []
    for k, f in enumerate(FRAMES):
        echo = colour_image_message(f.stamp_ns, 's', np.where(f.depth > 0, 400 + k, 0).astype(np.uint16))
        echo.encoding = encoding
        made.append(message(topic, echo, f.stamp_ns + 3))
    return made


@pytest.mark.parametrize('encoding', ['mono16', '16UC1'])
def test_infrared_is_the_picture_where_there_is_no_colour(tmp_path, encoding):
    infrared = infrared_images('/camera/ir/image_raw', encoding)
    for colour, topic in ((False, '/camera/ir/image_raw'), (True, '/camera/rgb/image_raw')):
        messages = images(FRAMES) + infrared
        messages += colour_images('/camera/rgb/image_raw', 's') if colour else []
        bag = write_rosbag2(tmp_path / f'{colour}', sorted(messages, key=lambda m: m[2]))
        with open_session(bag) as session:
            assert (session.topic, session.colour_topic) == ('/camera/depth/image_raw', topic)
            assert next(frame for _, frame in session).rgb is not None


def test_a_frame_without_a_name_tells_nothing(tmp_path):
    messages = [m for m in viewer_bag() if not m[0].startswith(f'{COLOUR}/info')]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert session.colour_topic is None
        assert "the frame '0' is no name" in session.warnings[0]


def test_a_camera_info_that_lies_nearer_to_other_images_is_theirs(tmp_path):
    messages = [m for m in images(FRAMES) if m[1] == IMAGE]
    messages += colour_images('/camera/color/image_raw', 'c', OTHER)
    messages.append(message('/lidar/camera_info', camera_info_message(0, 'c', OTHER), 1))
    with pytest.raises(BagError, match=r'/camera/depth/image_raw: none of .* lies in its namespace'):
        open_session(write_rosbag2(tmp_path / 'bag', sorted(messages, key=lambda m: m[2])))


def body_clouds(frame_id, topic='/points', flat=False):
    """Coloured clouds of FRAMES in body axes: x forward, y left, z up."""
    made = []
    for f in FRAMES:
        p = f.camera.back_project(f.depth)[..., [2, 0, 1]] * np.float32([1, -1, -1])
        p = p.reshape(-1, 3) if flat else p
        fields = {axis: np.ascontiguousarray(p[..., i]) for i, axis in enumerate('xyz')}
        rgb = None if flat else f.rgb
        made.append(message(topic, cloud_message(f.stamp_ns, frame_id, fields, rgb), f.stamp_ns))
    return made


def static_transforms(*links, topic='/tf_static'):
    """/tf_static of links (parent, child, quaternion, translation)."""
    t, kind = ROS2.types, 'tf2_msgs/msg/TFMessage'
    made = [
        t['geometry_msgs/msg/TransformStamped'](
            header=t['std_msgs/msg/Header'](
                stamp=t['builtin_interfaces/msg/Time'](sec=0, nanosec=0), frame_id=parent
            ),
            child_frame_id=child,
            transform=t['geometry_msgs/msg/Transform'](
                translation=t['geometry_msgs/msg/Vector3'](x=p[0], y=p[1], z=p[2]),
                rotation=t['geometry_msgs/msg/Quaternion'](x=q[0], y=q[1], z=q[2], w=q[3]),
            ),
        )
        for parent, child, q, p in links
    ]
    data = bytes(ROS2.serialize_cdr(t[kind](transforms=made), kind))
    return (topic, kind, FRAMES[-1].stamp_ns + 9, data)  # last: it was recorded late


OPTICAL = (-0.5, 0.5, -0.5, 0.5)  # of an optical frame in its camera's body frame
LINKS = (
    ('camera_link', 'lidar', (0.0, 0.0, 1.0, 0.0), (0.0, 0.1, 0.0)),  # half a turn about z
    ('camera_link', 'camera_depth_optical_frame', OPTICAL, (0.0, 0.0, 0.0)),
    ('camera_link', 'camera_color_optical_frame', OPTICAL, (0.0, 0.3, 0.0)),
)


def read(path, options=None):
    with open_session(path, options=options) as session:
        return [frame for _, frame in session], session.warnings


def same_surface(frame, true, atol=2e-3):
    """Whether a frame shows the true one: seen by its camera, or by the virtual one."""
    if frame.camera.width == true.camera.width:
        np.testing.assert_allclose(frame.depth, true.depth, atol=atol)
        np.testing.assert_array_equal(frame.rgb, true.rgb)
        return
    ours, theirs = (f.camera.back_project(f.depth).reshape(-1, 3) for f in (frame, true))
    for axis in range(3):
        np.testing.assert_allclose(
            np.nanpercentile(ours[:, axis], (5, 50, 95)),
            np.nanpercentile(theirs[:, axis], (5, 50, 95)),
            atol=0.02,
        )


def test_an_organised_cloud_in_body_axes_is_recognised_as_a_cameras_image(tmp_path):
    seen, said = read(write_rosbag2(tmp_path / 'bag', body_clouds('zed_left_camera_frame')))
    same_surface(seen[0], FRAMES[0])
    assert 'looks along +x' in said[0]


def test_the_depth_image_is_used_where_a_cloud_does_not_tell_its_axes(tmp_path):
    messages = images(FRAMES) + body_clouds('map', '/cloud', flat=True)
    with open_session(write_rosbag2(tmp_path / 'bag', sorted(messages, key=lambda m: m[2]))) as session:
        assert session.topic == '/camera/depth/image_raw'


def test_a_cloud_that_nothing_tells_the_axes_of_is_refused_by_its_frame(tmp_path):
    with pytest.raises(BagError, match=r"points of frame 'rig' lie along \+x: not an optical frame .*--axes"):
        read(write_rosbag2(tmp_path / 'bag', body_clouds('rig', flat=True)))


def test_a_body_frame_is_told_by_its_name(tmp_path):
    seen, said = read(write_rosbag2(tmp_path / 'bag', body_clouds('lidar_link', flat=True)))
    same_surface(seen[0], FRAMES[0])
    assert 'REP-103' in said[0]


def test_static_transforms_tell_the_axes_before_the_name_does(tmp_path):
    """The lidar looks backwards in its own frame, which is linked with two cameras."""
    points = []
    for f in FRAMES:
        p = f.camera.back_project(f.depth).reshape(-1, 3)[:, [2, 0, 1]] * np.float32([1, -1, -1])
        p = (p - np.float32([0, 0.1, 0])) * np.float32([-1, -1, 1])  # camera_link to lidar
        fields = {axis: np.ascontiguousarray(p[:, i]) for i, axis in enumerate('xyz')}
        points.append(message('/points', cloud_message(f.stamp_ns, 'lidar', fields), f.stamp_ns))
    seen, said = read(write_rosbag2(tmp_path / 'bag', [*points, static_transforms(*LINKS)]))
    same_surface(seen[0], FRAMES[0])
    assert 'camera_depth_optical_frame' in said[0]


@pytest.mark.parametrize('axes', ['-y,-z,x', ' -y, -z, +x '])
def test_axes_that_the_user_gives_are_taken_before_all_else(tmp_path, axes):
    bag = write_rosbag2(tmp_path / 'bag', body_clouds('some_optical_frame', flat=True))
    seen, _ = read(bag, InputOptions(axes=axes))
    same_surface(seen[0], FRAMES[0])


def test_axes_that_are_none_are_refused_in_one_line(tmp_path):
    bag = write_rosbag2(tmp_path / 'bag', body_clouds('rig', flat=True))
    for axes in ('x,y', 'x,x,z', 'x,y,-z', 'x,y,q', 'x,y,0.5.1-z'):
        with pytest.raises(BagError, match=r'axes') as refusal:
            open_session(bag, options=InputOptions(axes=axes))
        assert '\n' not in str(refusal.value)


def test_a_scale_applies_to_clouds_too(tmp_path):
    scaled = []
    for f in FRAMES:
        p = 1000 * f.camera.back_project(f.depth)
        fields = {axis: np.ascontiguousarray(p[..., i]) for i, axis in enumerate('xyz')}
        scaled.append(message('/points', cloud_message(f.stamp_ns, 'optical', fields), f.stamp_ns))
    seen, _ = read(write_rosbag2(tmp_path / 'bag', scaled), InputOptions(depth_scale=0.001))
    np.testing.assert_allclose(seen[0].depth, FRAMES[0].depth, atol=1e-6)


def test_a_stale_row_step_costs_nothing_where_every_byte_is_there(tmp_path):
    messages = []
    for f, row_step in zip(FRAMES, (0, 1, 99_999, 64 * 16), strict=True):
        cloud = cloud_frame_message(f, 's')
        cloud.row_step = row_step
        messages.append(message('/points', cloud, f.stamp_ns))
    seen, _ = read(write_rosbag2(tmp_path / 'bag', messages))
    for frame, true in zip(seen, FRAMES, strict=True):
        np.testing.assert_array_equal(frame.depth, true.depth)


def test_a_camera_info_of_another_size_is_the_reason(tmp_path):
    messages = [
        message(topic, camera_info_message(ns, 's', Camera(90.0, 90.0, 47.5, 31.5, 96, 64)), ns)
        if kind == INFO
        else (topic, kind, ns, data)
        for topic, kind, ns, data in images(FRAMES)
    ]
    seen, _ = read(write_rosbag2(tmp_path / 'bag', messages))
    assert {frame.reason for frame in seen} == {'camera_info'}
    assert {str(frame) for frame in seen} == {'camera_info is of 96x64, the image has 64x48'}


def test_the_frame_of_a_lens_keeps_its_colour(tmp_path):
    messages = []
    for topic, kind, ns, data in images(FRAMES):
        info = camera_info_message(ns, 's', CAMERA)
        info.d = [-0.05, 0.01, 0.0, 0.0, 0.0]
        messages.append(message(topic, info, ns) if kind == INFO else (topic, kind, ns, data))
    messages += colour_images('/camera/rgb/image_raw', 's')
    seen, _ = read(write_rosbag2(tmp_path / 'bag', sorted(messages, key=lambda m: m[2])))
    for frame in seen:
        assert frame.depth.shape == frame.rgb.shape[:2] == (frame.camera.height, frame.camera.width)
        assert frame.rgb.any(axis=-1)[frame.depth > 0].mean() > 0.99
        assert math.isclose(frame.camera.fx, CAMERA.fx)


def test_the_real_bags_of_other_recorders(shared_data):
    bags = shared_data / 'real' / 'bags'
    if not bags.is_dir():
        pytest.skip('no real bags there')
    with open_session(bags / 'librealsense_sdk' / 'single_depth_color_640x480.bag') as session:
        seen = [frame for _, frame in session]
        assert session.topic == f'{SENSOR}/image/data'
        assert session.colour_topic is None
        assert 'another camera' in session.warnings[0]
    assert [round(frame.camera.fx, 2) for frame in seen] == [390.43] * 2
    with pytest.raises(BagError, match=r"frame 'luminar_lidar' lie along \+y"):
        open_session(bags / 'embag' / 'test.bag')
    with open_session(bags / 'ros_numpy' / 'test.bag') as session:
        assert all(frame.depth.any() for _, frame in session)
    assert CLOUD
