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

"""The sensor's topics as the messages of one frame each: clouds, or depth images with their colour.

:class:`FrameSynchroniser` subscribes to them. By :class:`PairedInput` a frame gets its image on ``mask``,
which chooses the target, and a depth image that of ``rgb/image_raw``, if it shows the same pixels.
"""

import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from debris_scanner.core.stamps import StampPairs
from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, DETECTION, INFO, MASK, POINTS
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, WARN, Problem
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.subscriptions import CountingSubscription, explain, usable_topics
from msg_adapters.inputs.camera_infos import other_view
from msg_adapters.stamps import read_stamp

try:
    import vision_msgs.msg as vision_messages
except ImportError:
    vision_messages = None

BOX_TYPE: Any = getattr(vision_messages, 'Detection2D', None)  # None where it is not installed
COMPRESSED, COLOUR_INFO = 'depth/image_raw/compressedDepth', 'rgb/camera_info'
NO_CAMERA_INFO, NO_MASK = 'no_camera_info', 'no_mask'

TICK_S = 0.03
_WAITING_IMAGES = 10
_USABLE = ('sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
_MATCH_S = 0.2  # between two looks at the publishers

DepthImage: TypeAlias = Image | CompressedImage


class FrameMessages(NamedTuple):
    """The messages of one frame, not decoded yet."""

    topic: str  # of its depth: POINTS, DEPTH or COMPRESSED
    depth: DepthImage | PointCloud2
    mask: Image | None  # or the box of a detector
    colour: Image | None = None  # beside a depth image, of the same pixels


class FrameSynchroniser:
    """Subscribes to the sensor's topics, and joins the messages of each frame by their stamps.

    Where masks are published, frames without one are left out.

    Args:
        node: that subscribes.
        choice: 'points' or 'depth' for clouds or depth images alone; all else for both.
        reliability: of the subscriptions, as in :func:`qos.sensor_input`, or ``qos.BEST_AVAILABLE``.
        depth: most messages that wait on a topic to be received.
        take: called with the messages of each frame, and when its depth was published, ns.
        leave_out: called for each frame that lacks a message, with the reason and why in words.
        serve: called once all clouds or depth images that waited have been taken.
    """

    def __init__(
        self,
        node: StageNode,
        choice: str,
        reliability: str,
        depth: int,
        take: Callable[[FrameMessages, int], None],
        leave_out: Callable[[str, str], None],
        serve: Callable[[], None],
    ) -> None:
        self.info: CameraInfo | None = None  # the latest
        self._node = node
        self._take = take
        self._leave_out = leave_out
        self._serve = serve
        self._colour_info: CameraInfo | None = None
        self._early: deque[tuple[DepthImage, int]] = deque()  # that came before the first camera_info
        profile = qos.sensor_input(reliability, depth)
        self._inputs: dict[str, CountingSubscription] = {}
        # a mask, or the box of a detector
        choosing = {MASK: Image} | ({} if BOX_TYPE is None else {DETECTION: BOX_TYPE})
        self._mask = PairedInput(node, choosing, profile, self._on_masked)
        compressed, colour_info = _beside(node, DEPTH, COMPRESSED), _beside(node, COLOUR, COLOUR_INFO)
        named = (POINTS, DEPTH, INFO, COLOUR, *choosing, compressed, colour_info)
        self._colour_info_topic = node.resolve_topic_name(colour_info)
        # a camera_info may be sent once, and kept, whatever reliability is asked for
        matched = named if reliability == qos.BEST_AVAILABLE else (INFO, colour_info)
        self._matched = {node.resolve_topic_name(topic) for topic in matched}
        if choice != 'depth':
            self._inputs[POINTS] = node.receive(PointCloud2, POINTS, self._mask.match, profile, serve)
        if choice != 'points':
            self._inputs[DEPTH] = node.receive(Image, DEPTH, self._on_image, profile, serve)
            self._inputs[COMPRESSED] = node.receive(
                CompressedImage, compressed, self._on_compressed, profile, serve
            )
            for topic, take_info in ((INFO, self._on_info), (colour_info, self._on_colour_info)):
                node.receive(CameraInfo, topic, take_info, profile)
        coloured = {} if choice == 'points' else {COLOUR: Image}  # clouds carry their colour
        self._colour = PairedInput(node, coloured, profile, self._on_pair)
        # until a publisher is there all match; each delivers by the time that its next message comes
        node.create_timer(_MATCH_S, self._match_publishers)

    @property
    def lost(self) -> int:
        """Messages that were published and never arrived."""
        return sum(s.lost for s in self._inputs.values())

    @property
    def overwritten(self) -> int:
        """Messages that were overwritten while they waited to be received."""
        return sum(s.overwritten for s in self._inputs.values())

    def silence(self) -> Problem:
        """Why no frames arrive: a warning where somebody publishes, else an error."""
        count = self._node.count_publishers
        # compressed images are mentioned where they are, or were, the input
        heard = [s for name, s in self._inputs.items() if name != COMPRESSED or count(s.topic_name)]
        reasons = [explain(self._node, s) for s in heard or self._inputs.values()]
        if others := usable_topics(self._node, _USABLE, (POINTS, DEPTH, COLOUR)):
            reasons.append(f'there are {others}: remap, or name the camera')
        published = any(count(s.topic_name) for s in self._inputs.values())
        return (WARN if published else ERROR), '; '.join(reasons)

    def hears(self, topic: str) -> bool:
        """Whether a topic is subscribed to; it is not once another one is selected."""
        return topic in self._inputs

    def select(self, topic: str) -> None:
        """Unsubscribe from the other inputs once one has delivered."""
        name = self._node.resolve_topic_name
        for other in [t for t in self._inputs if t != topic]:
            self._node.stop_receiving(self._inputs.pop(other))
            if other != COMPRESSED:
                self._node.get_logger().info(f'scanning {name(topic)}; {name(other)} is ignored')
            if topic == POINTS:
                self._colour.close()

    def reset(self) -> None:
        """Start a new scan."""
        self._mask.reset()
        self._colour.reset()

    def _match_publishers(self) -> None:
        for subscription in self._node.counting_subscriptions:
            if subscription.topic_name in self._matched:
                subscription.match_publishers()

    def _on_compressed(self, msg: CompressedImage, published_ns: int) -> None:
        raw = self._inputs.get(DEPTH)
        if raw is None or not self._node.count_publishers(raw.topic_name):
            self._on_image(msg, published_ns)

    def _on_image(self, msg: DepthImage, published_ns: int) -> None:
        if self.info is None:  # the first camera_info may arrive a little later than its image
            self._early.append((msg, published_ns))
            if len(self._early) > _WAITING_IMAGES:
                self._early.popleft()
                self._leave_out(NO_CAMERA_INFO, f'no message on {self._node.resolve_topic_name(INFO)} yet')
            return
        self._mask.match(msg, published_ns)

    def _on_masked(self, msg: DepthImage | PointCloud2, published_ns: int, mask: Image | None) -> None:
        if isinstance(msg, PointCloud2):
            self._deliver(FrameMessages(POINTS, msg, mask), published_ns)
        else:
            self._colour.match(msg, published_ns, mask)

    def _on_pair(self, msg: DepthImage, published_ns: int, mask: Image | None, colour: Image | None) -> None:
        if self._colour_info is None and self._node.count_publishers(self._colour_info_topic):
            colour = None  # nobody knows yet whose it is
        why = '' if colour is None else other_view(msg, self.info, colour, self._colour_info)
        if why:
            self._colour.close(why)
            colour = None
        topic = COMPRESSED if isinstance(msg, CompressedImage) else DEPTH
        self._deliver(FrameMessages(topic, msg, mask, colour), published_ns)

    def _deliver(self, messages: FrameMessages, published_ns: int) -> None:
        if messages.mask is None and self._mask.expected:  # where masks are, nothing else is a target
            self._leave_out(NO_MASK, f'no message on {self._node.resolve_topic_name(MASK)} has its stamp')
        else:
            self._take(messages, published_ns)

    def _on_info(self, msg: CameraInfo, _published_ns: int) -> None:
        self.info = msg
        while self._early:
            self._on_image(*self._early.popleft())
        self._serve()

    def _on_colour_info(self, msg: CameraInfo, _published_ns: int) -> None:
        self._colour_info = msg


class PairedInput:
    """Pairs each frame's message with what another topic says of its time, if there is anything.

    While nothing comes there, frames do not wait.

    Args:
        node: that subscribes; its diagnostics count.
        topics: with their types; messages with a header, such as images.
        profile: of the subscriptions.
        take: called with each message, what came with it, and its partner.
    """

    def __init__(
        self, node: StageNode, topics: dict[str, Any], profile: Any, take: Callable[..., None]
    ) -> None:
        self._node = node
        self._take = take
        self._pairs: StampPairs[tuple[Any, ...], Any] = StampPairs()
        self._inputs = [node.receive(kind, name, self._on_partner, profile) for name, kind in topics.items()]
        self._timer: Any = None

    @property
    def expected(self) -> bool:
        """Whether anything has come since the scan began, or somebody publishes."""
        return any(s.received or self._node.count_publishers(s.topic_name) for s in self._inputs)

    def match(self, message: Any, *more: Any) -> None:
        """Take a frame's message; it leaves now, or once its partner has arrived."""
        self._pairs.add(read_stamp(message.header.stamp), time.monotonic(), (message, *more))
        self._deliver()

    def close(self, why: str = '') -> None:
        """Receive nothing more."""
        for subscription in self._inputs:
            if why:
                self._node.get_logger().info(f'{subscription.topic_name} is ignored: {why}')
            self._node.stop_receiving(subscription)
        self._inputs = []
        self._pairs.end_partners()

    def reset(self) -> None:
        """Start a new scan."""
        self._pairs.clear()

    def _on_partner(self, msg: Any, _published_ns: int) -> None:
        if not self._inputs:
            return
        if self._timer is None:  # from now on frames may wait
            self._timer = self._node.create_timer(TICK_S, self._deliver)
        self._pairs.add_partner(read_stamp(msg.header.stamp), time.monotonic(), msg)
        self._deliver()

    def _deliver(self) -> None:
        for message, partner in self._pairs.pop(time.monotonic()):
            self._take(*message, partner)


def _beside(node: StageNode, image: str, name: str) -> str:
    """The name of a topic that goes with an image: as it was remapped, or else where the image was.

    image_transport and drivers name such topics after the image, which alone is usually remapped.
    """
    if node.resolve_topic_name(name) != node.resolve_topic_name(name, only_expand=True):
        return name
    where = str(node.resolve_topic_name(image))
    if name.startswith(image):
        return where + name.removeprefix(image)
    return f'{where.rpartition("/")[0]}/{name.rpartition("/")[2]}'
