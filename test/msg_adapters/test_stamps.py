import pytest
from builtin_interfaces.msg import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from msg_adapters.stamps import header_message, read_stamp, time_message

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
