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

"""The sensor's offset travels as a cloud of its coefficients, and a false one is refused."""

import numpy as np
import pytest

from debris_scanner.core.camera import Camera
from debris_scanner.sensing.depth_offset import NO_OFFSET, DepthOffset
from msg_adapters.clouds import read_fields
from msg_adapters.depth_offsets import depth_offset_message, read_depth_offset
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import read_stamp

pytestmark = pytest.mark.ros
OFFSET = DepthOffset(0.037, (-5, 3), 1e-3 * np.random.default_rng(0).normal(size=(9, 6)))


def test_it_comes_back():
    message = depth_offset_message(OFFSET, 123, 'target')
    assert read_stamp(message.header.stamp) == 123
    assert (message.height, message.width) == (6, 9)
    back = read_depth_offset(message)
    assert back.first == OFFSET.first
    assert back.step == pytest.approx(OFFSET.step)
    np.testing.assert_allclose(back.coefficients, OFFSET.coefficients)


def test_each_coefficient_lies_where_it_counts_most():
    single = DepthOffset(0.037, (-5, 3), np.eye(9, 6) * 0)
    single.coefficients[4, 2] = 1e-3
    fields = read_fields(depth_offset_message(single, 0, 'target'), ('x', 'y', 'share'))
    at = np.unravel_index(np.argmax(fields['share']), fields['share'].shape)
    camera = Camera(1000.0, 1000.0, 500.0, 0.0, 1000, 400)
    v, u = np.unravel_index(np.argmax(single.share(camera)), (400, 1000))
    assert (u - 500) / 1000 == pytest.approx(fields['x'][at], abs=1e-3)
    assert v / 1000 == pytest.approx(fields['y'][at], abs=1e-3)


def test_none_is_an_empty_cloud():
    message = depth_offset_message(NO_OFFSET, 5, 'target')
    assert message.width * message.height == 0
    assert read_depth_offset(message) is NO_OFFSET


@pytest.mark.parametrize(
    'offset',
    [
        DepthOffset(0.037, (0, 0), np.full((9, 6), np.nan)),
        DepthOffset(0.037, (0, 0), np.full((9, 6), 0.5)),
        DepthOffset(0.037, (0, 0), np.full((9, 3), 1e-3)),
        DepthOffset(0.037, (0, 0), np.full((300, 6), 1e-3)),
        DepthOffset(-0.037, (0, 0), np.full((9, 6), 1e-3)),
    ],
)
def test_what_is_no_offset_is_refused(offset):
    with pytest.raises(MalformedMessage):
        read_depth_offset(depth_offset_message(offset, 0, 'target'))
