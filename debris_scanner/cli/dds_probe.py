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

"""Sends a message to another process and back, to check that DDS works on this machine."""

import array
import contextlib
import os
import statistics
import subprocess
import sys
import time

from debris_scanner.nodes.lifecycle.middleware import prepare

PAYLOAD_BYTES = 1 << 20
ROUNDS = 5
DEADLINE_S = 15.0


def ping() -> str:
    """Send a megabyte to an echo process ROUNDS times; returns one line with the median time.

    Raises:
        TimeoutError: no message came back in time.
    """
    name = f'debris_scanner_probe_{os.getpid()}'
    prepare()
    echo = subprocess.Popen(
        [sys.executable, '-c', f'from debris_scanner.cli.dds_probe import echo; echo({name!r})'],
        stdin=subprocess.PIPE,
    )
    try:
        times = _measure(name)
    finally:
        echo.terminate()  # after SIGKILL its shared memory would stay
        try:
            echo.wait(timeout=5)
        except subprocess.TimeoutExpired:
            echo.kill()
            echo.wait()
    return f'1 MB to another process and back in {statistics.median(times) * 1e3:.1f} ms'


def _measure(name: str) -> list[float]:
    import rclpy
    from std_msgs.msg import UInt8MultiArray

    rclpy.init(args=[])
    node = rclpy.create_node(name)
    returned: list[int] = []
    node.create_subscription(UInt8MultiArray, f'{name}/back', lambda msg: returned.append(len(msg.data)), 5)
    publisher = node.create_publisher(UInt8MultiArray, f'{name}/out', 5)
    payload = UInt8MultiArray(data=array.array('B', bytes(PAYLOAD_BYTES)))
    deadline = time.monotonic() + DEADLINE_S
    times: list[float] = []
    try:
        while node.count_publishers(f'{name}/back') < 1 or publisher.get_subscription_count() < 1:
            rclpy.spin_once(node, timeout_sec=0.05)
            _in_time(deadline, 'the other process was not discovered')
        while len(times) < ROUNDS:
            start, before = time.monotonic(), len(returned)
            publisher.publish(payload)
            while len(returned) == before:
                rclpy.spin_once(node, timeout_sec=0.5)
                _in_time(deadline, 'no message came back')
            times.append(time.monotonic() - start)
    finally:
        rclpy.shutdown()
    return times


def _in_time(deadline: float, what: str) -> None:
    if time.monotonic() > deadline:
        raise TimeoutError(f'{what} within {DEADLINE_S:.0f} s')


def echo(name: str) -> None:
    """Send messages back until the parent terminates this process."""
    prepare()
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from std_msgs.msg import UInt8MultiArray

    rclpy.init(args=[])
    node = rclpy.create_node(f'{name}_echo')
    publisher = node.create_publisher(UInt8MultiArray, f'{name}/back', 5)
    node.create_subscription(UInt8MultiArray, f'{name}/out', publisher.publish, 5)
    end = time.monotonic() + 2 * DEADLINE_S  # in case the parent was killed
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        while time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.5)
    rclpy.try_shutdown()
