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

"""Colour beside the depth images: ``rgb/image_raw``, where it is registered to them.

The sensor's topics as depth frames: clouds, or depth images with the latest camera_info.
"""

import dataclasses
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import MonotonicStamps, StampPairs
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import ERROR, WARN, Problem
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.nodes.lifecycle.subscriptions import CountingSubscription, explain
from msg_adapters.colour_images import read_colour, same_view
from msg_adapters.depth_images import read_cloud_frame, read_depth_frame
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import LATEST_NS, read_stamp

COLOUR = 'rgb/image_raw'
COLOURED, MALFORMED_COLOUR = 'coloured', 'malformed_colour'

_TICK_S = 0.03


class ColourInput:
    """Gives each depth image the colour image of the same moment, or none.

    Registered is what has the depth image's frame and size: colour of another view is left alone, with a
    word on why. Without colour nothing waits.

    Args:
        node: that subscribes; its diagnostics count.
        profile: of the subscription.
        take: called with each depth image and its colour image.
    """

    def __init__(self, node: StageNode, profile: Any, take: Callable[[Image, Image | None], None]) -> None:
        self._node = node
        self._take = take
        self._pairs: StampPairs[Image, Image] = StampPairs()
        self._reception: CountingSubscription | None = node.receive(Image, COLOUR, self._on_colour, profile)
        self._timer: Any = None

    def match(self, depth: Image) -> None:
        """A depth image; it is taken now, or as soon as its colour has come."""
        self._pairs.add(read_stamp(depth.header.stamp), time.monotonic(), depth)
        self._look()

    def leave(self, why: str = '') -> None:
        """Take no colour any more."""
        if self._reception is None:
            return
        self._node.counting_subscriptions.remove(self._reception)
        self._node.destroy_subscription(self._reception.subscription)
        self._reception = None
        self._pairs.end_partners()
        if why:
            self._node.get_logger().info(f'{COLOUR} is left alone: {why}')

    def reset(self) -> None:
        """A new scan."""
        self._pairs.clear()

    def _on_colour(self, msg: Image, _published_ns: int) -> None:
        if self._reception is None:
            return
        if self._timer is None:  # from now on something may have to wait
            self._timer = self._node.create_timer(_TICK_S, self._look)
        self._pairs.add_partner(read_stamp(msg.header.stamp), time.monotonic(), msg)
        self._look()

    def _look(self) -> None:
        for depth, colour in self._pairs.pop(time.monotonic()):
            if colour is not None and (why := _another_view(depth, colour)):
                self.leave(why)
                colour = None
            self._take(depth, colour)


def coloured(node: StageNode, frame: DepthFrame, colour: Image | None) -> DepthFrame:
    """The frame with the colours of an image of its size, as far as that can be read."""
    if colour is None:
        return frame
    try:
        rgb = read_colour(colour)
    except MalformedMessage as error:
        node.diagnostics.counts[MALFORMED_COLOUR] += 1
        node.get_logger().warning(f'colour left out: {error}', throttle_duration_sec=5.0)
        return frame
    node.diagnostics.counts[COLOURED] += 1
    return dataclasses.replace(frame, rgb=rgb)


def _another_view(depth: Image, colour: Image) -> str:
    """Why a colour image is not of the depth image's pixels; empty where it is."""
    if depth.header.frame_id != colour.header.frame_id:
        return f'it is seen from {colour.header.frame_id}, depth from {depth.header.frame_id}: not registered'
    if not same_view(depth, colour):
        return f'{colour.width}x{colour.height} pixels, depth has {depth.width}x{depth.height}'
    return ''


POINTS, DEPTH, INFO = 'points', 'depth/image_raw', 'depth/camera_info'
AUTO = 'auto'
MALFORMED, NO_CAMERA_INFO = 'malformed', 'no_camera_info'
LOST_IN_TRANSPORT = 'lost_in_transport'

_WAITING_IMAGES = 10
_SILENCE_S = 2.0


