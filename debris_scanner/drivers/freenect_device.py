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

"""A Kinect v1 through libfreenect, or a recorded one through fakenect.

Fakenect replays folders that libfreenect's ``record`` wrote. They are checked first, because it aborts on
broken ones. ``INDEX.txt`` names one file per line: ``d-SECONDS-TICKS.pgm`` is a depth image of raw 11-bit
values, ``r-...ppm`` a colour image, ``a-...dump`` the accelerometer. Each image is a header line and its
pixels.
"""

import ctypes
import os
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.drivers import freenect_library, usb_access
from debris_scanner.drivers.captures import COLOUR, DEPTH, Capture, DeviceInfo, DeviceSettings, chosen
from debris_scanner.drivers.device_clock import TickCounter
from debris_scanner.drivers.faults import DriverError, EndOfRecording, Fault
from debris_scanner.drivers.freenect_library import FRAME_CALLBACK, FreenectLibrary
from debris_scanner.drivers.kinect_depth import COLOUR_CAMERA, HEIGHT, WIDTH, ZeroPlane

TICKS_HZ = 60_000_000  # of the Kinect's time stamps
NO_ACCESS = 'open camera: -3'  # libusb's LIBUSB_ERROR_ACCESS, as libfreenect reports it
RECORDING_VARIABLE = 'FAKENECT_PATH'

INDEX = 'INDEX.txt'
PIXEL_BYTES = {'d': 2, 'r': 3}
_LONGEST_HEADER = 100  # bytes
_IS_A_FOLDER = 'name a folder that libfreenect\'s "record" wrote'


class FreenectDevice:
    """An opened Kinect that streams; see :class:`~debris_scanner.drivers.captures.DepthDevice`.

    The Kinect measures raw disparity, which is turned into millimetres here by the device's zero plane.
    Registered depth comes from the library in millimetres already.

    Args:
        settings: ``device`` is an index, a serial number, or a folder that ``record`` wrote; empty takes the
            first Kinect.

    Raises:
        DriverError: there is none, or it cannot be used.
    """

    def __init__(self, settings: DeviceSettings) -> None:
        self._settings = settings
        recording = Path(settings.device) if is_recording(settings.device) else None
        if recording is not None:
            check_recording(recording)
            os.environ[RECORDING_VARIABLE] = str(recording)
        self._library = FreenectLibrary(settings.library, replay=recording is not None)
        self._captures: deque[Capture] = deque(maxlen=4)
        self._ticks = TickCounter(TICKS_HZ)
        self._callbacks = (FRAME_CALLBACK(self._on_depth), FRAME_CALLBACK(self._on_video))
        self._context = self._library.open_context()
        self._device: ctypes.c_void_p | None = None
        try:
            self._device = self._open(settings.device, recording)
            self.info = self._start(recording is not None)
        except DriverError:
            self.close()
            raise

    def read(self, timeout_s: float) -> Capture | None:
        """The next image, or None if none came in time."""
        deadline = time.monotonic() + timeout_s
        while not self._captures:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                return None
            if not self._library.process_events(self._context, left_s):
                if self.info.recording:
                    raise EndOfRecording
                raise DriverError(
                    Fault.LOST, f'the Kinect has gone: {"; ".join(self._library.complaints)}', 'unplugged?'
                )
            if any('disappeared' in text for text in self._library.complaints):
                raise DriverError(Fault.LOST, 'the Kinect has been unplugged', 'plug it in again')
        return self._captures.popleft()

    def close(self) -> None:
        """Stop and release the Kinect."""
        self._library.close(self._context, self._device)

    def _open(self, name: str, recording: Path | None) -> ctypes.c_void_p:
        library, context = self._library, self._context
        there = library.count(context)
        device = library.open_device(context, '' if recording else name) if there > 0 else None
        if device is not None:
            return device
        if there > 0 and name.isdecimal() and int(name) >= there:
            raise DriverError(Fault.DEVICE, f'no Kinect of index {name}: {there} plugged in')
        if there > 0 and name and not name.isdecimal():
            raise DriverError(
                Fault.DEVICE, f'no Kinect of serial number {name}', 'leave the name empty to take any'
            )
        said = '; '.join(library.complaints)
        if there > 0 and NO_ACCESS in said:
            (vendor, product), *_ = usb_access.KINECT
            raise usb_access.forbidden('the Kinect', usb_access.UsbDevice(vendor, product, usb_access.DEV))
        if there > 0:
            raise DriverError(Fault.DEVICE, f'the Kinect cannot be opened: {said}', 'is it in use?')
        raise usb_access.missing(usb_access.cameras(frozenset(), usb_access.KINECT), 'Kinect v1')

    def _start(self, recording: bool) -> DeviceInfo:
        settings, library, device = self._settings, self._library, self._device
        assert device is not None
        if settings.registered and not library.tells_registration:
            raise DriverError(Fault.MODE, 'this library replays no registered depth', 'leave registered off')
        plane = library.zero_plane(device)
        source = "the device's zero plane" if plane else 'the zero plane of a typical Kinect'
        plane = plane or ZeroPlane()
        self._table: NDArray[np.uint16] | None = None if settings.registered else plane.table_mm()
        formats = freenect_library
        depth_format = formats.DEPTH_REGISTERED if settings.registered else formats.DEPTH_11BIT
        library.start(device, 'depth', depth_format, self._callbacks[0])
        if settings.colour:
            library.start(device, 'video', formats.VIDEO_RGB, self._callbacks[1])
        geometry = COLOUR_CAMERA if settings.registered else plane.camera
        source = 'the colour camera of a typical Kinect' if settings.registered else source
        camera, source = chosen(geometry, source, settings, WIDTH, HEIGHT)
        name = f'recorded Kinect {settings.device}' if recording else f'Kinect {settings.device}'.strip()
        colour_camera = COLOUR_CAMERA if settings.colour else None
        return DeviceInfo(name, camera, source, settings.registered, recording, colour_camera)

    def _on_depth(self, _device: int, data: int, ticks: int) -> None:
        raw = _image(data, (HEIGHT, WIDTH), np.dtype('<u2'))
        pixels = raw.copy() if self._table is None else self._table[np.minimum(raw, len(self._table) - 1)]
        self._captures.append(Capture(DEPTH, pixels, self._ticks.ns(ticks), time.time_ns()))

    def _on_video(self, _device: int, data: int, ticks: int) -> None:
        pixels = _image(data, (HEIGHT, WIDTH, 3), np.dtype('u1')).copy()
        self._captures.append(Capture(COLOUR, pixels, self._ticks.ns(ticks), time.time_ns()))


