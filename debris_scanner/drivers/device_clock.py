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

"""Stamps from a device's own clock: frames are taken evenly but arrive with a varying delay."""

from collections import deque

WINDOW = 150  # frames, five seconds at 30 Hz: short against the drift of two quartz clocks
JUMP_NS = 200_000_000  # a clock that is this far off for longer than a hiccup has been set anew
HICCUP = 10  # frames in a row that may come late although the clocks are right


class DeviceClock:
    """Turns times of a device into the system's, nanoseconds.

    The least delayed of the recent frames ties the clocks together. A delay common to all remains (exposure
    and transfer, some 30 ms for a Kinect).

    Args:
        recorded: the times are a recording's. Its player may fall behind, which is not a clock error: the
            clocks stay tied until the recording starts over.
    """

    def __init__(self, recorded: bool = False) -> None:
        self._recorded = recorded
        self._offsets: deque[int] = deque(maxlen=1 if recorded else WINDOW)
        self._late = 0
        self._last_device_ns = 0
        self._last_ns = 0

    def stamp_ns(self, device_ns: int, arrival_ns: int) -> int:
        """Stamp of a frame by the system's clock; later than that of the frame before.

        Args:
            device_ns: when the frame was taken, by the device's clock.
            arrival_ns: when it came, by the system's.
        """
        offset = arrival_ns - device_ns
        least = min(self._offsets, default=offset)
        self._late = self._late + 1 if offset - least > JUMP_NS else 0
        set_anew = device_ns < self._last_device_ns - JUMP_NS or offset < least - JUMP_NS
        if set_anew or (self._late > HICCUP and not self._recorded):
            self._offsets.clear()
            self._late = 0
        if not self._recorded or not self._offsets or offset < least:
            self._offsets.append(offset)
        stamp = device_ns + min(self._offsets)
        if 0 <= self._last_ns - stamp < JUMP_NS:  # never back, unless the system's clock was set back
            stamp = self._last_ns + 1
        self._last_ns, self._last_device_ns = stamp, device_ns
        return stamp


class TickCounter:
    """Nanoseconds of a 32-bit counter that wraps around.

    Args:
        hertz: ticks a second.
    """

    def __init__(self, hertz: int) -> None:
        self._hertz = hertz
        self._ticks: int | None = None

    def ns(self, ticks: int) -> int:
        """Time of a reading, from an arbitrary start; a reading may lie before the one before it."""
        if self._ticks is None:
            self._ticks = ticks
        step = (ticks - self._ticks) % 2**32
        self._ticks += step if step < 2**31 else step - 2**32
        return self._ticks * 1_000_000_000 // self._hertz


class RateLimit:
    """Passes at most the requested frames per second, evenly.

    Args:
        hertz: frames a second.
    """

    def __init__(self, hertz: float) -> None:
        self._period_ns = 1e9 / hertz
        self._due_ns: float | None = None

    def passes(self, device_ns: int) -> bool:
        """Whether to take a frame of this time."""
        if self._due_ns is None or abs(device_ns - self._due_ns) > 2 * self._period_ns:
            self._due_ns = device_ns  # the first, or the device's clock has jumped
        if device_ns < self._due_ns - 0.25 * self._period_ns:
            return False
        self._due_ns += self._period_ns
        return True
