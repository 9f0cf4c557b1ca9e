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

"""Any OpenNI2 device (Xtion, Carmine, Kinect through FreenectDriver) or .oni recording."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.drivers import usb_access
from debris_scanner.drivers.captures import (
    COLOUR,
    DEPTH,
    Capture,
    DeviceInfo,
    DeviceSettings,
    chosen,
    from_field_of_view,
)
from debris_scanner.drivers.faults import DriverError, EndOfRecording, Fault
from debris_scanner.drivers.openni2_library import load, words

MICROSECOND_NS = 1000
METRES_PER_100_UM = np.float32(1e-4)
SETTLE_S = 0.2  # a driver's thread may still send its last frame; destroying its stream earlier crashes it
SILENT_RECORDING_S = 3.0


class OpenNI2Device:
    """An opened device that streams; see :class:`~debris_scanner.drivers.captures.DepthDevice`.

    Args:
        settings: ``device`` is a URI or a file's name; empty takes the first device.

    Raises:
        DriverError: there is none, or it cannot be used.
    """

    def __init__(self, settings: DeviceSettings) -> None:
        self._api = load(settings.library)
        self._settings = settings
        self._device = self._open(settings.device)
        self._streams: dict[str, Any] = {}
        self._mirrored: dict[str, bool] = {}
        self._last_index, self._last_s = -1, time.monotonic()
        try:
            self.info = self._start()
        except Exception as error:
            self.close()
            if isinstance(error, DriverError):
                raise
            raise DriverError(Fault.LOST, f'{settings.device or "device"}: {words(error)}') from None

    def read(self, timeout_s: float) -> Capture | None:
        """The next image, or None if none came in time."""
        try:
            stream = self._api.wait_for_any_stream(list(self._streams.values()), timeout_s)
            if stream is None:
                self._look_for_end()
                return None
            arrival_ns = time.time_ns()
            with stream.read_frame() as frame:
                return self._capture(frame, arrival_ns)
        except (DriverError, EndOfRecording):
            raise
        except Exception as error:  # the binding's OpenNIError, of whatever call
            raise DriverError(Fault.LOST, f'{self.info.name}: {words(error)}', 'is it unplugged?') from None

    def close(self) -> None:
        """Stop and release the device."""
        for stream in self._streams.values():
            _quietly(stream.stop)
        time.sleep(SETTLE_S)
        for stream in self._streams.values():
            _quietly(stream.close)
        _quietly(self._device.close)
        _quietly(self._api.unload)

    def _open(self, name: str) -> Any:
        is_file = name.endswith('.oni')
        if is_file and not Path(name).is_file():
            raise DriverError(Fault.RECORDING, f'{name} does not exist')
        try:
            return self._api.Device(name.encode() if name else None)
        except Exception as error:
            if is_file:
                raise DriverError(Fault.RECORDING, f'{name}: {words(error)}') from None
            if name:
                raise DriverError(
                    Fault.DEVICE,
                    f'OpenNI2 finds no device {name!r} ({words(error)})',
                    'leave the name empty to take any device',
                ) from None
            found = usb_access.cameras(usb_access.OPENNI2_VENDORS, usb_access.KINECT)
            raise usb_access.missing(found, 'camera that OpenNI2 knows') from None

    def _start(self) -> DeviceInfo:
        """Choose modes, start the streams."""
        api, settings, device = self._api, self._settings, self._device
        depth = device.create_depth_stream()
        if depth is None:
            raise DriverError(Fault.MODE, 'the device has no depth stream')
        self._streams[DEPTH] = depth
        recording = bool(device.is_file())
        mode = depth.video_mode
        if recording:
            device.playback.set_repeat_enabled(settings.repeat)
        else:
            formats = (api.PIXEL_FORMAT_DEPTH_1_MM, api.PIXEL_FORMAT_DEPTH_100_UM)
            mode = self._set_mode(depth, formats, settings.width, settings.height)
        registered = self._register(recording)
        _set(depth, 'set_mirroring_enabled', False)
        colour_camera = self._add_colour(mode) if settings.colour else None
        width, height = mode.resolutionX, mode.resolutionY
        reported = _camera(depth, width, height)
        camera, source = chosen(reported, "the device's field of view", settings, width, height)
        info = device.get_device_info()
        for (
            name,
            stream,
        ) in self._streams.items():  # last: stopping a stream while it starts crashes some drivers
            self._mirrored[name] = _is_mirrored(stream)
            stream.start()
        said = ' '.join(p.decode(errors='replace') for p in (info.vendor, info.name, info.uri) if p)
        return DeviceInfo(said, camera, source, registered, recording, colour_camera)

    def _set_mode(self, stream: Any, formats: tuple[Any, ...], width: int, height: int) -> Any:
        """Set the requested size, else 640 x 480 or what there is, at 30 Hz if there is a choice."""
        modes = [m for m in stream.get_sensor_info().videoModes if m.pixelFormat in formats]
        sized = [m for m in modes if (m.resolutionX, m.resolutionY) == (width or 640, height or 480)]
        if width and height and not sized:
            sizes = sorted({f'{m.resolutionX}x{m.resolutionY}' for m in modes})
            raise DriverError(Fault.MODE, f'no mode of {width}x{height}; there are {", ".join(sizes)}')
        if not modes:
            raise DriverError(Fault.MODE, 'the device offers no image in a format that is known here')
        best = min(sized or modes, key=lambda m: (formats.index(m.pixelFormat), abs(m.fps - 30)))
        if (stream.video_mode.resolutionX, stream.video_mode.resolutionY, stream.video_mode.pixelFormat) != (
            best.resolutionX,
            best.resolutionY,
            best.pixelFormat,
        ):
            stream.set_video_mode(best)
        return best

    def _register(self, recording: bool) -> bool:
        """Register depth to the colour camera, if requested."""
        if not self._settings.registered or recording:
            return False
        mode = self._api.IMAGE_REGISTRATION_DEPTH_TO_COLOR
        if not self._device.is_image_registration_mode_supported(mode):
            raise DriverError(
                Fault.MODE, 'the device cannot register depth to colour', 'leave registered off'
            )
        self._device.set_image_registration_mode(mode)
        return True

    def _add_colour(self, mode: Any) -> Camera | None:
        """Start colour too; None if it is not available, which leaves depth unaffected."""
        stream = self._device.create_color_stream()
        if stream is None:
            return None
        try:
            if not self._device.is_file():
                self._set_mode(stream, (self._api.PIXEL_FORMAT_RGB888,), mode.resolutionX, mode.resolutionY)
        except DriverError:
            stream.close()
            return None
        _set(stream, 'set_mirroring_enabled', False)
        self._streams[COLOUR] = stream
        width, height = stream.video_mode.resolutionX, stream.video_mode.resolutionY
        # without a reported field of view, that of depth is a better guess than nothing
        return _camera(stream, width, height) or from_field_of_view(width, height, 1.0226, 0.7966)

    def _capture(self, frame: Any, arrival_ns: int) -> Capture | None:
        self._last_index, self._last_s = frame.frameIndex, time.monotonic()
        format_, height, width = frame.videoMode.pixelFormat, frame.height, frame.width
        is_depth = frame.sensorType == self._api.SENSOR_DEPTH
        if not is_depth and format_ != self._api.PIXEL_FORMAT_RGB888:
            return None  # a recording's, which cannot be asked for another
        data = np.frombuffer(frame.get_buffer_as_uint8(), np.uint8)
        rows = np.lib.stride_tricks.as_strided(data, (height, frame.stride), (frame.stride, 1))
        pixels: NDArray[Any] = rows[:, : width * (2 if is_depth else 3)].copy()
        pixels = pixels.view('<u2') if is_depth else pixels.reshape(height, width, 3)
        if is_depth and format_ == self._api.PIXEL_FORMAT_DEPTH_100_UM:
            pixels = pixels * METRES_PER_100_UM
        elif is_depth and format_ != self._api.PIXEL_FORMAT_DEPTH_1_MM:
            raise DriverError(Fault.MODE, f'depth in the format {format_}, which is no length')
        stream = DEPTH if is_depth else COLOUR
        if self._mirrored[stream]:
            pixels = pixels[:, ::-1]
        pixels = _uncropped(pixels, frame)
        return Capture(stream, pixels, int(frame.timestamp) * MICROSECOND_NS, arrival_ns)

    def _look_for_end(self) -> None:
        if not self.info.recording or self._settings.repeat:
            return
        silent_s = time.monotonic() - self._last_s
        if self._last_index < 0 and silent_s > SILENT_RECORDING_S:
            raise DriverError(Fault.RECORDING, f'{self.info.name} holds no depth that OpenNI2 can play')
        if self._last_index >= 0 and silent_s > SILENT_RECORDING_S:
            raise EndOfRecording


def _camera(stream: Any, width: int, height: int) -> Camera | None:
    try:
        horizontal, vertical = stream.get_horizontal_fov(), stream.get_vertical_fov()
    except Exception:  # a device without one: the binding's OpenNIError
        return None
    return from_field_of_view(width, height, horizontal, vertical)


def _is_mirrored(stream: Any) -> bool:
    try:
        return bool(stream.get_mirroring_enabled())
    except Exception:  # a driver without this call does not mirror
        return False


def _uncropped(pixels: NDArray[Any], frame: Any) -> NDArray[Any]:
    """The full image, so that the intrinsics hold, with 0 outside the part that was sent."""
    height, width = frame.videoMode.resolutionY, frame.videoMode.resolutionX
    if not frame.croppingEnabled or pixels.shape[:2] == (height, width):
        return pixels
    full = np.zeros((height, width, *pixels.shape[2:]), pixels.dtype)
    y, x = frame.cropOriginY, frame.cropOriginX
    full[y : y + pixels.shape[0], x : x + pixels.shape[1]] = pixels
    return full


def _set(stream: Any, setter: str, value: Any) -> None:
    _quietly(lambda: getattr(stream, setter)(value))


def _quietly(call: Any) -> None:
    try:
        call()
    except Exception:  # the device is gone, or does not support the call
        return
