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

"""The base class of all nodes: diagnostics, counted subscriptions, and a reset."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.service import Service
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from debris_scanner.core.timing import StageTimer
from debris_scanner.faults import Faults
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, WARN, Diagnostics, Problem, together
from debris_scanner.nodes.lifecycle.subscriptions import CountingSubscription, incompatible, input_values

RESET_TOPIC = 'reset'  # std_msgs/Empty: all nodes start a new scan
PAUSED_TOPIC = 'paused'  # std_msgs/Bool, latched: whether frames are dropped
DEFAULT_SENSOR_FRAME = 'camera_depth_optical_frame'

_FORGOTTEN_S = 25.0  # after so long discovery has removed a process that was killed
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


class StageNode(Node):
    """A node with diagnostics and ``~/reset``; see :func:`debris_scanner.nodes.lifecycle.process.run`."""

    unsaved = False  # the scan has ended, and its last result could not be saved
    finished = False
    autostart = True  # False: a lifecycle manager configures it

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.fixed_once_configured: set[str] = set()  # parameters, where a lifecycle manager configures it
        self.timer = StageTimer()
        self.faults = Faults(self.get_logger().error)
        self.counting_subscriptions: list[CountingSubscription] = []
        self._duplicates_since_s: float | None = None
        self.diagnostics = Diagnostics(self, name, self.timer, self._values, self._problem)
        self.diagnostics.errors = self.faults.counts
        self.create_subscription(Empty, RESET_TOPIC, lambda _: self.reset(), qos.waiting())

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], Any], *args: Any, **kwargs: Any
    ) -> Any:
        """A timer of the steady clock: with ``use_sim_time`` a silent /clock must not stop the node."""
        kwargs.setdefault('clock', _STEADY)
        return super().create_timer(timer_period_sec, callback, *args, **kwargs)

    @property
    def active(self) -> bool:
        """Whether messages are processed."""
        return True

    def _values(self) -> dict[str, Any]:
        return input_values(self, self.counting_subscriptions) | self.diagnostic_values()

    def _problem(self) -> Problem | None:
        """The node's own problem and what was lost; else an input whose publisher is incompatible."""
        losses = [(WARN, s.loss) for s in self.counting_subscriptions]
        if (problem := together(self._duplicates() or self.problem(), *losses)) is not None:
            return problem
        for subscription in self.counting_subscriptions:
            publishers = self.get_publishers_info_by_topic(subscription.topic_name)
            if why := incompatible(subscription, publishers):
                return ERROR, why
        return None

    def _duplicates(self) -> Problem | None:
        """Another node of this name; discovery still lists a killed one for a while."""
        own = (self.get_name(), self.get_namespace())
        same = [name for name in self.get_node_names_and_namespaces() if name == own]
        if len(same) < 2:
            self._duplicates_since_s = None
            return None
        self._duplicates_since_s = self._duplicates_since_s or time.monotonic()
        if time.monotonic() - self._duplicates_since_s < _FORGOTTEN_S:
            return None
        name = self.get_fully_qualified_name()
        return WARN, f'{len(same)} nodes are called {name}: two scanners need a namespace each'

    def diagnostic_values(self) -> dict[str, Any]:
        """Further key-values of the node's diagnostics."""
        return {}

    def problem(self) -> Problem | None:
        """Level and message of what is wrong with the node; None if nothing is."""
        return None

    def receive(
        self,
        msg_type: type,
        topic: str,
        callback: Callable[[Any, int], None],
        profile: Any,
        drained: Callable[[], None] | None = None,
    ) -> CountingSubscription:
        """Subscribe, counting messages that are lost on the way; arguments as of the subscription.

        A message whose callback raises is left out, and no other of those that are taken at once.
        """

        def contained(message: Any, published_ns: int) -> None:
            with self.faults.contained(f'a message on {self.resolve_topic_name(topic)}'):
                callback(message, published_ns)

        subscription = CountingSubscription(self, msg_type, topic, contained, profile, drained)
        self.counting_subscriptions.append(subscription)
        return subscription

    def stop_receiving(self, subscription: CountingSubscription) -> None:
        """Undo :meth:`receive`."""
        self.counting_subscriptions.remove(subscription)
        self.destroy_subscription(subscription.handle)

    def reset(self) -> None:
        """Start a new scan."""
        self.diagnostics.reset()
        self.faults.reset()
        for subscription in self.counting_subscriptions:
            subscription.reset()
        self.get_logger().info('reset: a new scan begins')

    def offer_reset(self) -> Service:
        """Offer ``~/reset``, which resets only this stage."""

        def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self.reset()
            response.success, response.message = True, f'{self.get_name()} starts a new scan'
            return response

        return self.create_service(Trigger, '~/reset', answer)

    def close(self) -> None:
        """Publish the final counts."""
        self.diagnostics.publish()
