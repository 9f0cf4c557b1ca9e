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

"""Node ``freenect_camera``: publishes a Kinect v1, or a folder that libfreenect's ``record`` wrote."""

import sys

from debris_scanner.drivers.library_check import FREENECT
from debris_scanner.nodes.inputs.camera_driver import CameraDriverNode
from debris_scanner.nodes.lifecycle.process import run

DEVICE = 'index, serial number or recorded folder; empty: the first one found'


class FreenectCameraNode(CameraDriverNode):
    """A Kinect through libfreenect; see :mod:`debris_scanner.drivers.freenect_device`."""

    def __init__(self) -> None:
        super().__init__('freenect_camera', FREENECT, DEVICE)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner freenect_camera``."""
    return run(FreenectCameraNode, args, images=True)


if __name__ == '__main__':
    sys.exit(main())
