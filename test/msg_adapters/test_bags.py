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

"""Depth frames from bags of every storage, and the choice of their topic."""

import dataclasses

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from sensor_msgs.msg import CameraInfo, Image
from sessions import (
    CAMERA,
    CLOUD,
    IMAGE,
    INFO,
    ROS1,
    ROS2,
    clouds,
    frames,
    images,
    mcap_bytes,
    message,
    write_rosbag1,
    write_rosbag2,
)

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import MonotonicStamps
from msg_adapters.bags import BagError, open_bag, open_session
from msg_adapters.clouds import cloud_message
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message
from msg_adapters.errors import MalformedMessage

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


def test_a_camera_info_that_cannot_be_read_is_no_fault_of_the_images(tmp_path):
    messages = [
        (topic, kind, ns, data[:40] if kind == INFO else data) for topic, kind, ns, data in images(frames(3))
    ]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        refused = [frame.reason for _, frame in session]
    assert refused == ['camera_info'] * 3


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


BAGS_FRAMES = frames(12)
BZ2, LZ4 = Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4
STORAGES = {
    'mcap': lambda p, m: write_rosbag2(p / 'bag', m),
    'mcap zstd chunks': lambda p, m: write_rosbag2(p / 'bag', m, compression=CompressionMode.STORAGE),
    'mcap zstd messages': lambda p, m: write_rosbag2(p / 'bag', m, compression=CompressionMode.MESSAGE),
    'mcap zstd file': lambda p, m: write_rosbag2(p / 'bag', m, compression=CompressionMode.FILE),
    'bare mcap': lambda p, m: next(write_rosbag2(p / 'bag', m).glob('*.mcap')),
    'sqlite3': lambda p, m: write_rosbag2(p / 'bag', m, StoragePlugin.SQLITE3),
    'sqlite3 zstd messages': lambda p, m: write_rosbag2(
        p / 'bag', m, StoragePlugin.SQLITE3, CompressionMode.MESSAGE
    ),
    'bare sqlite3': lambda p, m: next(write_rosbag2(p / 'bag', m, StoragePlugin.SQLITE3).glob('*.db3')),
    'ros1': lambda p, m: write_rosbag1(p / 'old.bag', m),
    'ros1 bz2': lambda p, m: write_rosbag1(p / 'old.bag', m, BZ2),
    'ros1 lz4': lambda p, m: write_rosbag1(p / 'old.bag', m, LZ4),
}


@pytest.mark.parametrize('storage', STORAGES)
@pytest.mark.parametrize('kind', [clouds, images])
def test_every_storage_gives_the_same_frames(tmp_path, storage, kind):
    path = STORAGES[storage](tmp_path, kind(BAGS_FRAMES))
    with open_session(path) as session:
        assert session.count == len(BAGS_FRAMES)
        for _ in range(2):  # each iteration starts anew
            read = list(session)
            assert [stamp for stamp, _ in read] == [f.stamp_ns for f in BAGS_FRAMES]
            for (_, frame), expected in zip(read, BAGS_FRAMES, strict=True):
                assert isinstance(frame, DepthFrame)
                assert frame.stamp_ns == expected.stamp_ns
                np.testing.assert_array_equal(frame.depth, expected.depth)
                assert frame.camera.fx == pytest.approx(CAMERA.fx, abs=1e-3)
                if kind is clouds:
                    np.testing.assert_array_equal(frame.rgb, expected.rgb)
        assert session.warnings == []


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'mcap zstd messages'])
def test_a_player_gets_the_bytes_as_they_were_recorded(tmp_path, storage):
    messages = images(BAGS_FRAMES) + clouds(BAGS_FRAMES)
    with open_bag(STORAGES[storage](tmp_path, messages)) as bag:
        assert [tuple(m) for m in bag.messages()] == sorted(messages, key=lambda m: m[2])
        assert {(c.topic, c.msgtype, c.count) for c in bag.channels} == {
            (topic, kind, 12) for topic, kind, _, _ in messages
        }
        assert [m.topic for m in bag.messages({'/points'})] == ['/points'] * 12
        assert list(bag.messages({'/nothing'})) == []
        assert all(type(m.data) is bytes for m in bag.messages())  # the one type that publish() takes


