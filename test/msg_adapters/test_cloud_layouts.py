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

import struct
from array import array

import numpy as np
import pytest
from cloud_layouts import CODES, PackedCloud, packed_clouds
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import PointCloud2, PointField

from msg_adapters.clouds import MAX_POINTS, Cloud, cloud_message, read_cloud, read_fields
from msg_adapters.errors import MalformedMessage

UINT32S = st.one_of(st.integers(0, 40), st.sampled_from([255, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))
drawn = settings(
    derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)


def as_float32(value):
    with np.errstate(over='ignore'):
        return np.float64(value).astype(np.float32)


@settings(drawn, max_examples=250)
@given(packed_clouds())
def test_every_layout_is_read_exactly(packed: PackedCloud):
    cloud = read_cloud(packed.message)
    assert (cloud.stamp_ns, cloud.frame_id) == (12_000_000_345, 'sensor')
    assert cloud.xyz.shape == (*packed.shape, 3)
    assert cloud.xyz.dtype == np.float32
    assert cloud.xyz.flags.c_contiguous and cloud.xyz.flags.aligned
    expected = [
        [as_float32(packed.values[axis][i]) for axis in 'xyz'] for i in range(len(packed.values['x']))
    ]
    np.testing.assert_array_equal(cloud.xyz.reshape(-1, 3), np.array(expected, np.float32).reshape(-1, 3))
    colour = packed.values.get('rgb', packed.values.get('rgba'))
    if colour is None:
        assert cloud.rgb is None
    else:
        unpacked = [[word >> 16 & 255, word >> 8 & 255, word & 255] for word in colour]
        assert cloud.rgb.shape == (*packed.shape, 3)
        assert cloud.rgb.reshape(-1, 3).tolist() == unpacked


@settings(drawn, max_examples=100)
@given(packed_clouds())
def test_every_field_keeps_its_type(packed: PackedCloud):
    fields = {f.name: f for f in packed.message.fields if f.name not in ('rgb', 'rgba')}
    for name, values in read_fields(packed.message, fields).items():
        count = fields[name].count
        assert values.dtype == np.dtype(CODES[fields[name].datatype])
        assert values.dtype.isnative
        assert values.shape == (packed.shape if count == 1 else (*packed.shape, count))
        np.testing.assert_array_equal(values.ravel(), np.array(packed.values[name], values.dtype).ravel())


@settings(drawn, max_examples=60)
@given(packed_clouds(), st.sampled_from([array, bytes, bytearray]))
def test_any_kind_of_bytes_will_do(packed: PackedCloud, kind):
    expected = read_cloud(packed.message).xyz
    raw = packed.message.data.tobytes()
    packed.message.data = array('B', raw) if kind is array else kind(raw)
    np.testing.assert_array_equal(read_cloud(packed.message).xyz, expected)


@settings(drawn, max_examples=400)
@given(packed_clouds(), st.data())
def test_contradictions_raise_nothing_but_malformed(packed: PackedCloud, data):
    message = packed.message
    for _ in range(data.draw(st.integers(1, 3))):
        target = data.draw(
            st.sampled_from(['height', 'width', 'point_step', 'row_step', 'field', 'drop', 'data'])
        )
        if target == 'field' and message.fields:
            field = data.draw(st.sampled_from(message.fields))
            attribute = data.draw(st.sampled_from(['offset', 'datatype', 'count', 'name']))
            kind = st.integers(0, 255) if attribute == 'datatype' else UINT32S
            setattr(
                field,
                attribute,
                data.draw(st.sampled_from(['x', 'rgb', '', 'é'])) if attribute == 'name' else data.draw(kind),
            )
        elif target == 'drop' and message.fields:
            message.fields.pop(data.draw(st.integers(0, len(message.fields) - 1)))
        elif target == 'data':
            message.data = message.data[: data.draw(st.integers(0, len(message.data)))]
        elif target in ('height', 'width', 'point_step', 'row_step'):
            setattr(message, target, data.draw(UINT32S))
    try:
        cloud = read_cloud(message)
    except MalformedMessage as error:
        assert '\n' not in str(error)
        return
    assert isinstance(cloud, Cloud)
    assert cloud.xyz.size == 3 * message.height * message.width


def valid() -> PointCloud2:
    points = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    return cloud_message(1, 'sensor', {axis: points[..., i] for i, axis in enumerate('xyz')})


def fields_of(*fields: tuple[str, int, int, int]) -> list[PointField]:
    return [PointField(name=n, offset=o, datatype=d, count=c) for n, o, d, c in fields]


XYZ = [('x', 0, 7, 1), ('y', 4, 7, 1), ('z', 8, 7, 1)]


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({'data': array('B', bytes(95))}, 'data has 95 bytes, 2 rows of 48'),
        ({'row_step': 47, 'data': array('B', bytes(97))}, 'row_step 47'),
        ({'point_step': 13}, 'row_step 48 is shorter than 4 points of 13'),
        ({'point_step': 11}, "field 'z' ends at byte 12 of a point of 11"),
        ({'height': 4097, 'width': 4096}, f'limit of {MAX_POINTS}'),
        ({'fields': fields_of(*XYZ[:2])}, "no field 'z'"),
        ({'fields': []}, "no field 'x'; its fields: none"),
        ({'fields': fields_of(*XYZ, XYZ[0])}, "2 fields 'x'"),
        ({'fields': fields_of(*XYZ[:2], ('z', 8, 9, 1))}, "'z' has the unknown datatype 9"),
        ({'fields': fields_of(*XYZ[:2], ('z', 8, 7, 0))}, "'z' has count 0"),
        ({'fields': fields_of(*XYZ, ('w', 12, 7, 1))}, "'w' ends at byte 16"),
        ({'fields': fields_of(('x', 0, 7, 2), *XYZ[1:])}, "'x' has count 2"),
    ],
)
def test_the_error_names_the_thing(change, named):
    message = valid()
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(MalformedMessage, match=named):
        read_cloud(message)


def test_a_missing_field_is_named_with_those_there_are():
    with pytest.raises(MalformedMessage, match=r"no field 'normal_x'; its fields: x, y, z"):
        read_fields(valid(), ['normal_x'])


def test_coordinates_that_only_look_like_neighbours_are_told_apart():
    points = np.arange(8, dtype=np.float32).reshape(2, 4)
    message = cloud_message(
        1, 'sensor', {name: points[:, i] for i, name in enumerate(['x', 'gap', 'z', 'y'])}
    )
    np.testing.assert_array_equal(read_cloud(message).xyz, points[:, [0, 3, 2]])


def test_padding_fields_may_share_a_name():
    message = valid()
    message.fields = fields_of(*XYZ, ('_', 0, 2, 1), ('_', 1, 2, 3))
    assert read_cloud(message).xyz.shape == (2, 4, 3)


def test_three_byte_fields_are_colours_too():
    message = valid()
    message.fields = fields_of(
        ('x', 0, 2, 1), ('y', 1, 2, 1), ('z', 2, 2, 1), ('r', 4, 2, 1), ('g', 5, 2, 1), ('b', 6, 2, 1)
    )
    assert read_cloud(message).rgb[0, 0].tolist() == list(struct.pack('<f', 1.0)[:3])