class SensorInput:
    """Subscribes to ``points`` and to ``depth/image_raw`` with its camera_info; the first to speak wins.

    Clouds bring their colour along; depth images get that of ``rgb/image_raw`` where it is registered.

    A driver often publishes both: scanning each frame twice would help nobody. Messages that contradict
    themselves are counted and logged, now and then, and the node goes on.

    Args:
        node: that subscribes; its diagnostics count.
        take: called with each depth frame and the frame id of its points.
    """

    def __init__(self, node: StageNode, take: Callable[[DepthFrame, str], None]) -> None:
        reliability = declare(
            node,
            'input_reliability',
            qos.BEST_EFFORT,
            'of the subscriptions to the sensor; reliable loses nothing but needs a reliable driver',
            choices=(qos.BEST_EFFORT, qos.RELIABLE),
        )
        depth = declare(node, 'input_depth', qos.RECENT, 'frames that may wait to be processed', 1, 10_000)
        self._choice = declare(node, 'input', AUTO, 'what to scan', choices=(AUTO, 'points', 'depth'))
        self._node = node
        self._take = take
        self._info: CameraInfo | None = None
        self._early: deque[Image] = deque()
        self._last_time: float | None = None
        self._line = MonotonicStamps()
        self._colour: ColourInput | None = None
        profile = qos.sensor_input(reliability, depth)
        self._inputs = {}
        if self._choice != 'depth':
            self._inputs[POINTS] = node.receive(PointCloud2, POINTS, self._on_points, profile)
        if self._choice != 'points':
            self._inputs[DEPTH] = node.receive(Image, DEPTH, self._on_image, profile)
            node.create_subscription(CameraInfo, INFO, self._on_info, profile)
            self._colour = ColourInput(node, profile, self._on_pair)

    @property
    def lost(self) -> int:
        """Messages that a publisher sent and that never came."""
        return sum(r.lost for r in self._inputs.values())

    def stamp_values(self) -> dict[str, Any]:
        """Key-values of what the stamps did."""
        values: dict[str, Any] = {f'stamps.{kind}': n for kind, n in self._line.counts.items()}
        if self._line.shift_ns:
            values['stamps.moved_ns'] = self._line.shift_ns
        return values

    def problem(self) -> Problem | None:
        """Why no frames come, in words that help."""
        if self._last_time is not None and time.monotonic() - self._last_time < _SILENCE_S:
            return None
        offers = [explain(self._node, r) for r in self._inputs.values()]
        since = 'yet' if self._last_time is None else f'for {time.monotonic() - self._last_time:.0f} s'
        nobody = not any(
            self._node.count_publishers(r.subscription.topic_name) for r in self._inputs.values()
        )
        return (ERROR if nobody else WARN), f'no frames {since}: {"; ".join(offers)}'

    def reset(self) -> None:
        """A new scan: stamps are taken as they come."""
        self._line.reset()
        if self._colour is not None:
            self._colour.reset()

    def _on_points(self, msg: PointCloud2, _published_ns: int) -> None:
        self._decode(POINTS, msg.header.frame_id, lambda: read_cloud_frame(msg))

    def _on_image(self, msg: Image, _published_ns: int) -> None:
        if self._info is None:  # the first camera_info may come a little later than its image
            self._early.append(msg)
            if len(self._early) > _WAITING_IMAGES:
                self._early.popleft()
                self._reject(NO_CAMERA_INFO, f'no message on {INFO} yet')
            return
        assert self._colour is not None
        self._colour.match(msg)

    def _on_pair(self, msg: Image, colour: Image | None) -> None:
        self._decode(
            DEPTH,
            msg.header.frame_id,
            lambda: coloured(self._node, read_depth_frame(msg, self._info), colour),
        )

    def _on_info(self, msg: CameraInfo) -> None:
        self._info = msg
        while self._early:
            self._on_image(self._early.popleft(), 0)

    def _decode(self, topic: str, frame_id: str, decode: Callable[[], DepthFrame]) -> None:
        self._last_time = time.monotonic()
        self._node.diagnostics.counts['received'] += 1
        try:
            with self._node.timer.stage('decode'):
                frame = decode()
        except MalformedMessage as error:
            self._node.diagnostics.rejected[MALFORMED] += 1
            self._warn(f'message on {topic} rejected: {error}')
            return
        self._settle_on(topic)
        placed_ns = self._line.place(frame.stamp_ns, self._last_time)
        if not 0 <= placed_ns < LATEST_NS:  # stamps that jump on and on have used up time
            self._line.reset()
            self._node.diagnostics.rejected[MALFORMED] += 1
            self._warn(f'message on {topic} rejected: its stamp {frame.stamp_ns} has no place on the line')
            return
        if self._line.remark:
            self._node.get_logger().warning(self._line.remark)
            self._line.remark = ''
        if placed_ns != frame.stamp_ns:
            frame = dataclasses.replace(frame, stamp_ns=placed_ns)
        self._take(frame, frame_id)

    def _settle_on(self, topic: str) -> None:
        """Leave the other input alone once one has delivered."""
        for other in [t for t in self._inputs if t != topic]:
            reception = self._inputs.pop(other)
            self._node.counting_subscriptions.remove(reception)
            self._node.destroy_subscription(reception.subscription)
            self._node.get_logger().info(f'scanning {topic}; {other} is left alone')
            if other == DEPTH and self._colour is not None:
                self._colour.leave()

    def _reject(self, reason: str, why: str) -> None:
        self._node.diagnostics.counts['received'] += 1
        self._node.diagnostics.rejected[reason] += 1
        self._warn(f'frame rejected: {why}')

    def _warn(self, text: str) -> None:
        self._node.get_logger().warning(text, throttle_duration_sec=5.0)


def input_values(sensor: SensorInput) -> dict[str, Any]:
    """Key-values of an input for the diagnostics."""
    return {'count.lost': sensor.lost} | sensor.stamp_values()
