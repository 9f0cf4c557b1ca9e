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

"""Simulated frames recorded in the formats of OpenNI2 and libfreenect, for the real libraries to play."""

import struct

import numpy as np

from debris_scanner.drivers.freenect_device import TICKS_HZ
from debris_scanner.drivers.kinect_depth import NO_RAW, ZeroPlane

INT, GENERAL, STATE_READY, DATA_BEGIN, NEW_DATA, END, NODE_ADDED = 3, 6, 9, 8, 10, 11, 13
DEPTH_NODE = 2
PIXEL_1_MM, PIXEL_100_UM = 100, 101


def raw_disparity(depth_mm, plane=None):
    """The raw 11-bit image that a Kinect of this zero plane would have sent, nearest value."""
    table = (plane or ZeroPlane()).table_mm().astype(np.int64)
    raw = np.flatnonzero(table)
    values = table[raw]
    assert (np.diff(values) >= 0).all()
    at = np.clip(np.searchsorted(values, depth_mm), 1, len(values) - 1)
    at -= np.abs(values[at - 1] - depth_mm.astype(np.int64)) <= np.abs(values[at] - depth_mm.astype(np.int64))
    return np.where(depth_mm > 0, raw[at], NO_RAW).astype('<u2')


def write_fakenect(folder, depths_mm, rate_hz, colours=()):
    """A folder as libfreenect's ``record`` writes it."""
    folder.mkdir(parents=True)
    lines = []
    for k, depth in enumerate(depths_mm):
        seconds, ticks = 1000.0 + k / rate_hz, round(k / rate_hz * TICKS_HZ + 2**32 - TICKS_HZ) % 2**32
        name = f'd-{seconds:f}-{ticks}.pgm'
        (folder / name).write_bytes(b'P5 640 480 65535\n' + raw_disparity(depth).tobytes())
        lines.append(name)
        if k < len(colours):
            name = f'r-{seconds:f}-{ticks}.ppm'
            (folder / name).write_bytes(b'P6 640 480 255\n' + colours[k].astype('u1').tobytes())
            lines.append(name)
    (folder / 'INDEX.txt').write_text('\n'.join(lines) + '\n')
    return folder


def write_oni(path, depths, rate_hz, fov=None, pixel_format=PIXEL_1_MM, mirror=None, cropping=None):
    """An .oni file of one uncompressed depth stream, as OpenNI2's recorder lays it out.

    Args:
        path: to write.
        depths: images (h, w) uint16 of the cropped part.
        rate_hz: frames a second.
        fov: horizontal and vertical, radians; None leaves it out.
        pixel_format: PIXEL_1_MM or PIXEL_100_UM.
        mirror: flag of the stream; None leaves it out.
        cropping: (x, y, whole width, whole height) of the window that the images are.
    """
    height, width = depths[0].shape
    x, y, whole_width, whole_height = cropping or (0, 0, width, height)
    period_us = 1e6 / rate_hz
    mode = struct.pack('<3I', whole_width, whole_height, round(rate_hz))
    added = _text('Depth') + struct.pack(
        '<i4sIQQQ', DEPTH_NODE, b'NONE', len(depths), 0, round(period_us * len(depths)), 0
    )
    records = [
        _record(NODE_ADDED, added),
        _property(INT, 'oniRequiredFrameSize', struct.pack('<Q', 2 * width * height)),
        _property(INT, 'xnIsGenerating', struct.pack('<Q', 1)),
        _property(INT, 'xnDeviceMaxDepth', struct.pack('<Q', 10000)),
        _property(GENERAL, 'xnMapOutputMode', mode),
        _property(INT, 'oniPixelFormat', struct.pack('<Q', pixel_format)),
        _property(GENERAL, 'xnCropping', struct.pack('<i4H', cropping is not None, x, y, width, height)),
    ]
    if fov is not None:
        records.append(_property(GENERAL, 'xnFOV', struct.pack('<2d', *fov)))
    if mirror is not None:
        records.append(_property(INT, 'xnMirror', struct.pack('<Q', mirror)))
    records.append(_record(STATE_READY, b''))
    records.append(_record(DATA_BEGIN, b'\xff' * 12))
    for k, depth in enumerate(depths):
        stamp = struct.pack('<QI', round(k * period_us), k + 1)
        records.append(_record(NEW_DATA, stamp, depth.astype('<u2').tobytes()))
    records.append(_record(END, b''))
    header = struct.pack('<4sBBHIQI', b'NI10', 1, 0, 1, 0, round(period_us * len(depths)), 1)
    path.write_bytes(header + b''.join(records))
    return path


def _record(kind, fields, payload=b''):
    node = 0 if kind == END else 1
    return struct.pack('<4sIIIIQ', b'NIR\0', kind, node, 28 + len(fields), len(payload), 0) + fields + payload


def _property(kind, name, data):
    return _record(kind, _text(name) + struct.pack('<I', len(data)) + data)


def _text(text):
    return struct.pack('<I', len(text) + 1) + text.encode() + b'\0'
