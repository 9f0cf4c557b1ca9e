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

"""Subscriptions that know what they missed: the publisher numbers its messages, so gaps can be counted.

Why nothing arrives on a topic, in words: who publishes, with which QoS, and what came last.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from msg_adapters.stamps import read_stamp


class CountingSubscription:
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


_NAMED = 3  # topics that are offered instead, at most
_OURS = ('target_points', 'keyframe_points', 'model')  # nobody means to scan these


def explain(node: Node, reception: CountingSubscription) -> str:
    """One sentence on a subscription to which nothing comes."""
    topic = reception.subscription.topic_name
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return f'{topic} has no publisher{_instead(node, reception)}'
    if why := incompatible(node, reception, publishers):
        return why
    who = ', '.join(f'{name_of(p)} ({qos_words(p.qos_profile)})' for p in publishers)
    plural = 's' if len(publishers) > 1 else ''
    return f'{topic} has {len(publishers)} publisher{plural}, {who}; {_last(reception)}'


def incompatible(node: Node, reception: CountingSubscription, publishers: Sequence[TopicEndpointInfo]) -> str:
    """Publishers that can never be heard, with the policy that forbids it; empty where all can."""
    asked = reception.subscription.qos_profile
    topic = reception.subscription.topic_name
    said = []
    for publisher in publishers:
        if publisher.topic_type != reception.type_name:
            said.append(f'{name_of(publisher)} publishes {publisher.topic_type}, not {reception.type_name}')
            continue
        compatible, reason = qos_check_compatible(publisher.qos_profile, asked)
        if compatible == QoSCompatibility.ERROR:
            policies = _policies(publisher.qos_profile, asked)
            said.append(f'{name_of(publisher)} offers {policies or reason}')
    return f'{topic}: {"; ".join(said)}' if said else ''


def name_of(publisher: TopicEndpointInfo) -> str:
    """Full name of the node behind a publisher."""
    return f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'


def qos_words(profile: QoSProfile) -> str:
    """Reliability and durability of a profile."""
    return f'{_word(profile.reliability)}, {_word(profile.durability)}'


def input_values(node: Node, counting_subscriptions: Sequence[CountingSubscription]) -> dict[str, Any]:
    """Key-values of each subscription: messages, age of the last, its stamp, losses, publishers."""
    values: dict[str, Any] = {}
    for reception in counting_subscriptions:
        key = f'input.{reception.subscription.topic_name.removeprefix(node.get_namespace()).lstrip("/")}'
        values[f'{key}.received'] = reception.received
        values[f'{key}.lost'] = reception.lost
        values[f'{key}.per_second'] = reception.rate()
        values[f'{key}.publishers'] = node.count_publishers(reception.subscription.topic_name)
        if reception.arrived_s is not None:
            values[f'{key}.age_s'] = round(time.monotonic() - reception.arrived_s, 2)
        if reception.stamp_ns is not None:
            values[f'{key}.stamp_ns'] = reception.stamp_ns
    return values


def _policies(offered: QoSProfile, asked: QoSProfile) -> str:
    """The policies that differ in a way that forbids delivery."""
    return ' and '.join(
        f'{policy.upper()} {_word(getattr(offered, policy))}, {_word(getattr(asked, policy))} is asked for'
        for policy, too_little in (('reliability', 'best effort'), ('durability', 'volatile'))
        if _word(getattr(offered, policy)) == too_little and _word(getattr(asked, policy)) != too_little
    )


def _instead(node: Node, reception: CountingSubscription) -> str:
    """Topics of the type that somebody does publish."""
    others = [
        name
        for name, types in node.get_topic_names_and_types()
        if reception.type_name in types
        and name != reception.subscription.topic_name
        and name.rpartition('/')[2] not in _OURS
        and node.count_publishers(name)
    ]
    if not others:
        return ''
    return f' (its type is published on {", ".join(sorted(others)[:_NAMED])}: remap?)'


def _last(reception: CountingSubscription) -> str:
    if reception.arrived_s is None:
        return 'nothing came yet'
    stamp = '' if reception.stamp_ns is None else f', stamped {reception.stamp_ns * 1e-9:.3f} s'
    return f'the last message came {time.monotonic() - reception.arrived_s:.0f} s ago{stamp}'


def _word(policy: Any) -> str:
    return str(policy.name).lower().replace('_', ' ')
