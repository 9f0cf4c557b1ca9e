"""Stamps from a device's own clock: frames arrive late by a varying time, but were taken evenly."""

from collections import deque

WINDOW = 150  # frames, five seconds of a 30 Hz device: short against the drift of two quartz clocks
JUMP_NS = 200_000_000  # a clock that is this far off has been set anew, or a recording has started over


class DeviceClock:
    """Turns times of a device into the system's, nanoseconds.

    The least delayed of the recent frames ties the clocks together; what delays all alike (exposure and
    transfer, some 30 ms of a Kinect) remains.
    """

    def __init__(self) -> None:
        self._offsets: deque[int] = deque(maxlen=WINDOW)
        self._last_ns = 0

    def stamp_ns(self, device_ns: int, arrival_ns: int) -> int:
        """Stamp of a frame by the system's clock; later than that of the frame before.

        Args:
            device_ns: when the frame was taken, by the device's clock.
            arrival_ns: when it came, by the system's.
        """
        offset = arrival_ns - device_ns
        if self._offsets and abs(offset - min(self._offsets)) > JUMP_NS:
            self._offsets.clear()
        self._offsets.append(offset)
        stamp = device_ns + min(self._offsets)
        if 0 <= self._last_ns - stamp < JUMP_NS:  # never back, unless the system's clock itself was set back
            stamp = self._last_ns + 1
        self._last_ns = stamp
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
    """Lets through as many frames a second as asked for, evenly; all where the device gives no more.

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
