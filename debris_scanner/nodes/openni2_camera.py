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

"""Node ``openni2_camera``: publishes an Xtion, Carmine or other OpenNI2 device, or an .oni recording."""

import sys

from debris_scanner.drivers.captures import DeviceSettings
from debris_scanner.drivers.library_check import OPENNI2
from debris_scanner.nodes.inputs.camera_driver import CameraDriverNode
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.process import run

DEVICE = 'URI, or an .oni file; empty: the first one found'


class OpenNI2CameraNode(CameraDriverNode):
    """A camera through OpenNI2; see :mod:`debris_scanner.drivers.openni2_device`."""

    def __init__(self) -> None:
        super().__init__('openni2_camera', OPENNI2, DEVICE)

    def own_settings(self) -> dict[str, object]:
        """Image size, and whether a recording repeats."""
        d = DeviceSettings()
        size = 'in pixels; 0: 640 x 480 if offered'
        return {
            'width': declare(self, 'width', d.width, f'width {size}', 0, 4096),
            'height': declare(self, 'height', d.height, f'height {size}', 0, 4096),
            'repeat': declare(self, 'repeat', d.repeat, 'repeat a recording at its end'),
        }


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner openni2_camera``."""
    return run(OpenNI2CameraNode, args, images=True)


if __name__ == '__main__':
    sys.exit(main())