def test_a_ros1_bag_is_played_as_ros2(tmp_path):
    messages = images(BAGS_FRAMES)
    with open_bag(write_rosbag1(tmp_path / 'old.bag', messages)) as bag:
        for played, (topic, msgtype, stamp_ns, data) in zip(bag.messages(), messages, strict=True):
            assert (played.topic, played.msgtype, played.stamp_ns) == (topic, msgtype, stamp_ns)
            kind = Image if msgtype == IMAGE else CameraInfo
            assert deserialize_message(played.data, kind) == deserialize_message(data, kind)


def test_a_topic_with_several_publishers_is_one(tmp_path):
    with Writer1(tmp_path / 'old.bag') as bag:
        publishers = [
            bag.add_connection('/points', CLOUD, typestore=ROS1, callerid=name) for name in ('/a', '/b')
        ]
        for i, (_, msgtype, stamp_ns, data) in enumerate(clouds(BAGS_FRAMES)):
            bag.write(publishers[i % 2], stamp_ns, ROS2.cdr_to_ros1(data, msgtype))
    with open_session(tmp_path / 'old.bag') as session:
        assert session.count == 12
        assert [stamp for stamp, _ in session] == [f.stamp_ns for f in BAGS_FRAMES]


def test_malformed_messages_are_handed_on_and_do_not_end_the_session(tmp_path):
    messages = clouds(BAGS_FRAMES)
    short = cloud_frame_message(BAGS_FRAMES[3], 'sensor')
    short.data = short.data[:-1]
    messages[3] = message('/points', short, messages[3][2])
    messages[7] = ('/points', CLOUD, messages[7][2], b'\x00\x01\x00\x00garbage')
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        read = list(session)
    assert [i for i, (_, frame) in enumerate(read) if isinstance(frame, MalformedMessage)] == [3, 7]
    assert read[3][0] == BAGS_FRAMES[3].stamp_ns
    assert 'bytes announced' in str(read[3][1])
    assert read[7][0] == messages[7][2]  # no header to be had: the bag's own time
    assert 'cannot be decoded' in str(read[7][1])


def test_an_image_recorded_before_its_camera_info_is_seen_by_the_first(tmp_path):
    messages = images(BAGS_FRAMES)
    assert messages[0][0].endswith('image_raw')
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert all(isinstance(frame, DepthFrame) for _, frame in session)
        assert next(iter(session))[1].camera == CAMERA


def test_an_uncalibrated_camera_rejects_every_frame(tmp_path):
    messages = images(BAGS_FRAMES)
    for i in range(1, len(messages), 2):
        info = camera_info_message(0, 's', CAMERA)
        info.k = [0.0] * 9
        messages[i] = message(messages[i][0], info, messages[i][2])
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        read = list(session)
    assert len(read) == 12
    assert all('no usable intrinsics' in str(frame) for _, frame in read)


def test_a_camera_that_changes_is_followed(tmp_path):
    zoomed = CAMERA.__class__(80.0, 80.0, 31.5, 23.5, 64, 48)
    messages = [
        message('/depth/camera_info', camera_info_message(0, 's', CAMERA), 1),
        message('/depth/image', depth_image_message(10, 's', BAGS_FRAMES[0].depth), 2),
        message('/depth/camera_info', camera_info_message(0, 's', zoomed), 3),
        message('/depth/image', depth_image_message(20, 's', BAGS_FRAMES[1].depth), 4),
    ]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert [frame.camera for _, frame in session] == [CAMERA, zoomed]


def test_split_files_are_one_session_in_order_of_time(tmp_path):
    messages = clouds(BAGS_FRAMES)
    folder = tmp_path / 'bag'
    folder.mkdir()
    for i, part in ((0, messages[:4]), (2, messages[4:8]), (10, messages[8:])):
        (folder / f'bag_{i}.mcap').write_bytes(mcap_bytes(part))
    with open_session(folder) as session:
        assert [stamp for stamp, _ in session] == [f.stamp_ns for f in BAGS_FRAMES]


