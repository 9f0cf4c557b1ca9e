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

"""Which messages make a frame, and which frames lack one; the node is a stub."""

from collections import defaultdict
from types import SimpleNamespace

import pytest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, INFO, MASK, POINTS
from debris_scanner.nodes.inputs.synchroniser import COMPRESSED, NO_CAMERA_INFO, NO_MASK, FrameSynchroniser
from debris_scanner.nodes.lifecycle import qos
from msg_adapters.stamps import header_message

MS = 1_000_000


class Sensor:
    """Sends messages to a synchroniser, and keeps what it makes of them."""

    def __init__(self):
        self.frames, self.left_out, self.callbacks = [], [], {}
        self.publishers = defaultdict(int)
        node = SimpleNamespace(
            receive=self._receive,
            resolve_topic_name=lambda name, only_expand=False: name,
            count_publishers=self.publishers.__getitem__,
            create_timer=lambda _s, _callback: None,
        )
        self.synchroniser = FrameSynchroniser(
            node,
            *('auto', qos.BEST_AVAILABLE, 5),
            lambda messages, _ns: self.frames.append(messages),
            lambda reason, _why: self.left_out.append(reason),
            lambda: None,
        )

    def _receive(self, _kind, topic, callback, _profile, _drained=None):
        self.callbacks[topic] = callback
        return SimpleNamespace(topic_name=topic, received=0)

    def send(self, topic, kind=Image, stamp_ns=0):
        message = kind(header=header_message(stamp_ns, 'camera'))
        self.callbacks[topic](message, stamp_ns)
        return message


@pytest.fixture
def sensor():
    return Sensor()


def test_images_wait_for_the_first_camera_info_and_the_oldest_give_way(sensor):
    images = [sensor.send(DEPTH, stamp_ns=k * 100 * MS) for k in range(12)]
    assert sensor.frames == [] and sensor.left_out == [NO_CAMERA_INFO] * 2
    info = sensor.send(INFO, CameraInfo)
    assert sensor.synchroniser.info is info
    assert [messages.depth for messages in sensor.frames] == images[2:]


def test_the_nearest_mask_and_colour_belong_to_a_depth_image(sensor):
    sensor.send(INFO, CameraInfo)
    for stamp_ns in (0, 100 * MS):
        mask, colour = sensor.send(MASK, stamp_ns=stamp_ns), sensor.send(COLOUR, stamp_ns=stamp_ns + 8 * MS)
    depth = sensor.send(DEPTH, stamp_ns=100 * MS)
    (frame,) = sensor.frames
    assert (frame.topic, frame.depth, frame.mask, frame.colour) == (DEPTH, depth, mask, colour)


def test_a_frame_without_a_mask_is_left_out_once_masks_are_published(sensor):
    sensor.send(POINTS, PointCloud2)
    sensor.publishers[MASK] = 1
    sensor.send(POINTS, PointCloud2, 100 * MS)
    assert len(sensor.frames) == 1 and sensor.left_out == [NO_MASK]


def test_a_compressed_image_counts_only_where_nobody_publishes_the_raw_one(sensor):
    sensor.send(INFO, CameraInfo)
    sensor.send(COMPRESSED, CompressedImage)
    sensor.publishers[DEPTH] = 1
    sensor.send(COMPRESSED, CompressedImage)
    assert [messages.topic for messages in sensor.frames] == [COMPRESSED]
