"""Stamps: integer nanoseconds here, builtin_interfaces/Time in messages; exact both ways."""

from typing import Protocol

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

NANOSECONDS = 1_000_000_000
_SECONDS = range(-(2**31), 2**31)


class TimeLike(Protocol):
    """builtin_interfaces/Time, from rclpy or from a bag."""

    sec: int
    nanosec: int


def read_stamp(time: TimeLike) -> int:
    """Nanoseconds of a Time message."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def time_message(stamp_ns: int) -> Time:
    """Time message of nanoseconds.

    Raises:
        ValueError: the message has no room for that many seconds (the year 2038).
    """
    sec, nanosec = divmod(int(stamp_ns), NANOSECONDS)
    if sec not in _SECONDS:
        msg = f'stamp of {stamp_ns} ns does not fit a Time message'
        raise ValueError(msg)
    return Time(sec=sec, nanosec=nanosec)


def header_message(stamp_ns: int, frame_id: str) -> Header:
    """Header of a stamp in nanoseconds and a frame."""
    return Header(stamp=time_message(stamp_ns), frame_id=frame_id)