@pytest.mark.parametrize(
    ('make', 'named'),
    [
        (lambda p: None, 'does not exist'),
        (lambda p: p.write_bytes(b''), 'is empty'),
        (lambda p: p.write_bytes(b'hello world, this is no bag'), 'is not a bag'),
        (lambda p: p.mkdir(), 'is not a bag: no readable metadata.yaml'),
        (lambda p: (p.mkdir(), (p / '1.png').touch()), 'depth images become one by debris-scan import'),
        (lambda p: p.write_bytes(b'\x89MCAP0\r\n'), 'holds no messages that can be read'),
        (lambda p: p.write_bytes(b'#ROSBAG V2.0\n'), 'holds no messages that can be read'),
        (lambda p: p.write_bytes(b'SQLite format 3\x00' + bytes(84)), 'no readable rosbag2 sqlite3'),
        (lambda p: p.write_bytes(mcap_bytes([])), 'holds no messages'),
        (lambda p: write_rosbag2(p, []), 'holds no messages'),
    ],
)
def test_what_is_no_bag_is_refused_in_one_line(tmp_path, make, named):
    path = tmp_path / 'thing'
    make(path)
    with pytest.raises(BagError, match=named) as error:
        open_session(path)
    assert str(path) in str(error.value)
    assert '\n' not in str(error.value)


def with_stamps(moved_s, bag_moved_s=lambda k: 0):
    """The frames, their stamps and the bag's time moved by so many seconds each."""
    sent = []
    for k, f in enumerate(BAGS_FRAMES):
        cloud = cloud_frame_message(f, 'sensor')
        cloud.header.stamp.sec += moved_s(k)
        sent.append(message('/points', cloud, f.stamp_ns + bag_moved_s(k) * 10**9 + 7))
    return sorted(sent, key=lambda m: m[2])


def used(session):
    """Numbers of the frames whose time has gone on, and their stamps."""
    depths, found = [f.depth.tobytes() for f in BAGS_FRAMES], []
    for stamp_ns, frame in session:
        if isinstance(frame, DepthFrame) and (not found or stamp_ns > found[-1][1]):
            assert frame.stamp_ns == stamp_ns
            found.append((depths.index(frame.depth.tobytes()), stamp_ns))
    return [k for k, _ in found], [stamp_ns for _, stamp_ns in found]


@pytest.mark.parametrize('damaged', [0, 5, 11])
def test_a_damaged_stamp_costs_only_its_frame(tmp_path, damaged):
    """Taken for true it would bar all later frames."""
    sent = with_stamps(lambda k: 2**26 if k == damaged else 0)
    with open_session(write_rosbag2(tmp_path / 'bag', sent)) as session:
        numbers, stamps = used(session)
        assert session.warnings == []
    assert numbers == [k for k in range(12) if k != damaged]
    assert stamps == [BAGS_FRAMES[k].stamp_ns for k in numbers]


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
@pytest.mark.parametrize('jump_s', [3600, 86400, 2**29, -3600, -86400, -(2**29)])
def test_stamps_that_jump_go_on_by_the_bags_time(tmp_path, storage, jump_s):
    sent = with_stamps(lambda k: 0 if k < 6 else jump_s)
    with open_session(STORAGES[storage](tmp_path, sent)) as session:
        for _ in range(2):
            numbers, stamps = used(session)
            assert numbers == [0, 1, 2, 3, 4, 5, 8, 9, 10, 11]
            assert np.abs(np.array(stamps) - [BAGS_FRAMES[k].stamp_ns for k in numbers]).max() < 100
            way = 'back' if jump_s < 0 else 'forward'
            assert [f'jumped {way}' in line for line in session.warnings] == [True]


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3', 'ros1'])
@pytest.mark.parametrize('jump_s', [86400, 2**28, -86400, -(2**28)])
def test_where_stamps_and_the_bags_time_jump_together_there_is_a_gap(tmp_path, storage, jump_s):
    def moved(k):
        return 0 if k < 6 else jump_s

    with open_session(STORAGES[storage](tmp_path, with_stamps(moved, moved))) as session:
        numbers, stamps = used(session)
        assert session.warnings == []
    first, then = range(6), range(6, 12)
    assert numbers == ([*first, *then] if jump_s > 0 else [*then, *first])
    assert stamps == [BAGS_FRAMES[k].stamp_ns + moved(k) * 10**9 for k in numbers]


