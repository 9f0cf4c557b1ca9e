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

"""libfreenect through ctypes, and fakenect, which is the same library replaying a recorded folder.

Declarations after libfreenect.h and libfreenect_registration.h of version 0.5.
"""

import ctypes
import sysconfig
from collections import deque
from ctypes import POINTER, Structure, byref, c_char_p, c_int, c_uint32, c_void_p
from pathlib import Path
from typing import Any

from debris_scanner.drivers.faults import DriverError, Fault
from debris_scanner.drivers.kinect_depth import ZeroPlane

NAMES = ('libfreenect.so.0.5', 'libfreenect.so.0', 'libfreenect.so')
INSTALL = 'sudo apt-get install libfreenect0.5'

RESOLUTION_MEDIUM = 1  # 640 x 480
DEPTH_11BIT, DEPTH_REGISTERED = 0, 4
VIDEO_RGB = 0
CAMERA_ALONE = 0x02  # no motor, no audio: later Kinects need firmware for them, which cannot be shipped
LOG_ERROR = 1

FRAME_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32)
LOG_CALLBACK = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p)


class FrameMode(Structure):
    """freenect_frame_mode."""

    _fields_ = (
        ('reserved', c_uint32),
        ('resolution', c_int),
        ('format', ctypes.c_int32),
        ('bytes', ctypes.c_int32),
        ('width', ctypes.c_int16),
        ('height', ctypes.c_int16),
        ('data_bits_per_pixel', ctypes.c_int8),
        ('padding_bits_per_pixel', ctypes.c_int8),
        ('framerate', ctypes.c_int8),
        ('is_valid', ctypes.c_int8),
    )


class _Registration(Structure):
    """freenect_registration; only its zero plane is used."""

    _fields_ = (
        ('reg_info', ctypes.c_int32 * 29),
        ('pad_info', ctypes.c_uint16 * 3),
        ('emitter_cm', ctypes.c_float),
        ('colour_cm', ctypes.c_float),
        ('reference_distance', ctypes.c_float),
        ('reference_pixel_size', ctypes.c_float),
        ('const_shift', ctypes.c_double),
        ('tables', c_void_p * 3),
    )


class _Timeval(Structure):
    _fields_ = (('sec', ctypes.c_long), ('usec', ctypes.c_long))