def is_recording(device: str) -> bool:
    """Whether a device's name is a path, and so a recording, rather than an index or a serial number."""
    return '/' in device or Path(device or '-').is_dir()


def check_recording(folder: Path) -> int:
    """Number of depth images of a recording.

    Raises:
        DriverError: fakenect would end the process, or read past the end of a file.
    """
    index = folder / INDEX
    try:
        text = index.read_text(errors='replace')
    except OSError as error:
        raise DriverError(Fault.RECORDING, f'{index}: {error.strerror}', _IS_A_FOLDER) from None
    if not text.endswith('\n') or '\n\n' in text or text.startswith('\n'):
        raise DriverError(Fault.RECORDING, f'{index} is empty or cut off, or has an empty line', _IS_A_FOLDER)
    depths = 0
    for line in text.splitlines():
        kind, file = line[:1], folder / line
        if Path(line).name != line:
            raise DriverError(Fault.RECORDING, f'{index} names {line!r}, which is not in its folder')
        try:
            with file.open('rb') as opened:
                header = opened.read(_LONGEST_HEADER)
            size = file.stat().st_size
        except OSError as error:
            raise DriverError(Fault.RECORDING, f'{file}: {error.strerror}') from None
        wanted = PIXEL_BYTES.get(kind, 0) * WIDTH * HEIGHT
        if size == 0 or (wanted and size != header.find(b'\n') + 1 + wanted):
            raise DriverError(Fault.RECORDING, f'{file} is not an image of {WIDTH} x {HEIGHT} pixels')
        depths += kind == 'd'
    if not depths:
        raise DriverError(Fault.RECORDING, f'{folder} holds no depth image', _IS_A_FOLDER)
    return depths


def _image(address: int, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """View of a library's buffer, valid until its callback returns."""
    buffer = (ctypes.c_uint8 * (int(np.prod(shape)) * dtype.itemsize)).from_address(address)
    return np.frombuffer(memoryview(buffer).cast('B'), dtype).reshape(shape)
