"""Node ``freenect_camera``: a Kinect v1, or a folder that libfreenect's ``record`` wrote."""

import sys

from debris_scanner.drivers.library_check import FREENECT
from debris_scanner.nodes.camera_driver import CameraDriverNode
from debris_scanner.nodes.process import run

DEVICE = 'index or serial number of the Kinect, or a recorded folder; empty: the first Kinect there is'


class FreenectCameraNode(CameraDriverNode):
    """A Kinect through libfreenect; see :mod:`debris_scanner.drivers.freenect_device`."""

    def __init__(self) -> None:
        super().__init__('freenect_camera', FREENECT, DEVICE)


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner freenect_camera``."""
    return run(FreenectCameraNode, args)


if __name__ == '__main__':
    sys.exit(main())
