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

"""Node ``play_bag``: plays the depth frames of a bag in real time, byte for byte as recorded."""

import struct
import sys
import time
from collections.abc import Iterator
from functools import partial
from itertools import islice
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from debris_scanner.core.parameters import ParameterError
from debris_scanner.core.stamps import JUMP_S, replay_values
from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, INFO, POINTS
from debris_scanner.nodes.inputs.sources import Due, SourceNode
from debris_scanner.nodes.inputs.synchroniser import COMPRESSED
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.parameters import declare, declare_path
from debris_scanner.nodes.lifecycle.process import run
from msg_adapters.bags import SENSOR_ODOMETRY, sensor_odometry_topic
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.camera_infos import of_rectified
from msg_adapters.inputs.choice import choose_input, decode, depth_unit, static_messages
from msg_adapters.inputs.decoder import InputOptions
from msg_adapters.inputs.static_frames import TF_STATIC, TF_TYPE
from msg_adapters.raw_bags import open_bag
from msg_adapters.raw_messages import RawMessage
from msg_adapters.stamps import NANOSECONDS, read_stamp, time_message

CLOCK_S = 0.01  # of wall-clock time
LONGEST_PAUSE_S = 60.0  # of wall-clock time: a silence that would last longer is not waited for


class PlayBagNode(SourceNode):
    """``points``, or ``depth/image_raw`` with ``depth/camera_info``, whatever the bag calls them.

    Stamps stay as recorded, because they identify the frames. The diagnostics report when the first was
    published. Where the bag's time jumps, or nothing was recorded for minutes, it plays on at once.
    """

    def __init__(self) -> None:
        super().__init__('play_bag')
        path = declare_path(self, 'bag', 'rosbag2 folder or file, or ROS 1 bag')
        topic = declare(self, 'topic', '', 'topic to play; empty: the most suitable one')
        self._rate = declare(self, 'rate', 1.0, 'speed, times real time', 0.001, 1000.0)
        self._loops = declare(self, 'loops', 1, 'times to play the bag in a row; stamps keep increasing', 1)
        clock = declare(self, 'clock', False, "publish the recording's time on /clock")
        self._start_ns: int | None = None
        if path is None:
            raise ParameterError('parameter bag is empty: no bag to play')
        self._bag = open_bag(path)
        # whoever names a topic has its axes, too: the node that scans it is told them
        told = InputOptions(axes='x,y,z') if topic else None
        self._input = choose_input(self._bag, topic or None, told)
        for warning in self._bag.warnings:
            self.get_logger().warning(warning)
        if unit := depth_unit(self._bag, self._input.topic):
            self.get_logger().warning(
                f'its depth is in units of {unit:g} m, which no image says: tell preprocess or scanner '
                f'depth_scale:={unit:g}'
            )
        self._first: tuple[int, int] | None = None  # stamp, and when it was published
        self._clock_from: tuple[int, int] | None = None  # time of the recording, and when that was, ns
        self._skipped_ns = 0  # of the recording's time, up to the latest message sent
        if clock:
            self._times = self.create_publisher(Clock, '/clock', qos.waiting())
            self.create_timer(CLOCK_S, self._tick)
        if self._input.info_topic is None:
            frames = self.create_publisher(PointCloud2, POINTS, qos.cloud_publisher())
            self._outputs = {self._input.topic: frames}
        else:
            kind, name = (CompressedImage, COMPRESSED) if self._input.compressed else (Image, DEPTH)
            frames = self.create_publisher(kind, name, qos.cloud_publisher())
            info = self.create_publisher(CameraInfo, INFO, qos.waiting())
            self._outputs = {self._input.topic: frames, self._input.info_topic: info}
        awaited = tuple(self._outputs.values())
        if self._input.colour_topic is not None:
            colour = self.create_publisher(Image, COLOUR, qos.cloud_publisher())
            self._outputs[self._input.colour_topic] = colour
        if (odometry := sensor_odometry_topic(self._bag)) is not None:
            self._outputs[odometry] = self.create_publisher(Odometry, SENSOR_ODOMETRY, qos.waiting())
        if TF_TYPE is not None and self._input.info_topic is None:
            self._frames = self.create_publisher(TF_TYPE, TF_STATIC, qos.kept())
            for message in static_messages(self._bag):
                self._frames.publish(message.data)
        self.get_logger().info(f'playing {self._input.count} messages of {self._input.topic}')
        self.play(self._messages(), awaited)

    def diagnostic_values(self) -> dict[str, Any]:
        """The first stamp and when it was published, for latencies."""
        values = super().diagnostic_values()
        if self._first is not None:
            values |= replay_values(*self._first, self._rate)
        return values

    def close(self) -> None:
        """Stop playing."""
        super().close()
        self._bag.close()

    def _tick(self) -> None:
        """Publish the time that the recording has reached; it stands still while it waits and at the end."""
        if self._clock_from is not None and not self.ended:
            start_ns, since_ns = self._clock_from
            now_ns = start_ns + self._skipped_ns + round((time.monotonic_ns() - since_ns) * self._rate)
            self._times.publish(Clock(clock=time_message(now_ns)))

    def _messages(self) -> Iterator[Due]:
        yield from self._first_info()
        shift_ns = skipped_ns = 0
        last_ns: int | None = None
        for turn in range(self._loops):
            if turn:
                self.get_logger().info(f'playing again, {shift_ns * 1e-9:.2f} s later')
            times: list[int] = []  # of the frames, as the bag has them
            for raw in self._bag.messages(set(self._outputs)):
                is_frame = raw.topic == self._input.topic
                times += [raw.stamp_ns] if is_frame else []
                self._start_ns = raw.stamp_ns if self._start_ns is None else self._start_ns
                now_ns = raw.stamp_ns + shift_ns
                if last_ns is not None:
                    skipped_ns += self._skip(now_ns - last_ns)
                last_ns = now_ns
                offset_s = (now_ns - skipped_ns - self._start_ns) * 1e-9 / self._rate
                stamp_ns = _header_stamp(raw) if is_frame and self._first is None else None
                data = restamped(raw.data, shift_ns) if turn else raw.data
                yield Due(offset_s, partial(self._send, raw.topic, data, stamp_ns, skipped_ns), is_frame)
            # the next turn starts one frame period after the last frame
            shift_ns += times[-1] - times[0] + (times[-1] - times[0]) // max(1, len(times) - 1)

    def _first_info(self) -> Iterator[Due]:
        """The first camera_info comes first: it also applies to images that were recorded before it."""
        topic = self._input.info_topic
        if topic is not None:
            for raw in islice(self._bag.messages({topic}), 1):
                yield Due(0.0, partial(self._send, raw.topic, raw.data, None, 0), is_frame=False)

    def _skip(self, gap_ns: int) -> int:
        """How much of the time, ns, between two messages is not waited for."""
        if -JUMP_S <= gap_ns * 1e-9 / self._rate <= LONGEST_PAUSE_S:
            return 0
        self.get_logger().warning(
            f"the bag's time jumps by {gap_ns * 1e-9:.3f} s, or nothing was recorded for as long: playing on"
        )
        return gap_ns

    def _send(self, topic: str, data: bytes, stamp_ns: int | None, skipped_ns: int, _due_ns: int) -> None:
        self._skipped_ns = skipped_ns
        if self._clock_from is None and self._start_ns is not None:
            self._clock_from = self._start_ns, time.monotonic_ns()
        if stamp_ns is not None and self._first is None:
            self._first = stamp_ns, time.time_ns()
        if topic == self._input.info_topic and self._input.rectified:
            self._outputs[topic].publish(of_rectified(deserialize_message(data, CameraInfo)))
            return
        self._outputs[topic].publish(data)


def restamped(data: bytes, shift_ns: int) -> bytes:
    """A serialised message that begins with a header, its stamp shifted; all else is unchanged."""
    layout = '<iI' if data[1] & 1 else '>iI'  # the encapsulation names the byte order
    sec, nanosec = struct.unpack_from(layout, data, 4)
    moved = divmod(sec * NANOSECONDS + nanosec + shift_ns, NANOSECONDS)
    return data[:4] + struct.pack(layout, *moved) + data[12:]


def _header_stamp(raw: RawMessage) -> int | None:
    try:
        return read_stamp(decode(raw).header.stamp)
    except MalformedMessage:  # the next one may be readable
        return None


def main(args: list[str] | None = None) -> int:
    """Entry point of ``ros2 run debris_scanner play_bag``."""
    return run(PlayBagNode, args, images=True)


if __name__ == '__main__':
    sys.exit(main())
