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

"""compressedDepth as compressed_depth_image_transport sends it, in a bag and by hand."""

import io
import struct

import numpy as np
import pytest
from PIL import Image as PillowImage
from sensor_msgs.msg import CompressedImage
from sessions import IMAGE, frames, images, message, write_rosbag2

from msg_adapters.bags import BagError, open_session
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.compressed import decompressed
from msg_adapters.stamps import header_message

FRAMES = frames(4)
A, B = 100.0, 8.0  # depthParam: quantisation of inverse depth


def packed(kind, pixels, **options):
    file = io.BytesIO()
    PillowImage.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def compressed(stamp_ns, format_, data):
    return CompressedImage(header=header_message(stamp_ns, 's'), format=format_, data=data)


def millimetres(frame, head=struct.pack('<iff', 0, 0.0, 0.0)):
    data = head + packed('PNG', np.rint(frame.depth * 1000).astype(np.uint16))
    return compressed(frame.stamp_ns, '16UC1; compressedDepth png', data)


def inverse(frame):
    """As the transport does it: depthQuantA / depth + depthQuantB, rounded down to 16 bit."""
    a, b = A * (A + 1), 1 - A * (A + 1) / 10.0
    values = np.where(frame.depth > 0, a / np.maximum(frame.depth, 1e-6) + b, 0)
    data = struct.pack('<iff', 0, a, b) + packed('PNG', values.astype(np.uint16))
    return compressed(frame.stamp_ns, '32FC1; compressedDepth png', data)


def bag_of(tmp_path, make):
    """A bag whose depth images are compressed, with their camera_info where drivers put it."""
    messages = []
    for entry in images(FRAMES):
        if entry[1] == IMAGE:
            frame = next(f for f in FRAMES if f.stamp_ns + 1 == entry[2])
            entry = message(f'{entry[0]}/compressedDepth', make(frame), entry[2])
        messages.append(entry)
    return write_rosbag2(tmp_path / 'bag', messages)


@pytest.mark.parametrize(
    ('make', 'tolerance'),
    [(millimetres, 6e-4), (lambda f: millimetres(f, b''), 6e-4), (inverse, 2e-4)],
)
def test_a_bag_of_compressed_depth_is_read(tmp_path, make, tolerance):
    with open_session(bag_of(tmp_path, make)) as session:
        assert session.topic == '/camera/depth/image_raw/compressedDepth'
        assert session.info_topic == '/camera/depth/camera_info'
        read = list(session)
    assert len(read) == len(FRAMES)
    for (stamp_ns, frame), true in zip(read, FRAMES, strict=True):
        assert stamp_ns == true.stamp_ns
        np.testing.assert_allclose(frame.depth, true.depth, atol=tolerance)


def test_raw_images_are_taken_before_compressed_ones(tmp_path):
    messages = images(FRAMES)
    messages += [message('/camera/depth/image_raw/compressedDepth', millimetres(f), 1) for f in FRAMES]
    with open_session(write_rosbag2(tmp_path / 'bag', messages)) as session:
        assert session.topic == '/camera/depth/image_raw'


def test_holes_stay_holes():
    frame = FRAMES[0]
    frame.depth[3:6, 4:9] = 0
    for make in (millimetres, inverse):
        image = decompressed(make(frame))
        pixels = image.data.view('<u2' if image.encoding == '16UC1' else '<f4').reshape(48, 64)
        assert not (pixels[3:6, 4:9] > 0).any()
        assert (pixels > 0).sum() == 48 * 64 - 15


def jpeg(frame):
    data = packed('JPEG', (frame.depth * 100).astype(np.uint8))
    return compressed(frame.stamp_ns, '16UC1; jpeg compressed mono8', data)


def test_jpeg_is_refused_by_name(tmp_path):
    with pytest.raises(BagError, match="compressed as '16UC1; jpeg compressed mono8' is not PNG"):
        open_session(bag_of(tmp_path, jpeg))


@pytest.mark.parametrize(
    ('format_', 'data', 'named'),
    [
        ('16UC1; compressedDepth rvl', bytes(40), 'compressedDepth rvl. is not PNG'),
        ('16UC1; compressedDepth png', bytes(12) + b'\x89PNG broken', 'cannot be read'),
        ('16UC1; compressedDepth png', b'', 'is not PNG'),
        ('16UC1; compressedDepth', packed('PNG', np.zeros((4, 4), np.uint8)), 'pixels of L, not of 16 bit'),
        ('32FC1; compressedDepth png', packed('PNG', np.ones((4, 4), np.uint16)), 'lacks its depthParam'),
    ],
)
def test_what_cannot_be_read_is_named(format_, data, named):
    with pytest.raises(MalformedMessage, match=named) as refusal:
        decompressed(compressed(1, format_, data))
    assert '\n' not in str(refusal.value)


def test_damaged_bytes_raise_nothing_but_malformed():
    whole = bytes(millimetres(FRAMES[0]).data)
    rng = np.random.default_rng(3)
    for _ in range(200):
        data = bytearray(whole[: rng.integers(0, len(whole))])
        for _ in range(rng.integers(0, 4)):
            if data:
                data[rng.integers(0, len(data))] = rng.integers(0, 256)
        try:
            decompressed(compressed(1, '16UC1; compressedDepth png', bytes(data)))
        except MalformedMessage as error:
            assert '\n' not in str(error)
