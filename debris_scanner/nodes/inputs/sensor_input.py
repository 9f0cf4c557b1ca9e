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

"""The sensor's topics as depth frames: clouds, or depth images with their camera_info and registered colour.

:class:`SensorInput` subscribes to clouds and depth images and uses the topic that delivers first.
Under overload its :class:`Door` sheds frames before they are decoded.
:class:`PairedInput` pairs a frame with its image on ``mask``, which chooses the target, and depth images with
those of ``rgb/image_raw``, if they show the same pixels.
"""

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.parameters import ParameterError
from debris_scanner.core.results import commonest
from debris_scanner.core.stamps import MonotonicStamps, StampPairs
from debris_scanner.nodes.inputs.cameras import COLOUR, DEPTH, DETECTION, INFO, MASK, POINTS
from debris_scanner.nodes.inputs.door import PATIENCE_S, Door
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, WARN, Problem
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.subscriptions import CountingSubscription, explain, usable_topics
from debris_scanner.sensing.cloud_axes import AXES_HELP
from debris_scanner.sensing.hints import joined
from msg_adapters.colour_images import read_colour
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.camera_infos import is_rectified, other_view
from msg_adapters.inputs.decoder import FrameDecoder, InputOptions
from msg_adapters.inputs.masks import masked
from msg_adapters.inputs.static_frames import TF_STATIC, TF_TYPE
from msg_adapters.stamps import LATEST_NS, read_stamp

try:
    import vision_msgs.msg as vision_messages
except ImportError:
    vision_messages = None

BOX_TYPE: Any = getattr(vision_messages, 'Detection2D', None)  # None where it is not installed
COMPRESSED, COLOUR_INFO = 'depth/image_raw/compressedDepth', 'rgb/camera_info'
AUTO = 'auto'
NO_CAMERA_INFO = 'no_camera_info'
NO_MASK = 'no_mask'
SHED = 'shed'
COLOURED, MALFORMED_COLOUR = 'coloured', 'malformed_colour'

NO_FRAMES = 'no frames'  # how the message about a silent sensor begins
_WAITING_IMAGES = 10
_SILENCE_S = 2.0
_TICK_S = 0.03
_USABLE = ('sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')
_MATCH_S = 0.2  # between two looks at the publishers


class _Waiting(NamedTuple):
    """A frame that is not decoded yet."""

    topic: str
    frame_id: str
    decode: Callable[[], DepthFrame]


