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

"""A camera that publishes a recording as coloured clouds; its arguments are the bag and, if less, seconds.

32 bytes a point, as a Kinect's driver sends them: x, y, z, padding, rgb, padding. Stamps are the clock's.
It waits for the scan to be ready, sends each frame when it is due, and prints how many it sent.
"""

import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from numba import njit
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField

from debris_scanner.core.camera import Camera
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import TOPIC, read_reports
from debris_scanner.nodes.lifecycle.middleware import prepare
from msg_adapters.bags import open_session
from msg_adapters.clouds import byte_array
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import header_message

POINT = 32
STAGES = {'preprocess', 'odometry', 'closure', 'graph'}
_START_S = 60.0


def main() -> None:
    bag, seconds = Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else np.inf
    prepare(local_only=True)
    rclpy.init()
    node = rclpy.create_node('cloud_camera')
    publisher = node.create_publisher(PointCloud2, 'points', qos.cloud_publisher())
    with open_session(bag) as session:
        frames = (f for _, f in session if not isinstance(f, MalformedMessage))
        first = next(frames)
        rays = _rays(first.camera)
        data = np.zeros((*first.depth.shape, POINT), np.uint8)
        values = data.view(np.float32)
        _fill(first.depth, *rays, values)
        message = _message(first.depth.shape)
        _await_stages(node)
        sent, start_ns = 0, time.time_ns()
        for frame in (f for source in ([first], frames) for f in source):
            offset_ns = frame.stamp_ns - first.stamp_ns
            if offset_ns > seconds * 1e9:
                break
            _fill(frame.depth, *rays, values)
            message.data = byte_array(data)
            message.header = header_message(start_ns + offset_ns, 'camera_depth_optical_frame')
            time.sleep(max(0.0, (start_ns + offset_ns - time.time_ns()) * 1e-9))
            publisher.publish(message)
            sent += 1
    time.sleep(1.0)
    print(sent)
    rclpy.try_shutdown()


@njit(cache=True)
def _fill(
    depth: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32], values: NDArray[np.float32]
) -> None:
    grey = np.float32(1.18e-38)  # packed rgb: some colour, no NaN
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            z = z if z > 0 else np.float32(np.nan)
            values[v, u, 0], values[v, u, 1], values[v, u, 2] = x[u] * z, y[v] * z, z
            values[v, u, 4] = grey


def _rays(camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return x.astype(np.float32), y.astype(np.float32)


def _message(shape: tuple[int, int]) -> PointCloud2:
    height, width = shape
    fields = [
        PointField(name=name, offset=offset, datatype=PointField.FLOAT32, count=1)
        for name, offset in (('x', 0), ('y', 4), ('z', 8), ('rgb', 16))
    ]
    return PointCloud2(height=height, width=width, fields=fields, point_step=POINT, row_step=POINT * width)


def _await_stages(node: Node) -> None:
    """Until the four nodes, or the one, have found each other: what is sent before is lost."""
    ready: set[str] = set()

    def listen(msg: DiagnosticArray) -> None:
        ready.update(report.stage for report in read_reports(msg) if report.ready)

    node.create_subscription(DiagnosticArray, TOPIC, listen, qos.waiting())
    deadline = time.monotonic() + _START_S
    while not (ready >= STAGES or 'scanner' in ready) and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    time.sleep(0.5)


if __name__ == '__main__':
    main()