def test_a_kinect_s_millimetres_may_be_called_mono16(tmp_path):
    sent = []
    for f in BAGS_FRAMES:
        image = depth_image_message(f.stamp_ns, 's', f.depth, '16UC1')
        image.encoding = 'mono16'
        info = camera_info_message(f.stamp_ns, 's', CAMERA)
        for name in ('infra', 'depth'):
            sent += [
                message(f'/{name}/image_raw', image, f.stamp_ns),
                message(f'/{name}/camera_info', info, f.stamp_ns),
            ]
    with open_session(write_rosbag2(tmp_path / 'bag', sent)) as session:
        assert session.topic == '/depth/image_raw'
        assert all(isinstance(frame, DepthFrame) for _, frame in session)


def test_a_frame_that_was_delivered_twice_is_left_out_and_counted(tmp_path):
    """Recorders poll faster than the sensor measures: the same image comes again, under a new stamp."""
    twice = [m for f in BAGS_FRAMES for again in (0, 8_000_000) for m in images([replaced(f, again)])]
    with open_session(write_rosbag2(tmp_path / 'bag', twice)) as session:
        for _ in range(2):
            read = [frame for _, frame in session]
            refused = [frame for frame in read if isinstance(frame, MalformedMessage)]
            assert len(read) == 2 * len(refused) == 2 * len(BAGS_FRAMES)
            assert {frame.reason for frame in refused} == {'duplicate'}
            assert 'it was sent twice' in str(refused[0])


def test_frames_without_any_depth_are_no_duplicates(tmp_path):
    empty = [DepthFrame(f.stamp_ns, np.zeros((48, 64), np.float32), CAMERA) for f in BAGS_FRAMES]
    with open_session(write_rosbag2(tmp_path / 'bag', images(empty))) as session:
        assert not any(isinstance(frame, MalformedMessage) for _, frame in session)


@pytest.mark.parametrize('wrap', ['32 bit', 'domain'])
def test_a_clock_that_wraps_or_changes_its_domain_costs_what_it_costs_live(tmp_path, wrap):
    """Microseconds in 32 bits wrap after 71.6 minutes; a driver begins with the device's time."""
    recorded, start = frames(20), 10**18
    stamps = [start + k * 33_000_000 for k in range(20)]
    moved = [s - 2**32 * 1000 for s in stamps] if wrap == '32 bit' else stamps
    early = stamps if wrap == '32 bit' else [s - start + 10**9 for s in stamps]
    messages = [
        message(
            '/points', cloud_frame_message(replaced(f, 0, early[k] if k < 8 else moved[k]), 's'), stamps[k]
        )
        for k, f in enumerate(recorded)
    ]
    live = MonotonicStamps()
    placed = [live.place(early[k] if k < 8 else moved[k], k * 0.033) for k in range(20)]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        read = list(session)
        assert len(session.warnings) == 1
    assert not any(isinstance(frame, MalformedMessage) for _, frame in read)
    assert [stamp for stamp, _ in read] == pytest.approx(placed, abs=10**6)
    late = [k for k in range(1, 20) if read[k][0] <= max(stamp for stamp, _ in read[:k])]
    assert late == [8, 9]  # until it is known that the clock, not one stamp, is another
    assert read[-1][0] - read[0][0] == pytest.approx(19 * 33_000_000, abs=10**7)
    assert 'stamps jumped' in session.warnings[0]


def replaced(frame, later_ns, stamp_ns=None):
    return dataclasses.replace(frame, stamp_ns=(stamp_ns or frame.stamp_ns) + later_ns)