class SensorInput:
    """Subscribes to ``points`` and to ``depth/image_raw`` with its camera_info; uses the first that delivers.

    Drivers often publish both, and each frame is to be scanned once. Clouds carry their colour; depth images
    get that of ``rgb/image_raw`` if it is registered. Where masks are published, the target is what lies in
    them, and frames without one are left out. Malformed messages are counted, and logged at a limited
    rate.

    Args:
        node: that subscribes; its diagnostics count.
        take: called with each depth frame and the frame id of its points; returns whether later stages will
            answer, which the node tells by :meth:`answered`.
        patience_s: later stages that do not answer for longer have been killed.
    """

    def __init__(
        self, node: StageNode, take: Callable[[DepthFrame, str], bool], patience_s: float = PATIENCE_S
    ) -> None:
        reliability, depth, self._choice, self._decoder = self.declare(node)
        self._node = node
        self._take = take
        self._info: CameraInfo | None = None
        self._colour_info: CameraInfo | None = None
        self._camera: Camera | None = None  # of the last frame
        # images that came before the first camera_info
        self._early: deque[tuple[Image | CompressedImage, int]] = deque()
        self._last_time: float | None = None
        self._stamps = MonotonicStamps()
        self._refusals: dict[str, str] = {}  # the latest in words, by reason
        self._hinted: set[str] = set()  # rclpy's once tells calls apart by an index that CPython moves
        self._colour: PairedInput | None = None
        self._door: Door[_Waiting] = Door(depth, patience_s=patience_s)
        self._overwritten = 0  # frames that have been told to the door
        self._wake = node.create_guard_condition(self._serve)  # lets messages be received between two frames
        node.create_timer(_TICK_S, self._serve)  # later stages that were killed answer no more
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
        if self._choice != 'depth':
            self._inputs[POINTS] = node.receive(PointCloud2, POINTS, self._on_points, profile, self._serve)
        if self._choice != 'points':
            self._inputs[DEPTH] = node.receive(Image, DEPTH, self._on_image, profile, self._serve)
            self._inputs[COMPRESSED] = node.receive(
                CompressedImage, compressed, self._on_compressed, profile, self._serve
            )
            for topic, take_info in ((INFO, self._on_info), (colour_info, self._on_colour_info)):
                node.receive(CameraInfo, topic, take_info, profile)
            self._colour = PairedInput(node, {COLOUR: Image}, profile, self._on_pair)
        if TF_TYPE is not None and self._choice != 'depth':
            node.create_subscription(TF_TYPE, TF_STATIC, self._on_frames, qos.kept())
        # until a publisher is there all match; each delivers by the time that its next message comes
        node.create_timer(_MATCH_S, self._match_publishers)

    @staticmethod
    def declare(node: StageNode) -> tuple[str, int, str, FrameDecoder]:
        """Declare the parameters; returns reliability, most frames that wait, the input, and its decoder.

        Raises:
            ParameterError: the axes are none.
        """
        reliability = declare(
            node,
            'input_reliability',
            qos.BEST_AVAILABLE,
            "reliability of the sensor's topics; best_available: as published",
            choices=(qos.BEST_AVAILABLE, qos.BEST_EFFORT, qos.RELIABLE),
        )
        depth = declare(
            node, 'input_depth', qos.SENT_CLOUDS, 'most frames that wait to be processed', 1, 10_000
        )
        return (
            reliability,
            depth,
            declare(node, 'input', AUTO, 'input to scan', choices=(AUTO, 'points', 'depth')),
            _declared_decoder(node),
        )

    @property
    def lost(self) -> int:
        """Messages that were published and never arrived."""
        return sum(s.lost for s in self._inputs.values())

    @property
    def hint(self) -> str:
        """What is wrong with the messages, if most cannot be read."""
        return self._refusals.get(commonest(self._node.diagnostics.rejected), '')

    def oddity(self, hints: tuple[str, ...], rejected: int = 0) -> Problem | None:
        """What is odd about the input, if most frames are of no use; each hint is logged once.

        Args:
            hints: in words.
            rejected: frames, beside those that the diagnostics count.
        """
        counted = self._node.diagnostics
        if not hints or 2 * (rejected + counted.rejected.total()) <= counted.counts['received']:
            return None
        for hint in hints:
            if hint not in self._hinted:
                self._hinted.add(hint)
                self._node.get_logger().warning(hint)
        return WARN, joined(*hints)

    def stamp_values(self) -> dict[str, Any]:
        """Key-values of the corrections of stamps."""
        values: dict[str, Any] = {f'stamps.{kind}': n for kind, n in self._stamps.counts.items()}
        if self._stamps.shift_ns:
            values['stamps.moved_ns'] = self._stamps.shift_ns
        return values

    def load_values(self) -> dict[str, Any]:
        """Key-values of the load: frames a second that are kept up with and that are offered."""
        kept, offered = self._door.rates()
        return {
            'load.kept_per_second': kept,
            'load.offered_per_second': offered,
            'load.may_wait': self._door.room,
        }

    def answered(self, stamp_ns: int) -> None:
        """The later stages have done with all frames up to a stamp."""
        self._door.answered(stamp_ns)
        self._serve()

    def image_values(self) -> dict[str, Any]:
        """Key-values of the image: with these a window of the target is placed in it."""
        c = self._camera
        return {} if c is None else {f'image.{n}': getattr(c, n) for n in ('width', 'height', 'cx', 'cy')}

    def problem(self) -> Problem | None:
        """Why no frames arrive, or not all are served."""
        if self._door.is_shedding:
            kept, offered = self._door.rates()
            return WARN, (
                f'overloaded: {kept:g} of {offered:g} frames a second are kept up with, the others are shed'
            )
        if self._last_time is not None and time.monotonic() - self._last_time < _SILENCE_S:
            return None
        count = self._node.count_publishers
        # compressed images are mentioned where they are, or were, the input
        heard = [s for name, s in self._inputs.items() if name != COMPRESSED or count(s.topic_name)]
        reasons = [explain(self._node, s) for s in heard or self._inputs.values()]
        if others := usable_topics(self._node, _USABLE, (POINTS, DEPTH, COLOUR)):
            reasons.append(f'there are {others}: remap, or name the camera')
        since = 'yet' if self._last_time is None else f'for {time.monotonic() - self._last_time:.0f} s'
        published = any(self._node.count_publishers(s.topic_name) for s in self._inputs.values())
        return (WARN if published else ERROR), f'{NO_FRAMES} {since}: {"; ".join(reasons)}'

    def reset(self) -> None:
        """Start a new scan, whose stamps are not corrected by those of the old one."""
        self._refusals.clear()
        self._stamps.reset()
        self._door.reset()
        self._overwritten = 0
        self._decoder.restart()
        self._mask.reset()
        if self._colour is not None:
            self._colour.reset()

    def _match_publishers(self) -> None:
        for subscription in self._node.counting_subscriptions:
            if subscription.topic_name in self._matched:
                subscription.match_publishers()

    def _on_points(self, msg: PointCloud2, published_ns: int) -> None:
        self._mask.match(msg, published_ns)

    def _on_frames(self, msg: Any) -> None:
        self._decoder.frames.add(msg)
        self._decoder.forget_frames()

    def _on_compressed(self, msg: CompressedImage, published_ns: int) -> None:
        raw = self._inputs.get(DEPTH)
        if raw is None or not self._node.count_publishers(raw.topic_name):
            self._on_image(msg, published_ns)

    def _on_image(self, msg: Image | CompressedImage, published_ns: int) -> None:
        if self._info is None:  # the first camera_info may arrive a little later than its image
            self._early.append((msg, published_ns))
            if len(self._early) > _WAITING_IMAGES:
                self._early.popleft()
                self._node.diagnostics.counts['received'] += 1
                self._reject(NO_CAMERA_INFO, 'frame', f'no message on {self._name(INFO)} yet')
            return
        self._mask.match(msg, published_ns)

    def _on_masked(
        self, msg: Image | CompressedImage | PointCloud2, published_ns: int, mask: Image | None
    ) -> None:
        if isinstance(msg, PointCloud2):
            self._wait(POINTS, msg, published_ns, mask, lambda: self._decoder.cloud(msg))
        elif self._colour is not None:
            self._colour.match(msg, published_ns, mask)

    def _on_pair(
        self, msg: Image | CompressedImage, published_ns: int, mask: Image | None, colour: Image | None
    ) -> None:
        if self._colour_info is None and self._node.count_publishers(self._colour_info_topic):
            colour = None  # nobody knows yet whose it is
        why = '' if colour is None else other_view(msg, self._info, colour, self._colour_info)
        if why and self._colour is not None:
            self._colour.close(why)
            colour = None
        rectified = is_rectified(self._name(DEPTH))

        def decode() -> DepthFrame:
            frame = self._decoder.image(msg, self._info, colours(self._node, colour), rectified)
            if frame.rgb is not None:
                self._node.diagnostics.counts[COLOURED] += 1
            return frame

        self._wait(COMPRESSED if isinstance(msg, CompressedImage) else DEPTH, msg, published_ns, mask, decode)

    def _wait(
        self, topic: str, msg: Any, published_ns: int, mask: Image | None, decode: Callable[[], DepthFrame]
    ) -> None:
        if mask is None and self._mask.expected:  # where a mask chooses the target, nothing else is one
            self._node.diagnostics.counts['received'] += 1
            self._reject(NO_MASK, 'frame', f'no message on {self._name(MASK)} has its stamp')
            return
        whole = decode if mask is None else lambda: masked(decode(), mask)
        self._door.arrive(_Waiting(topic, msg.header.frame_id, whole), published_ns)

    def _on_info(self, msg: CameraInfo, _published_ns: int) -> None:
        self._info = msg
        while self._early:
            self._on_image(*self._early.popleft())
        self._serve()

    def _on_colour_info(self, msg: CameraInfo, _published_ns: int) -> None:
        self._colour_info = msg

    def _serve(self) -> None:
        """Serve one frame; the next one once those that have come meanwhile are received."""
        if not self._node.active:
            return
        overwritten = sum(s.overwritten for s in self._inputs.values())
        self._door.lost(max(0, overwritten - self._overwritten))
        self._overwritten = overwritten
        waiting = self._door.next()
        if self._door.shed:
            self._node.diagnostics.rejected[SHED] = self._door.shed
        if waiting is None:
            return
        began_s = time.monotonic()
        stamp_ns: int | None = None
        with self._node.faults.contained('a frame', self._node.diagnostics.rejected) as contained:
            stamp_ns = self._decode(*waiting)
        if contained.reason:
            self.tell_rejected(contained.message)
        self._door.served(stamp_ns, time.monotonic() - began_s)
        if len(self._door):
            self._wake.trigger()

    def _decode(self, topic: str, frame_id: str, decode: Callable[[], DepthFrame]) -> int | None:
        """Decode and hand over a frame; its stamp if later stages will answer it."""
        self._last_time = time.monotonic()
        self._node.diagnostics.counts['received'] += 1
        try:
            with self._node.timer.stage('decode'):
                frame = decode()
        except MalformedMessage as error:
            self._reject(error.reason, f'message on {self._name(topic)}', str(error))
            return None
        self._select_input(topic)
        while self._decoder.remarks:
            self._node.get_logger().warning(self._decoder.remarks.pop(0))
        placed_ns = self._stamps.place(frame.stamp_ns, self._last_time)
        if not 0 <= placed_ns < LATEST_NS:  # stamps that keep jumping have left the range of time
            self._stamps.reset()
            why = f'its stamp {frame.stamp_ns} is out of range'
            self._reject(MalformedMessage.reason, f'message on {self._name(topic)}', why)
            return None
        if self._stamps.remark:
            self._node.get_logger().warning(self._stamps.remark)
            self._stamps.remark = ''
        if placed_ns != frame.stamp_ns:
            frame = dataclasses.replace(frame, stamp_ns=placed_ns)
        self._camera = frame.camera
        return frame.stamp_ns if self._take(frame, frame_id) else None

    def _select_input(self, topic: str) -> None:
        """Unsubscribe from the other input once one has delivered."""
        for other in [t for t in self._inputs if t != topic]:
            self._node.stop_receiving(self._inputs.pop(other))
            if other != COMPRESSED:
                self._node.get_logger().info(f'scanning {self._name(topic)}; {self._name(other)} is ignored')
            if topic == POINTS and self._colour is not None:
                self._colour.close()

    def _reject(self, reason: str, what: str, why: str) -> None:
        self._node.diagnostics.rejected[reason] += 1
        self._refusals[reason] = why
        self._warn(f'{what} rejected: {why}')

    def tell_rejected(self, why: str) -> None:
        """Log that a frame is left out, at a limited rate."""
        self._warn(f'frame rejected: {why}')

    def _name(self, topic: str) -> str:
        """The full name of a topic, remapped."""
        return self._node.resolve_topic_name(topic)

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text, throttle_duration_sec=5.0)


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
            self._timer = self._node.create_timer(_TICK_S, self._deliver)
        self._pairs.add_partner(read_stamp(msg.header.stamp), time.monotonic(), msg)
        self._deliver()

    def _deliver(self) -> None:
        for message, partner in self._pairs.pop(time.monotonic()):
            self._take(*message, partner)


