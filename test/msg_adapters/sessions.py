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

"""Small recorded sessions in every storage, written by rosbags or record by record."""

import struct
import zlib
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
from backports import zstd
from rclpy.serialization import serialize_message
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from msg_adapters.depth_images import camera_info_message, cloud_frame_message, depth_image_message

CAMERA = Camera(52.5, 52.5, 31.5, 23.5, 64, 48)
CLOUD, IMAGE, INFO = (f'sensor_msgs/msg/{name}' for name in ('PointCloud2', 'Image', 'CameraInfo'))
ROS2, ROS1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
Messages = list[tuple[str, str, int, bytes]]  # topic, type, bag time, CDR


def frames(n: int = 40) -> list[DepthFrame]:
    rng = np.random.default_rng(4)
    return [
        DepthFrame(
            10**18 + i * 33_000_000,
            rng.uniform(0.4, 1, (48, 64)).astype(np.float32),
            CAMERA,
            rng.integers(0, 256, (48, 64, 3), dtype=np.uint8),
        )
        for i in range(n)
    ]


def message(topic: str, content: Any, stamp_ns: int) -> tuple[str, str, int, bytes]:
    return topic, f'sensor_msgs/msg/{type(content).__name__}', stamp_ns, serialize_message(content)


def clouds(recorded: list[DepthFrame], topic: str = '/points') -> Messages:
    # the bag's time is a little later than the header's, as with every real recorder
    return [message(topic, cloud_frame_message(f, 'sensor'), f.stamp_ns + 5_000_000) for f in recorded]


def images(recorded: list[DepthFrame], namespace: str = '/camera/depth') -> Messages:
    return [
        entry
        for f in recorded
        for entry in (
            message(f'{namespace}/image_raw', depth_image_message(f.stamp_ns, 's', f.depth), f.stamp_ns + 1),
            message(f'{namespace}/camera_info', camera_info_message(f.stamp_ns, 's', CAMERA), f.stamp_ns + 2),
        )
    ]


def write_rosbag2(
    path: Path,
    messages: Messages,
    storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    writer = Writer2(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, stamp_ns, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=ROS2)
            writer.write(connections[topic], stamp_ns, data)
    return path


def write_rosbag1(path: Path, messages: Messages, compression: Any = None) -> Path:
    writer = Writer1(path)
    writer.chunk_threshold = 400_000
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections: dict[str, Any] = {}
        for topic, msgtype, stamp_ns, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=ROS1)
            writer.write(connections[topic], stamp_ns, ROS2.cdr_to_ros1(data, msgtype))
    return path


def mcap_bytes(messages: Messages, compression: str = '', per_chunk: int = 7) -> bytes:
    """An mcap as its specification says, up to its index; ``per_chunk`` 0 writes messages without chunks."""
    head = b'\x89MCAP0\r\n' + _record(0x01, _text('ros2') + _text('by hand'))
    body, records, times = b'', b'', []
    channels: dict[str, int] = {}
    pack = {'': bytes, 'zstd': zstd.compress, 'lz4': lz4.frame.compress}[compression]
    for n, (topic, msgtype, stamp_ns, data) in enumerate(messages, 1):
        if topic not in channels:
            channels[topic] = number = len(channels) + 1
            records += _record(
                0x03, struct.pack('<H', number) + _text(msgtype) + _text('ros2msg') + _text('')
            )
            records += _record(
                0x04, struct.pack('<HH', number, number) + _text(topic) + _text('cdr') + _text('')
            )
        records += _record(0x05, struct.pack('<HIQQ', channels[topic], n, stamp_ns, stamp_ns) + data)
        times.append(stamp_ns)
        if per_chunk and (n % per_chunk == 0 or n == len(messages)):
            packed = pack(records)
            chunk = struct.pack('<QQQI', min(times), max(times), len(records), zlib.crc32(records))
            body += _record(0x06, chunk + _text(compression) + struct.pack('<Q', len(packed)) + packed)
            records, times = b'', []
    end = _record(0x0F, bytes(4)) + _record(0x02, bytes(20)) + b'\x89MCAP0\r\n'
    return head + body + records + end


def ros1_active_bytes(messages: Messages, opened: int) -> bytes:
    """A ROS 1 bag as a crashed recorder leaves it: no index, and a last chunk of ``opened`` messages.

    That chunk's header says it is empty, because the recorder fills in the size when it closes it.
    """
    head = {'op': b'\x03', 'index_pos': bytes(8), 'conn_count': bytes(4), 'chunk_count': bytes(4)}
    content = b'#ROSBAG V2.0\n' + _ros1_record(head, b' ' * 4000)
    closed = _ros1_messages(messages[:-opened])
    content += _ros1_record(
        {'op': b'\x05', 'compression': b'none', 'size': struct.pack('<I', len(closed))}, closed
    )
    content += _ros1_record({'op': b'\x05', 'compression': b'none', 'size': bytes(4)}, b'')
    return content + _ros1_messages(messages[-opened:])


def _ros1_messages(messages: Messages) -> bytes:
    topics = sorted({(topic, msgtype) for topic, msgtype, _, _ in messages})
    records = b''
    for number, (topic, msgtype) in enumerate(topics):
        definition = {'topic': topic.encode(), 'type': msgtype.replace('/msg', '').encode(), 'md5sum': b'*'}
        header = {'op': b'\x07', 'conn': struct.pack('<I', number), 'topic': topic.encode()}
        records += _ros1_record(header, _ros1_header(definition))
    for topic, msgtype, stamp_ns, data in messages:
        number = topics.index((topic, msgtype))
        time = struct.pack('<II', *divmod(stamp_ns, 10**9))
        header = {'op': b'\x02', 'conn': struct.pack('<I', number), 'time': time}
        records += _ros1_record(header, bytes(ROS2.cdr_to_ros1(data, msgtype)))
    return records


def _ros1_record(header: dict[str, bytes], body: bytes) -> bytes:
    packed = _ros1_header(header)
    return struct.pack('<I', len(packed)) + packed + struct.pack('<I', len(body)) + body


def _ros1_header(fields: dict[str, bytes]) -> bytes:
    entries = [name.encode() + b'=' + value for name, value in fields.items()]
    return b''.join(struct.pack('<I', len(entry)) + entry for entry in entries)


def _record(op: int, body: bytes) -> bytes:
    return bytes([op]) + struct.pack('<Q', len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack('<I', len(text)) + text.encode()
