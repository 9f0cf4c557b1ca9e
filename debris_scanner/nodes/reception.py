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

"""Subscriptions that know what they missed: the publisher numbers its messages, so gaps can be counted."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from msg_adapters.stamps import read_stamp


class Reception:
    """A subscription that counts messages received, and lost between publisher and here.

    Args:
        node: that subscribes.
        msg_type: of the topic.
        topic: its name.
        callback: called with the message and the time, ns, at which it was published.
        qos: of the subscription.
    """

    def __init__(
        self,
        node: Node,
        msg_type: type,
        topic: str,
        callback: Callable[[Any, int], None],
        qos: QoSProfile,
    ) -> None:
        self._node = node
        self._callback = callback
        self._sequence: int | None = None
        self._rated = (time.monotonic(), 0)
        self.type_name = _type_name(msg_type)
        self.arrived_s: float | None = None  # when the last message came, time.monotonic()
        self.stamp_ns: int | None = None  # of its header
        self.received = 0
        self.lost = 0
        self.subscription: Subscription = node.create_subscription(msg_type, topic, self._take, qos)

    def reset(self) -> None:
        """Count from zero; the publisher goes on numbering."""
        self.received = self.lost = 0
        self._rated = (time.monotonic(), 0)

    def rate(self) -> float:
        """Messages a second since this was last asked."""
        (last_s, count), now_s = self._rated, time.monotonic()
        self._rated = (now_s, self.received)
        return round((self.received - count) / max(now_s - last_s, 1e-3), 2)

    def _take(self, msg: Any, info: dict[str, int]) -> None:
        self.received += 1
        self.arrived_s = time.monotonic()
        if (header := getattr(msg, 'header', None)) is not None:
            self.stamp_ns = read_stamp(header.stamp)
        self._count_gap(int(info['publication_sequence_number']))
        if not getattr(self._node, 'taking', True):
            return
        self._callback(msg, int(info['source_timestamp']))

    def _count_gap(self, sequence: int) -> None:
        last, self._sequence = self._sequence, sequence
        if last is None or sequence <= last + 1:  # going back is another publisher
            return
        # numbers of several publishers interleave: nothing can be said then
        if self._node.count_publishers(self.subscription.topic_name) <= 1:
            self.lost += sequence - last - 1


def _type_name(msg_type: type) -> str:
    """As the graph of topics names it, such as ``sensor_msgs/msg/Image``."""
    package, kind, *_ = msg_type.__module__.split('.')
    return f'{package}/{kind}/{msg_type.__name__}'
