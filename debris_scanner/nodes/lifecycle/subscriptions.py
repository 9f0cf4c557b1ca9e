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

"""Subscriptions that count lost messages, and explain why a topic is silent.

Publishers number their messages, so a :class:`CountingSubscription` can count the gaps. :func:`explain`
names, for a subscription without messages, its publishers, their QoS, and the last message;
:func:`incompatible` the QoS policy that prevents delivery.
"""

import re
import time
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from debris_scanner.io.outcome import loss_words
from debris_scanner.nodes.lifecycle.middleware import PROFILE_VARIABLE, profile_of_drivers
from debris_scanner.nodes.lifecycle.qos import offered_by_all
from msg_adapters.stamps import read_stamp

# the middleware's defaults hold no whole image
LARGE_MESSAGES = f'{PROFILE_VARIABLE}={profile_of_drivers()}'
_MOST_ALTERNATIVES = 6  # topics that are offered instead


class CountingSubscription:
    """A subscription that counts messages received and lost.

    Args:
        node: that subscribes.
        msg_type: of the topic.
        topic: its name.
        callback: called with the message and the time, ns, at which it was published.
        qos: of the subscription.
        drained: called after the callbacks of all messages that waited, if the order to serve them matters.
            What was overwritten in a full queue then counts as ``overwritten``, not as lost.
    """

    def __init__(
        self,
        node: Node,
        msg_type: type,
        topic: str,
        callback: Callable[[Any, int], None],
        qos: QoSProfile,
        drained: Callable[[], None] | None = None,
    ) -> None:
        self._node = node
        self._drained = drained
        self._depth = qos.depth
        self._callback = callback
        self._sequence: int | None = None
        self._rated = (time.monotonic(), 0)
        self.type_name = _type_name(msg_type)
        self.arrived_s: float | None = None  # when the last message arrived, time.monotonic()
        self.stamp_ns: int | None = None  # of its header
        self.received = 0
        self.lost = 0
        self.overwritten = 0
        self._topic = msg_type, topic
        self.handle: Subscription = self._subscribed(qos)

    @property
    def topic_name(self) -> str:
        """Full name of the topic."""
        return str(self.handle.topic_name)

    @property
    def loss(self) -> str:
        """What was lost on the way, in words, with the remedy; empty up to a share that does no harm."""
        lost = loss_words(self.lost, self.received + self.lost, f'messages on {self.topic_name}')
        if not lost:
            return ''
        publishers = self._node.get_publishers_info_by_topic(self.topic_name)
        weak = [name_of(p) for p in publishers if p.qos_profile.reliability != ReliabilityPolicy.RELIABLE]
        if weak:
            return f'{lost}: have {", ".join(weak)} publish reliably, or start it with {LARGE_MESSAGES}'
        if publishers and self.handle.qos_profile.reliability != ReliabilityPolicy.RELIABLE:
            return f'{lost}: its publisher is reliable, so input_reliability need not be best_effort'
        return f'{lost}: start its publisher with {LARGE_MESSAGES}'

    def match_publishers(self) -> None:
        """Subscribe again, if all publishers that are there by now offer more, or one offers less."""
        publishers = self._node.get_publishers_info_by_topic(self.topic_name)
        wanted, now = offered_by_all(publishers, self._depth), self.handle.qos_profile
        if publishers and (wanted.reliability, wanted.durability) != (now.reliability, now.durability):
            self._node.destroy_subscription(self.handle)
            self.handle, self._sequence = self._subscribed(wanted), None

    def reset(self) -> None:
        """Count from zero; the publisher continues its numbers."""
        self.received = self.lost = self.overwritten = 0
        self._rated = (time.monotonic(), 0)

    def rate(self) -> float:
        """Messages per second since the last call."""
        (last_s, count), now_s = self._rated, time.monotonic()
        self._rated = (now_s, self.received)
        return round((self.received - count) / max(now_s - last_s, 1e-3), 2)

    def _subscribed(self, profile: QoSProfile) -> Subscription:
        msg_type, topic = self._topic
        return self._node.create_subscription(msg_type, topic, self._receive, profile)

    def _receive(self, msg: Any, info: dict[str, int]) -> None:
        lost = self.lost
        self._take(msg, info)
        if self._drained is None:
            return
        gap, taken = self.lost - lost, 1  # before the first message
        while taken <= self._depth and (waiting := self._waiting()) is not None:
            self._take(*waiting)
            taken += 1
        if taken >= self._depth:  # it was full, so the oldest gave way
            self.lost, self.overwritten = self.lost - gap, self.overwritten + gap
        if getattr(self._node, 'active', True):
            self._drained()

    def _waiting(self) -> tuple[Any, dict[str, int]] | None:
        """The next message of the queue."""
        queue = self.handle.handle
        with queue:
            waiting: tuple[Any, dict[str, int]] | None = queue.take_message(self.handle.msg_type, False)
        return waiting

    def _take(self, msg: Any, info: dict[str, int]) -> None:
        self.received += 1
        self.arrived_s = time.monotonic()
        if (header := getattr(msg, 'header', None)) is not None:
            self.stamp_ns = read_stamp(header.stamp)
        self._count_gap(int(info['publication_sequence_number']))
        if getattr(self._node, 'active', True):
            self._callback(msg, int(info['source_timestamp']))

    def _count_gap(self, sequence: int) -> None:
        last, self._sequence = self._sequence, sequence
        if last is None or sequence <= last + 1:  # a lower number is of another publisher
            return
        # the numbers of several publishers interleave and reveal no gap
        if self._node.count_publishers(self.topic_name) <= 1:
            self.lost += sequence - last - 1


