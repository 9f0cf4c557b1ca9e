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

"""Stamps: integer nanoseconds here, builtin_interfaces/Time in messages; exact both ways."""

from typing import Protocol

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from msg_adapters.errors import MalformedMessage

NANOSECONDS = 1_000_000_000
_SECONDS = range(-(2**31), 2**31)
# two years short of what a Time message holds: stamps are moved on when a clock jumps back
LATEST_NS = (2**31 - 2**26) * NANOSECONDS


class TimeLike(Protocol):
    """builtin_interfaces/Time, from rclpy or from a bag."""

    sec: int
    nanosec: int


def read_stamp(time: TimeLike) -> int:
    """Nanoseconds of a Time message."""
    return int(time.sec) * NANOSECONDS + int(time.nanosec)


def frame_stamp(time: TimeLike) -> int:
    """Nanoseconds of a Time message that names a frame.

    Raises:
        MalformedMessage: it is no time: a second's nanoseconds overrun, or a year before 1970 or after 2035.
    """
    stamp_ns = read_stamp(time)
    if not (0 <= time.nanosec < NANOSECONDS and 0 <= stamp_ns < LATEST_NS):
        raise MalformedMessage(f'stamp of {time.sec} s and {time.nanosec} ns is no time of a frame')
    return stamp_ns


def stamp_of_text(text: str) -> int:
    """Nanoseconds of the digits that name a frame.

    Raises:
        MalformedMessage: no number, or no time of a frame.
    """
    if not (text.isascii() and text.isdecimal() and len(text) <= 19 and int(text) < LATEST_NS):
        raise MalformedMessage(f'{text[:40]!r} is no stamp in nanoseconds')
    return int(text)


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
