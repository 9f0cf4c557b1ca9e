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

"""A bag that is played again: only the stamps change."""

import struct
from types import SimpleNamespace

import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.nodes.play_bag import LONGEST_PAUSE_S, PlayBagNode, restamped
from msg_adapters.depth_images import camera_info_message
from msg_adapters.stamps import read_stamp


@pytest.mark.parametrize('shift_ns', [1, 600_000_000, 7_200_000_000])
def test_a_played_again_message_differs_in_its_stamp_alone(shift_ns):
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import CameraInfo

    camera = Camera(525.0, 525.0, 319.5, 239.5, 640, 480)
    msg = camera_info_message(1_999_999_999, 'sensor', camera)
    moved = deserialize_message(restamped(serialize_message(msg), shift_ns), CameraInfo)
    assert read_stamp(moved.header.stamp) == 1_999_999_999 + shift_ns
    moved.header.stamp = msg.header.stamp
    assert moved == msg


def test_a_big_endian_message_is_moved_too():
    data = b'\0\0\0\0' + struct.pack('>iI', 5, 7) + b'rest'
    assert restamped(data, 10**9) == b'\0\0\0\0' + struct.pack('>iI', 6, 7) + b'rest'


@pytest.mark.parametrize('rate', [1.0, 10.0])
def test_a_clock_that_was_set_is_not_slept_through(rate):
    said = []
    node = SimpleNamespace(_rate=rate, get_logger=lambda: SimpleNamespace(warning=said.append))
    for waited_s in (-1.0, 0.1, 25.0, LONGEST_PAUSE_S - 1):
        assert PlayBagNode._skip(node, round(waited_s * rate * 1e9)) == 0
    assert not said
    for jump_ns in (3600 * 10**9, 86400 * 10**9, -3600 * 10**9, 50 * 31_557_600 * 10**9):
        assert PlayBagNode._skip(node, jump_ns) == jump_ns
    assert len(said) == 4
