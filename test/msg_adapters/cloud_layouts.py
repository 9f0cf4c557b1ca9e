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

"""Clouds of every layout, packed field by field and point by point with struct: what readers are held to."""

import struct
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import strategies as st

CODES = {1: 'b', 2: 'B', 3: 'h', 4: 'H', 5: 'i', 6: 'I', 7: 'f', 8: 'd'}
FLOAT32, FLOAT64, UINT32 = 7, 8, 6
SPECIAL = [float('nan'), float('inf'), float('-inf'), 0.0, -0.0]


@dataclass
class PackedCloud:
    """A message and what it holds: a list of values (one a point, tuples where COUNT > 1) for each field."""

    message: Any
    values: dict[str, list[Any]]
    shape: tuple[int, ...]


def size(datatype: int) -> int:
    return struct.calcsize('<' + CODES[datatype])


def element(datatype: int) -> st.SearchStrategy[Any]:
    if datatype == FLOAT32:
        return st.one_of(st.sampled_from(SPECIAL), st.floats(-100, 100, width=32))
    if datatype == FLOAT64:
        return st.one_of(st.sampled_from([*SPECIAL, 1e300]), st.floats(-100, 100))
    bits = 8 * size(datatype)
    signed = CODES[datatype].islower()
    return st.integers(-(2 ** (bits - 1)) if signed else 0, 2 ** (bits - signed) - 1)


@st.composite
def packed_clouds(draw: Any) -> PackedCloud:
    """Any order, offset, padding, byte order and datatype; with and without colour and further fields."""
    fields = [(name, draw(st.sampled_from(sorted(CODES))), 1) for name in 'xyz']
    colour = draw(
        st.sampled_from([None, ('rgb', FLOAT32), ('rgb', UINT32), ('rgba', UINT32), ('rgba', FLOAT32)])
    )
    for i in range(draw(st.integers(0, 3))):
        fields.append((f'extra_{i}', draw(st.sampled_from(sorted(CODES))), draw(st.integers(1, 4))))
    fields = draw(st.permutations(fields + ([(*colour, 1)] if colour else [])))
    offsets, end = [], 0
    for _, datatype, count in fields:
        offsets.append(end + draw(st.integers(0, 5)))
        end = offsets[-1] + size(datatype) * count
    point_step = end + draw(st.integers(0, 7))
    height, width = draw(st.integers(1, 3)), draw(st.integers(0, 4))
    row_step = point_step * width + draw(st.sampled_from([0, 0, 1, 13]))
    big = draw(st.booleans())
    data = bytearray(draw(st.integers(0, 255)).to_bytes(1, 'big') * (row_step * height))
    values: dict[str, list[Any]] = {name: [] for name, _, _ in fields}
    for row in range(height):
        for column in range(width):
            start = row * row_step + column * point_step
            for (name, datatype, count), offset in zip(fields, offsets, strict=True):
                packed_colour = name in ('rgb', 'rgba')
                kind = element(UINT32 if packed_colour else datatype)
                value = tuple(draw(kind) for _ in range(count))
                code = 'I' if packed_colour else CODES[datatype]
                struct.pack_into(f'{">" if big else "<"}{count}{code}', data, start + offset, *value)
                values[name].append(value if count > 1 else value[0])
    data += b'\xff' * draw(st.sampled_from([0, 0, 5]))
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=345), frame_id='sensor'),
        height=height,
        width=width,
        fields=[
            SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)
            for (name, datatype, count), offset in zip(fields, offsets, strict=True)
        ],
        is_bigendian=big,
        point_step=point_step,
        row_step=row_step,
        data=np.frombuffer(bytes(data), np.uint8),
        is_dense=False,
    )
    shape = (0,) if width == 0 else (height, width) if height > 1 else (width,)
    return PackedCloud(message, values, shape)
