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

"""Stamps to nanoseconds and back."""

import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import frame_stamp, header_message, read_stamp, stamp_of_text, time_message

SECOND = 10**9


@settings(derandomize=True)
@given(st.integers(-(2**31) * SECOND, 2**31 * SECOND - 1))
def test_nanoseconds_come_back_exactly(stamp_ns):
    assert read_stamp(time_message(stamp_ns)) == stamp_ns


def test_a_time_before_the_epoch_counts_its_nanoseconds_upwards():
    assert time_message(-1) == Time(sec=-1, nanosec=999_999_999)


@pytest.mark.parametrize('stamp_ns', [2**31 * SECOND, -(2**31) * SECOND - 1])
def test_a_stamp_without_room_is_refused(stamp_ns):
    with pytest.raises(ValueError, match=str(stamp_ns)):
        time_message(stamp_ns)


def test_a_header_names_frame_and_time():
    header = header_message(1_500_000_000, 'camera')
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (1, 500_000_000, 'camera')


@pytest.mark.parametrize(('sec', 'nanosec'), [(-1, 0), (2**31 - 1, 0), (5, 10**9), (5, 2**32 - 1)])
def test_a_frame_of_no_time_is_refused(sec, nanosec):
    """Such a stamp could not be said again: the node would end."""
    with pytest.raises(MalformedMessage, match=f'{sec} s and {nanosec} ns'):
        frame_stamp(Time(sec=sec, nanosec=nanosec))
    assert frame_stamp(Time(sec=5, nanosec=10**9 - 1)) == 6 * SECOND - 1


@pytest.mark.parametrize('text', ['', '-1', '1.5', '\N{ARABIC-INDIC DIGIT THREE}', '9' * 19, '9' * 5000])
def test_digits_that_name_no_frame_are_refused(text):
    with pytest.raises(MalformedMessage, match='no stamp in nanoseconds'):
        stamp_of_text(text)
    assert stamp_of_text('1700000000000000001') == 1_700_000_000_000_000_001
