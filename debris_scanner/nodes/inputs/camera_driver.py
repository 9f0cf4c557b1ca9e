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

"""The base of the camera drivers: publishes a device's images, and reports its faults."""

import re
import threading
import time
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from debris_scanner.core.camera import Camera
from debris_scanner.drivers.captures import DEPTH, Capture, DeviceInfo, DeviceSettings
from debris_scanner.drivers.faults import DriverError
from debris_scanner.drivers.supervisor import DeviceSupervisor, Listener
from debris_scanner.nodes.inputs.cameras import COLOUR as COLOUR_IMAGE
from debris_scanner.nodes.inputs.cameras import DEPTH as DEPTH_IMAGE
from debris_scanner.nodes.inputs.cameras import INFO
from debris_scanner.nodes.inputs.sources import WaitingNode
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, WARN, Problem, throughput
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import DEFAULT_SENSOR_FRAME
from msg_adapters.clouds import byte_array
from msg_adapters.depth_images import camera_info_message
from msg_adapters.stamps import header_message

COLOUR_INFO = 'rgb/camera_info'
DEFAULT_COLOUR_FRAME = 'camera_rgb_optical_frame'
_ENCODINGS = {'uint16': '16UC1', 'float32': '32FC1', 'uint8': 'rgb8'}
_FLUSH_S = 0.5  # lets the last message leave before its publisher ends


class CameraDriverNode(WaitingNode):
    """``depth/image_raw`` and ``rgb/image_raw`` with camera_info, from a device that may be unplugged.

    Stamps are the device's times converted to the system clock, in nanoseconds. Registered depth images have
    the frame of the colour camera.

    Args:
        name: of the node.
        driver: ``openni2`` or ``freenect``.
        device_doc: description of the parameter ``device``.
    """

    def __init__(self, name: str, driver: str, device_doc: str) -> None:
        super().__init__(name, wait_s=0.0)
        settings = _declared(self, device_doc, self.own_settings())
        self._frame_id = declare(self, 'frame_id', DEFAULT_SENSOR_FRAME, 'optical frame of the depth camera')
        self._colour_frame_id = declare(
            self, 'rgb_frame_id', DEFAULT_COLOUR_FRAME, 'optical frame of the colour camera'
        )
        self._image = self.create_publisher(Image, DEPTH_IMAGE, qos.cloud_publisher())
        self._info = self.create_publisher(CameraInfo, INFO, qos.waiting())
        self._colour = self.create_publisher(Image, COLOUR_IMAGE, qos.cloud_publisher())
        self._colour_info = self.create_publisher(CameraInfo, COLOUR_INFO, qos.waiting())
        self.awaited = (self._image, self._info)
        self._device: DeviceInfo | None = None
        self._fault: DriverError | None = None
        self._reported = ''  # the fault that was logged last
        self._begun = False
        self._ended_s: float | None = None
        self._rate = throughput(self.diagnostics.counts, 'published')
        listener = Listener(self._on_opened, self._on_capture, self._on_fault, self._on_end)
        self._supervisor = DeviceSupervisor(driver, settings, listener)
        self._stop = threading.Event()
        self._starter = threading.Thread(target=self._begin, name='starter', daemon=True)
        self.create_timer(0.1, self._look)
        self._starter.start()

    def own_settings(self) -> dict[str, Any]:
        """Settings of the device that only this driver has, declared as parameters."""
        return {}

    def diagnostic_values(self) -> dict[str, Any]:
        """The device, the source of its intrinsics, and images per second."""
        values: dict[str, Any] = {'frames_per_second': self._rate()} if self._begun else {}
        if (device := self._device) is not None:
            values |= {'device': device.name, 'intrinsics': device.intrinsics}
            values |= {n: round(getattr(device.camera, n), 3) for n in ('fx', 'fy', 'cx', 'cy')}
        if (process := self._supervisor.process_id) is not None:
            values['device_process'] = process
        return values

    def problem(self) -> Problem | None:
        """Why no image comes."""
        if self._fault is not None:
            return ERROR, str(self._fault)
        if not self._begun:
            return WARN, 'waiting for subscribers before the device is opened'
        return (WARN, 'opening the device') if self._device is None else None

    def close(self) -> None:
        """Release the device."""
        self._stop.set()
        self._starter.join()
        self._supervisor.stop()
        super().close()

    def reset(self) -> None:
        """A camera continues; only the scan begins anew."""

    def _begin(self) -> None:
        if self.waits and not self.wait(self._stop):
            return
        self._begun = True
        if not self._stop.is_set():
            self._supervisor.start()

    def _on_opened(self, device: DeviceInfo) -> None:
        camera = device.camera
        self._device, self._fault, self._reported = device, None, ''
        self.get_logger().info(
            f'{device.name}: {camera.width}x{camera.height}, fx {camera.fx:.1f} fy {camera.fy:.1f} '
            f'cx {camera.cx:.1f} cy {camera.cy:.1f} ({device.intrinsics})'
        )

    def _on_capture(self, capture: Capture) -> None:
        device = self._device
        assert device is not None
        stamp_ns = capture.stamp_ns
        if capture.stream == DEPTH:
            frame_id = self._colour_frame_id if device.registered else self._frame_id
            self._info.publish(camera_info_message(stamp_ns, frame_id, device.camera))
            self._image.publish(image_message(stamp_ns, frame_id, capture))
            self.diagnostics.counts['published'] += 1
        elif device.colour_camera is not None and self._colour.get_subscription_count():
            # registered images are seen by one camera, also where its intrinsics are given
            camera = device.camera if device.registered else device.colour_camera
            info = camera_info_message(stamp_ns, self._colour_frame_id, _fitted(camera, capture))
            self._colour_info.publish(info)
            self._colour.publish(image_message(stamp_ns, self._colour_frame_id, capture))
            self.diagnostics.counts['published_colour'] += 1

    def _on_fault(self, error: DriverError, retry_s: float) -> None:
        self._device, self._fault = None, error
        self.diagnostics.counts['faults'] += 1
        fault = re.sub(
            r'\d+', '', f'{error.fault} {error.text}'
        )  # one that differs in numbers is logged once
        if fault != self._reported:
            self._reported = fault
            self.get_logger().error(f'{error} (next attempt in {retry_s:.0f} s)')

    def _on_end(self) -> None:
        self._ended_s = time.monotonic()
        self.get_logger().info(f'end of the recording: {self.diagnostics.counts["published"]} images sent')

    def _look(self) -> None:
        self._supervisor.check()
        if self._ended_s is not None and time.monotonic() - self._ended_s > _FLUSH_S:
            self.finished = True


