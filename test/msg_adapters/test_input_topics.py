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

import numpy as np
import pytest
from sensor_msgs.msg import Image
from sessions import CAMERA, clouds, frames, images, message, write_rosbag2

from msg_adapters.bags import BagError, open_session
from msg_adapters.clouds import cloud_message
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message

FRAMES = frames(4)
PLAIN = [type(f)(f.stamp_ns, f.depth, f.camera) for f in FRAMES]


def unorganised(topic: str, n: int = 4):
    points = {axis: np.ones(50, np.float32) for axis in 'xyz'}
    return [message(topic, cloud_message(i, 'lidar', points), i) for i in range(n)]


def colour_images(topic: str, n: int = 4):
    return [
        message(topic, Image(height=1, width=1, encoding='rgb8', step=3, data=[0, 0, 0]), i) for i in range(n)
    ]


def chosen(tmp_path, messages, topic=None):
    messages = sorted(messages, key=lambda m: m[2])
    with open_session(write_rosbag2(tmp_path / 'bag', messages), topic) as session:
        assert session.count == len(list(session))
        return session.topic


def test_the_best_topic_is_chosen_and_each_next_best_without_it(tmp_path):
    by_rank = {
        '/registered/points': clouds(FRAMES, '/registered/points'),
        '/depth/points': clouds(PLAIN, '/depth/points'),
        '/camera/depth/image_raw': images(FRAMES) + colour_images('/camera/rgb/image_raw'),
        '/lidar/points': unorganised('/lidar/points'),
    }
    while by_rank:
        best, *_ = by_rank
        (folder := tmp_path / str(len(by_rank))).mkdir()
        assert chosen(folder, [m for messages in by_rank.values() for m in messages]) == best
        del by_rank[best]


def test_among_equals_the_fullest_topic_then_the_first_by_name(tmp_path):
    (tmp_path / 'fullest').mkdir()
    (tmp_path / 'equal').mkdir()
    assert chosen(tmp_path / 'fullest', clouds(FRAMES[:2], '/a') + clouds(FRAMES, '/b')) == '/b'
    assert chosen(tmp_path / 'equal', clouds(FRAMES, '/b') + clouds(FRAMES, '/a')) == '/a'


def test_our_own_results_in_a_bag_are_no_inputs(tmp_path):
    results = [
        m for name in ('target_points', 'keyframe_points', 'model') for m in clouds(FRAMES, f'/scan/{name}')
    ]
    assert chosen(tmp_path, results + images(FRAMES)) == '/camera/depth/image_raw'


def test_a_topic_that_is_named_is_taken_with_or_without_its_slash(tmp_path):
    everything = clouds(FRAMES) + images(FRAMES) + clouds(FRAMES, '/scan/target_points')
    for i, topic in enumerate(['/camera/depth/image_raw', 'camera/depth/image_raw', '/scan/target_points']):
        (tmp_path / str(i)).mkdir()
        assert chosen(tmp_path / str(i), everything, topic) == f'/{topic.lstrip("/")}'


def test_a_depth_image_takes_the_camera_info_of_its_namespace(tmp_path):
    wide = CAMERA.__class__(30.0, 30.0, 31.5, 23.5, 64, 48)
    messages = images(FRAMES, '/left/depth')
    messages += [
        message('/color/camera_info', camera_info_message(0, 'c', wide), m[2]) for m in messages[::2]
    ]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert session.info_topic == '/left/depth/camera_info'
        assert {frame.camera for _, frame in session} == {CAMERA}


def test_an_only_camera_info_belongs_to_the_images_of_any_namespace(tmp_path):
    messages = [
        message('/info', camera_info_message(0, 'c', CAMERA), 1),
        message('/depth/image', depth_image_message(5, 'c', FRAMES[0].depth), 2),
    ]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert [frame.camera for _, frame in session] == [CAMERA]


def test_two_camera_infos_elsewhere_leave_a_depth_image_without_one(tmp_path):
    messages = [message(f'/{name}/camera_info', camera_info_message(0, 'c', CAMERA), 1) for name in 'ab']
    messages.append(message('/depth/image', depth_image_message(5, 'c', FRAMES[0].depth), 2))
    with pytest.raises(BagError, match='no cloud, and no depth image with a camera_info'):
        open_session(write_rosbag2(tmp_path / 'bag', messages))


@pytest.mark.parametrize(
    ('topic', 'named'),
    [
        (None, 'has no cloud, and no depth image'),
        ('/missing', 'no clouds or images on /missing'),
        ('/rgb/camera_info', 'no clouds or images on /rgb/camera_info'),
        ('/rgb/image_raw', '/rgb/image_raw of .* is no depth image'),
    ],
)
def test_without_a_usable_topic_those_there_are_get_named(tmp_path, topic, named):
    messages = colour_images('/rgb/image_raw')
    messages.append(message('/rgb/camera_info', camera_info_message(0, 'c', CAMERA), 9))
    with pytest.raises(BagError, match=named) as error:
        open_session(write_rosbag2(tmp_path / 'bag', messages), topic)
    assert '/rgb/image_raw (sensor_msgs/msg/Image), /rgb/camera_info (sensor_msgs/msg/CameraInfo)' in str(
        error.value
    ) or (
        '/rgb/camera_info (sensor_msgs/msg/CameraInfo), /rgb/image_raw (sensor_msgs/msg/Image)'
        in str(error.value)
    )


def test_a_broken_first_message_does_not_hide_a_topic(tmp_path):
    messages = clouds(FRAMES)
    messages[0] = (*messages[0][:3], b'\x00\x01\x00\x00')
    assert chosen(tmp_path, messages) == '/points'


def test_colour_is_told_by_the_fields(tmp_path):
    assert 'rgb' in [f.name for f in cloud_frame_message(FRAMES[0], 's').fields]
    assert 'rgb' not in [f.name for f in cloud_frame_message(PLAIN[0], 's').fields]
