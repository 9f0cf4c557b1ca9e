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

"""Quality of service of all topics, in one place so that both ends agree.

Our publishers are reliable; best-effort subscribers match them as well. Subscribers keep long queues, so that
a worker that pauses for a second loses no frames.
"""

from collections.abc import Sequence

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

SENT_CLOUDS = 10
WAITING = 100  # ten seconds of a 10 Hz sensor
RECENT = 20
KEPT = 300

RELIABLE, BEST_EFFORT, BEST_AVAILABLE = 'reliable', 'best_effort', 'best_available'


def _profile(depth: int, reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def cloud_publisher() -> QoSProfile:
    """For publishers of large messages, frame by frame."""
    return _profile(SENT_CLOUDS)


def waiting() -> QoSProfile:
    """For messages that all must arrive at a stage that may be busy."""
    return _profile(WAITING)


def kept() -> QoSProfile:
    """For small messages that are sent again to a stage that restarts."""
    return _profile(KEPT, latched=True)


def recent() -> QoSProfile:
    """For frames that should be processed soon: under overload the oldest are dropped, and counted."""
    return _profile(RECENT)


def latched() -> QoSProfile:
    """For messages that a late joiner needs: the model, the state."""
    return _profile(1, latched=True)


def sensor_input(reliability: str, depth: int) -> QoSProfile:
    """For the sensor's topics: best effort matches every publisher, reliable loses nothing."""
    return _profile(depth, reliable=reliability == RELIABLE)


def offered_by_all(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """The strongest profile that matches all of some publishers.

    ROS's own "best available" looks at those that are there when a subscription is made, and then no more.
    """
    profiles = [p.qos_profile for p in publishers]
    return _profile(
        depth,
        reliable=all(p.reliability == ReliabilityPolicy.RELIABLE for p in profiles),
        latched=all(p.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in profiles),
    )
