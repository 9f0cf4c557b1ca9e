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

"""What a device delivers and how it is opened: images with two times each, its settings, its intrinsics.

A `Capture` carries the device's own time and the time of its arrival. Pinhole intrinsics come from the user
(`DeviceSettings`), else from what the device reports.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from debris_scanner.core.camera import Camera
from debris_scanner.drivers.faults import DriverError, Fault

DEPTH, COLOUR = 'depth', 'colour'
GIVEN = 'given as parameters'


@dataclass(frozen=True)
class DeviceInfo:
    """An opened device."""

    name: str  # for people
    camera: Camera  # of the depth image
    intrinsics: str  # where they come from, in words
    registered: bool  # the depth image is brought to the colour camera's view
    recording: bool  # a file that ends, not a device
    colour_camera: Camera | None  # None: no colour


@dataclass(frozen=True)
class Capture:
    """One image: depth (h, w), uint16 millimetres or float32 metres, 0 invalid; or rgb (h, w, 3) uint8."""

    stream: str  # DEPTH or COLOUR
    pixels: NDArray[Any]
    device_ns: int  # the device's own clock, of any origin
    arrival_ns: int  # the system's clock when the library handed it over
    stamp_ns: int = 0  # when it was taken by the system's clock, from both


class DepthDevice(Protocol):
    """An opened device that streams."""

    info: DeviceInfo

    def read(self, timeout_s: float) -> Capture | None:
        """The next image, or None if none came in time.

        Raises:
            DriverError: the device is gone.
            EndOfRecording: nothing will come any more.
        """

    def close(self) -> None:
        """Stop and release the device."""


@dataclass(frozen=True)
class DeviceSettings:
    """What to open, and how; 0 or empty leaves the choice to the device."""

    device: str = ''  # URI, index, serial number, recording
    library: str = ''  # shared library to load in place of the installed one
    width: int = 0  # pixels
    height: int = 0  # pixels
    max_rate_hz: float = 15.0  # images a second that are passed on
    colour: bool = True
    registered: bool = False  # depth seen from the colour camera
    repeat: bool = False  # a recording starts over at its end
    fx: float = 0.0  # intrinsics of the depth image, pixels
    fy: float = 0.0
    cx: float = 0.0
    cy: float = 0.0


def from_field_of_view(width: int, height: int, horizontal_rad: float, vertical_rad: float) -> Camera | None:
    """Camera of a field of view, or None if the angles are not valid.

    The optical axis meets pixel (width/2, height/2), as in OpenNI2's own conversion to world coordinates
    (oniCoordinateConverterDepthToWorld: x = (u/width - 1/2) z 2 tan(h/2)).
    """
    if not (0 < horizontal_rad < math.pi and 0 < vertical_rad < math.pi):
        return None
    fx, fy = width / (2 * math.tan(horizontal_rad / 2)), height / (2 * math.tan(vertical_rad / 2))
    return Camera(fx, fy, width / 2, height / 2, width, height)


def chosen(
    reported: Camera | None, source: str, settings: DeviceSettings, width: int, height: int
) -> tuple[Camera, str]:
    """Camera to publish and its source: parameters first, value by value, then the device.

    Args:
        reported: camera from the device, or None.
        source: where the device's camera comes from, in words.
        settings: fx, fy, cx, cy in pixels; 0 where not given.
        width: of the image, pixels.
        height: likewise.

    Raises:
        DriverError: neither gives a focal length.
    """
    if reported is None:
        if settings.fx <= 0:
            raise DriverError(
                Fault.INTRINSICS,
                'the device tells no field of view',
                'give fx (and fy, cx, cy), pixels, as parameters',
            )
        reported = Camera(settings.fx, settings.fy or settings.fx, width / 2, height / 2, width, height)
        source = 'the middle of the image'
    values = {'fx': settings.fx, 'fy': settings.fy or settings.fx, 'cx': settings.cx, 'cy': settings.cy}
    given = {name: value for name, value in values.items() if value}
    if not given:
        return reported, source
    camera = Camera(
        settings.fx or reported.fx,
        values['fy'] or reported.fy,
        settings.cx or reported.cx,
        settings.cy or reported.cy,
        reported.width,
        reported.height,
    )
    return camera, GIVEN if len(given) == 4 else f'{", ".join(given)} {GIVEN}, else {source}'
