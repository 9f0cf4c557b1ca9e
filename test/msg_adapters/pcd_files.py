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

"""Reading PCD files as the PointCloud2 that a driver would have sent: same fields, offsets and point step."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

DATATYPES = {'I1': 1, 'U1': 2, 'I2': 3, 'U2': 4, 'I4': 5, 'U4': 6, 'F4': 7, 'F8': 8}


def read_pcd(path: Path) -> tuple[np.ndarray, dict[str, list[str]]]:
    """Structured array (n,) of a PCD in ascii, binary or compressed form, and its header."""
    content = path.read_bytes()
    header: dict[str, list[str]] = {}
    end = 0
    while 'DATA' not in header:
        stop = content.index(b'\n', end) + 1
        words = content[end:stop].decode().split('#')[0].split()
        end = stop
        if words:
            header[words[0]] = words[1:]
    kinds = [f'<{kind.lower()}{size}' for kind, size in zip(header['TYPE'], header['SIZE'], strict=True)]
    names = [f'{name}#{i}' if name == '_' else name for i, name in enumerate(header['FIELDS'])]
    counts = [int(c) for c in header['COUNT']]
    dtype = np.dtype(
        [(n, k, (c,)) if c > 1 else (n, k) for n, k, c in zip(names, kinds, counts, strict=True)]
    )
    points = int(header['POINTS'][0])
    body = content[end:]
    if header['DATA'] == ['binary']:
        return np.frombuffer(body, dtype, points), header
    values = np.empty(points, dtype)
    if header['DATA'] == ['ascii']:
        table = np.array([line.split() for line in body.decode().splitlines() if line.strip()])
        start = 0
        for name, count in zip(names, counts, strict=True):
            column = table[:points, start : start + count].reshape(values[name].shape)
            values[name] = column.astype(np.float64).astype(values[name].dtype)
            start += count
        return values, header
    compressed, uncompressed = np.frombuffer(body, '<u4', 2)
    columns = lzf_decompress(body[8 : 8 + compressed], uncompressed)
    start = 0
    for name in names:
        stop = start + values[name].nbytes
        values[name] = np.frombuffer(columns[start:stop], values[name].dtype).reshape(values[name].shape)
        start = stop
    return values, header


def cloud_of(values: np.ndarray, header: dict[str, list[str]]) -> Any:
    """The points as a message, organised as the file is."""
    layout = values.dtype.fields
    width, height = int(header['WIDTH'][0]), int(header['HEIGHT'][0])
    if width * height != len(values):  # a header that says 0 x 0
        width, height = len(values), 1
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id='sensor'),
        height=height,
        width=width,
        fields=[
            SimpleNamespace(
                name=name.split('#')[0], offset=layout[name][1], datatype=DATATYPES[t + s], count=int(c)
            )
            for name, t, s, c in zip(
                values.dtype.names, header['TYPE'], header['SIZE'], header['COUNT'], strict=True
            )
        ],
        is_bigendian=False,
        point_step=values.itemsize,
        row_step=values.itemsize * width,
        data=np.frombuffer(values.tobytes(), np.uint8),
    )


def lzf_decompress(data: bytes, size: int) -> bytes:
    """LibLZF: runs of literals, and references to what was written before."""
    out = bytearray()
    at = 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += data[at]
            at += 1
        distance = ((control & 31) << 8 | data[at]) + 1
        at += 1
        length += 2
        start = len(out) - distance
        chunk = out[start : start + length]
        while len(chunk) < length:  # the reference overlaps what it writes
            chunk += chunk[: length - len(chunk)]
        out += chunk
    assert len(out) == size
    return bytes(out)