def colours(node: StageNode, image: Image | None) -> NDArray[np.uint8] | None:
    """Colours (h, w, 3) of an image; None where there is none, or where it is malformed, which is counted."""
    if image is None:
        return None
    try:
        return read_colour(image)
    except MalformedMessage as error:
        node.diagnostics.counts[MALFORMED_COLOUR] += 1
        node.get_logger().warning(f'frame without colour: {error}', throttle_duration_sec=5.0)
        return None


def input_values(sensor: SensorInput) -> dict[str, Any]:
    """Key-values of an input for the diagnostics."""
    values = {'count.lost': sensor.lost} | sensor.stamp_values()
    return values | sensor.image_values() | sensor.load_values()


def _declared_decoder(node: StageNode) -> FrameDecoder:
    """The decoder of a node's parameters.

    Raises:
        ParameterError: the axes are none.
    """
    scale = declare(
        node, 'depth_scale', 0.0, 'metres a unit of depth; 0: 0.001 of 16-bit images, 1 of all else', 0.0, 1e3
    )
    axes = declare(node, 'axes', '', f'axes of clouds: {AXES_HELP}; empty: found out')
    try:
        return FrameDecoder(InputOptions(scale, axes))
    except ValueError as error:
        raise ParameterError(f'axes: {error}') from None


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