def explain(node: Node, subscription: CountingSubscription) -> str:
    """One sentence on a subscription that receives no messages."""
    topic = subscription.topic_name
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return f'{topic} has no publisher'
    if why := incompatible(subscription, publishers):
        return why
    who = ', '.join(f'{name_of(p)} ({qos_words(p.qos_profile)})' for p in publishers)
    plural = 's' if len(publishers) > 1 else ''
    return f'{topic} has {len(publishers)} publisher{plural}, {who}; {_last(subscription)}'


def incompatible(subscription: CountingSubscription, publishers: Sequence[TopicEndpointInfo]) -> str:
    """Publishers whose messages cannot be delivered, with the policy that prevents it; else empty."""
    requested = subscription.handle.qos_profile
    reasons = []
    for publisher in publishers:
        if publisher.topic_type != subscription.type_name:
            reasons.append(
                f'{name_of(publisher)} publishes {publisher.topic_type}, not {subscription.type_name}'
            )
            continue
        compatible, reason = qos_check_compatible(publisher.qos_profile, requested)
        if compatible == QoSCompatibility.ERROR:
            policies = _policies(publisher.qos_profile, requested)
            reasons.append(f'{name_of(publisher)} offers {policies or reason}')
    return f'{subscription.topic_name}: {"; ".join(reasons)}' if reasons else ''


def usable_topics(node: Node, types: Collection[str], inputs: Collection[str]) -> str:
    """The topics of some types that somebody publishes, in words; empty if there are none.

    The outputs of our nodes are left out; these are told by listening to ``reset``, as no other does.

    Args:
        node: that asks.
        types: such as ``sensor_msgs/msg/Image``.
        inputs: names of inputs of ours, which our drivers publish, too.
    """
    ours = {
        (info.node_name, info.node_namespace)
        for name, _ in node.get_topic_names_and_types()
        if name.rpartition('/')[2] == 'reset'
        for info in node.get_subscriptions_info_by_topic(name)
    }
    listened = {subscription.topic_name for subscription in node.subscriptions}
    found = []
    for name, kinds in node.get_topic_names_and_types():
        kind = next((kind for kind in kinds if kind in types), None)
        if kind is None or name in listened:
            continue
        is_input = any(name.endswith(f'/{topic}') for topic in inputs)
        publishers = node.get_publishers_info_by_topic(name)
        if any(is_input or (p.node_name, p.node_namespace) not in ours for p in publishers):
            found.append(f'{name} ({kind.rpartition("/")[2]})')
    # names that tell of depth come first
    found.sort(key=lambda name: (not re.search('depth|point|cloud|stereo', name), name))
    more = len(found) - _MOST_ALTERNATIVES
    return ', '.join([*found[:_MOST_ALTERNATIVES], *([f'{more} more'] if more > 0 else [])])


def name_of(publisher: TopicEndpointInfo) -> str:
    """Full name of a publisher's node."""
    return f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'


def qos_words(profile: QoSProfile) -> str:
    """Reliability and durability of a profile."""
    return f'{_word(profile.reliability)}, {_word(profile.durability)}'


def input_values(node: Node, counting_subscriptions: Sequence[CountingSubscription]) -> dict[str, Any]:
    """Key-values of each subscription: messages, age of the last, its stamp, losses, publishers."""
    values: dict[str, Any] = {}
    for subscription in counting_subscriptions:
        topic = subscription.topic_name
        key = f'input.{topic.removeprefix(node.get_namespace()).lstrip("/")}'
        values[f'{key}.received'] = subscription.received
        values[f'{key}.lost'] = subscription.lost
        values[f'{key}.per_second'] = subscription.rate()
        values[f'{key}.publishers'] = node.count_publishers(topic)
        if subscription.arrived_s is not None:
            values[f'{key}.age_s'] = round(time.monotonic() - subscription.arrived_s, 2)
        if subscription.stamp_ns is not None:
            values[f'{key}.stamp_ns'] = subscription.stamp_ns
    return values


def _policies(offered: QoSProfile, asked: QoSProfile) -> str:
    """The policies that prevent delivery."""
    return ' and '.join(
        f'{policy.upper()} {_word(getattr(offered, policy))}, {_word(getattr(asked, policy))} is asked for'
        for policy, weaker in (('reliability', 'best effort'), ('durability', 'volatile'))
        if _word(getattr(offered, policy)) == weaker and _word(getattr(asked, policy)) != weaker
    )


def _last(subscription: CountingSubscription) -> str:
    if subscription.arrived_s is None:
        return 'no message yet'
    stamp = '' if subscription.stamp_ns is None else f', stamped {subscription.stamp_ns * 1e-9:.3f} s'
    return f'the last message came {time.monotonic() - subscription.arrived_s:.0f} s ago{stamp}'


def _type_name(msg_type: type) -> str:
    """The type as ROS names it, such as ``sensor_msgs/msg/Image``."""
    package, kind, *_ = msg_type.__module__.split('.')
    return f'{package}/{kind}/{msg_type.__name__}'


def _word(policy: Any) -> str:
    return str(policy.name).lower().replace('_', ' ')