class FreenectLibrary:
    """The calls that a camera needs, with the library's last error messages.

    Args:
        library: file to load; empty takes the installed one.
        replay: load fakenect instead.

    Raises:
        DriverError: it is missing.
    """

    def __init__(self, library: str = '', replay: bool = False) -> None:
        names = [library] if library else replay_candidates() if replay else [*NAMES]
        self.complaints: deque[str] = deque(maxlen=5)
        self._calls = _load_first(names)
        self._log_callback = LOG_CALLBACK(self._on_log)
        self._declare()

    def open_context(self) -> c_void_p:
        """A context in which devices can be opened.

        Raises:
            DriverError: USB is out of reach.
        """
        context = c_void_p()
        if self._calls.freenect_init(byref(context), None) < 0:
            raise DriverError(Fault.LIBRARY, 'libfreenect cannot reach USB', 'is /dev/bus/usb there?')
        self._calls.freenect_set_log_callback(context, self._log_callback)
        self._calls.freenect_set_log_level(context, LOG_ERROR)
        self._calls.freenect_select_subdevices(context, CAMERA_ALONE)
        return context

    def open_device(self, context: c_void_p, name: str) -> c_void_p | None:
        """A device by index or serial number, any if the name is empty; None if it cannot be opened."""
        device = c_void_p()
        if name and not name.isdecimal():
            code = self._calls.freenect_open_device_by_camera_serial(context, byref(device), name.encode())
        else:
            code = self._calls.freenect_open_device(context, byref(device), int(name or 0))
        return device if code >= 0 else None

    def count(self, context: c_void_p) -> int:
        """Devices that are plugged in."""
        return int(self._calls.freenect_num_devices(context))

    def zero_plane(self, device: c_void_p) -> ZeroPlane | None:
        """The device's calibration; None from a library that lacks it (fakenect up to 0.5)."""
        if not self.tells_registration:
            return None
        r = self._calls.freenect_copy_registration(device)
        plane = ZeroPlane(r.emitter_cm, r.reference_distance, r.reference_pixel_size, r.const_shift)
        self._calls.freenect_destroy_registration(byref(r))
        return plane if plane.pixel_mm > 0 and plane.focal_mm > 0 and plane.emitter_cm > 0 else None

    @property
    def tells_registration(self) -> bool:
        """Whether the library supports depth registered to colour."""
        return hasattr(self._calls, 'freenect_copy_registration')

    def start(self, device: c_void_p, stream: str, format_: int, callback: Any) -> FrameMode:
        """Start ``depth`` or ``video`` in a format, 640 x 480.

        Raises:
            DriverError: the device refuses.
        """
        calls = self._calls
        mode = getattr(calls, f'freenect_find_{stream}_mode')(RESOLUTION_MEDIUM, format_)
        getattr(calls, f'freenect_set_{stream}_callback')(device, callback)
        if not mode.is_valid or getattr(calls, f'freenect_set_{stream}_mode')(device, mode) < 0:
            raise DriverError(Fault.MODE, f'the Kinect refuses the {stream} format {format_}')
        if getattr(calls, f'freenect_start_{stream}')(device) < 0:
            raise DriverError(Fault.LOST, f'the Kinect does not start {stream}: {"; ".join(self.complaints)}')
        return mode

    def process_events(self, context: c_void_p, timeout_s: float) -> bool:
        """Let callbacks run for a while; False if the library reports the end."""
        timeout = _Timeval(int(timeout_s), int(timeout_s % 1 * 1e6))
        return bool(self._calls.freenect_process_events_timeout(context, byref(timeout)) >= 0)

    def close(self, context: c_void_p, device: c_void_p | None) -> None:
        """Stop and release the device."""
        if device is not None:
            self._calls.freenect_stop_depth(device)
            self._calls.freenect_stop_video(device)
            self._calls.freenect_close_device(device)
        self._calls.freenect_shutdown(context)

    def _on_log(self, _context: int, _level: int, text: bytes) -> None:
        self.complaints.append(text.decode(errors='replace').strip())

    def _declare(self) -> None:
        calls = self._calls
        pointer = c_void_p
        calls.freenect_init.argtypes = [POINTER(pointer), pointer]
        calls.freenect_open_device.argtypes = [pointer, POINTER(pointer), c_int]
        calls.freenect_open_device_by_camera_serial.argtypes = [pointer, POINTER(pointer), c_char_p]
        calls.freenect_set_log_callback.argtypes = [pointer, LOG_CALLBACK]
        calls.freenect_process_events_timeout.argtypes = [pointer, POINTER(_Timeval)]
        for name in ('set_log_level', 'select_subdevices'):
            getattr(calls, f'freenect_{name}').argtypes = [pointer, c_int]
        for name in ('num_devices', 'close_device', 'shutdown'):
            getattr(calls, f'freenect_{name}').argtypes = [pointer]
        for stream in ('depth', 'video'):
            getattr(calls, f'freenect_find_{stream}_mode').argtypes = [c_int, c_int]
            getattr(calls, f'freenect_find_{stream}_mode').restype = FrameMode
            getattr(calls, f'freenect_set_{stream}_mode').argtypes = [pointer, FrameMode]
            getattr(calls, f'freenect_set_{stream}_callback').argtypes = [pointer, FRAME_CALLBACK]
            getattr(calls, f'freenect_start_{stream}').argtypes = [pointer]
            getattr(calls, f'freenect_stop_{stream}').argtypes = [pointer]
        if self.tells_registration:
            calls.freenect_copy_registration.argtypes = [pointer]
            calls.freenect_copy_registration.restype = _Registration
            calls.freenect_destroy_registration.argtypes = [POINTER(_Registration)]


def replay_candidates() -> list[str]:
    """Paths where distributions and libfreenect's own build put fakenect."""
    multiarch = sysconfig.get_config_var('MULTIARCH') or ''
    folders = [Path('/usr/lib') / multiarch, Path('/usr/lib'), Path('/usr/lib64'), Path('/usr/local/lib')]
    files = [folder / 'fakenect' / name for folder in folders for name in NAMES]
    return [str(file) for file in files if file.is_file()] or [str(files[0])]


def _load_first(names: list[str]) -> Any:
    reasons = []
    for name in names:
        try:
            calls = ctypes.CDLL(name)
            calls.freenect_process_events_timeout  # noqa: B018 - another library, or one before 0.3
        except (OSError, AttributeError) as error:
            reasons.append(str(error))
        else:
            return calls
    raise DriverError(Fault.LIBRARY, f'libfreenect cannot be loaded ({reasons[0]})', INSTALL)
