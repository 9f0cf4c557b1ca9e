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

"""Messages from a device's process through a pipe: a line of JSON, then the raw pixels."""

import dataclasses
import json
import os
import select
import struct
import time
from typing import Any

import numpy as np

from debris_scanner.core.camera import Camera
from debris_scanner.drivers.captures import Capture, DeviceInfo
from debris_scanner.drivers.faults import DriverError, Fault

OPENED, CAPTURE, ALIVE, FAULT, END = 'opened', 'capture', 'alive', 'fault', 'end'

_HEAD = struct.Struct('<II')  # bytes of the JSON, bytes of the pixels
_MOST_JSON, _MOST_PIXELS = 1 << 16, 1 << 26
_CHUNK = 1 << 20

Message = tuple[str, Any]  # kind, and DeviceInfo, Capture, DriverError or None


class Sender:
    """The device's end of the pipe.

    Args:
        fd: file descriptor to write to.
    """

    def __init__(self, fd: int) -> None:
        self._pipe = os.fdopen(fd, 'wb')

    def opened(self, info: DeviceInfo) -> None:
        """The device streams."""
        self._send(OPENED, dataclasses.asdict(info))

    def capture(self, capture: Capture) -> None:
        """One image."""
        pixels = np.ascontiguousarray(capture.pixels)
        fields = {
            'stream': capture.stream,
            'device_ns': capture.device_ns,
            'arrival_ns': capture.arrival_ns,
            'stamp_ns': capture.stamp_ns,
            'shape': pixels.shape,
            'dtype': pixels.dtype.str,
        }
        self._send(CAPTURE, fields, pixels.reshape(-1).view(np.uint8).data)

    def alive(self) -> None:
        """No image has come, but the library answers."""
        self._send(ALIVE, {})

    def fault(self, error: DriverError) -> None:
        """The device cannot be used."""
        self._send(FAULT, {'fault': str(error.fault), 'text': error.text, 'advice': error.advice})

    def end(self) -> None:
        """The recording has come to its end."""
        self._send(END, {})

    def _send(self, kind: str, fields: dict[str, Any], pixels: bytes | memoryview = b'') -> None:
        text = json.dumps({'kind': kind} | fields).encode()
        self._pipe.write(_HEAD.pack(len(text), len(pixels)) + text)
        self._pipe.write(pixels)
        self._pipe.flush()


class Receiver:
    """Our end of the pipe.

    Args:
        fd: file descriptor to read from; closed with :meth:`close`.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._data = bytearray()

    def read(self, timeout_s: float) -> Message | None:
        """The next message, or None if it did not come in time.

        Raises:
            EOFError: the other end has gone.
            ValueError: what came is no message.
        """
        deadline = time.monotonic() + timeout_s
        while (message := self._take()) is None:
            ready, _, _ = select.select([self._fd], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                return None
            chunk = os.read(self._fd, _CHUNK)
            if not chunk:
                raise EOFError
            self._data += chunk
        return message

    def close(self) -> None:
        """Read nothing more."""
        os.close(self._fd)

    def _take(self) -> Message | None:
        if len(self._data) < _HEAD.size:
            return None
        text_size, pixel_size = _HEAD.unpack_from(self._data)
        if text_size > _MOST_JSON or pixel_size > _MOST_PIXELS:
            raise ValueError('not a message of a device')
        start, end = _HEAD.size + text_size, _HEAD.size + text_size + pixel_size
        if len(self._data) < end:
            return None
        fields = json.loads(self._data[_HEAD.size : start])
        pixels = bytes(self._data[start:end])
        del self._data[:end]
        return _decoded(fields, pixels)


def _decoded(fields: dict[str, Any], pixels: bytes) -> Message:
    kind = fields.pop('kind')
    if kind == OPENED:
        fields['camera'] = Camera(**fields['camera'])
        colour = fields['colour_camera']
        fields['colour_camera'] = None if colour is None else Camera(**colour)
        return kind, DeviceInfo(**fields)
    if kind == CAPTURE:
        image = np.frombuffer(pixels, np.dtype(fields['dtype'])).reshape(fields['shape'])
        times = (fields['device_ns'], fields['arrival_ns'], fields['stamp_ns'])
        return kind, Capture(fields['stream'], image, *times)
    if kind == FAULT:
        return kind, DriverError(Fault(fields['fault']), fields['text'], fields['advice'])
    return kind, None