def image_message(stamp_ns: int, frame_id: str, capture: Capture) -> Image:
    """Image of a capture: 16UC1 millimetres, 0 invalid; 32FC1 metres, NaN invalid (REP-118); or rgb8."""
    pixels = capture.pixels
    if pixels.dtype.kind == 'f':
        pixels = np.where(pixels > 0, pixels, np.float32(np.nan))
    height, width = pixels.shape[:2]
    return Image(
        header=header_message(stamp_ns, frame_id),
        height=height,
        width=width,
        encoding=_ENCODINGS[pixels.dtype.name],
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=byte_array(pixels),
    )


def _fitted(camera: Camera, capture: Capture) -> Camera:
    """The camera scaled to the size of a capture."""
    height, width = capture.pixels.shape[:2]
    if (height, width) == (camera.height, camera.width):
        return camera
    x, y = width / camera.width, height / camera.height
    return Camera(camera.fx * x, camera.fy * y, camera.cx * x, camera.cy * y, width, height)


def _declared(node: WaitingNode, device_doc: str, own: dict[str, Any]) -> DeviceSettings:
    d = DeviceSettings()
    pixels = 'in pixels; 0: as the device reports'
    return DeviceSettings(
        device=declare(node, 'device', d.device, device_doc),
        library=declare(node, 'library', d.library, 'shared library to load; empty: the installed one'),
        max_rate_hz=declare(
            node,
            'max_rate_hz',
            d.max_rate_hz,
            'most images a second',
            0.1,
            120.0,
        ),
        colour=declare(node, 'colour', d.colour, 'publish colour too, where subscribed to'),
        registered=declare(node, 'registered', d.registered, 'register depth to the colour camera'),
        fx=declare(node, 'fx', d.fx, f'focal length {pixels}', 0.0, 1e5),
        fy=declare(node, 'fy', d.fy, f'focal length {pixels}, or fx if given', 0.0, 1e5),
        cx=declare(node, 'cx', d.cx, f'principal point {pixels}', 0.0, 1e5),
        cy=declare(node, 'cy', d.cy, f'principal point {pixels}', 0.0, 1e5),
        **own,
    )
