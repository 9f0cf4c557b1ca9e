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

"""Colour beside the depth images: ``rgb/image_raw``, where it is registered to them."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import Image

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import StampPairs
from debris_scanner.nodes.reception import Reception
from debris_scanner.nodes.stage import StageNode
from msg_adapters.colour_images import read_colour, same_view
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import read_stamp

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
        self._reception: Reception | None = node.receive(Image, COLOUR, self._on_colour, profile)
        self._timer: Any = None

    def match(self, depth: Image) -> None:
        """A depth image; it is taken now, or as soon as its colour has come."""
        self._pairs.add(read_stamp(depth.header.stamp), time.monotonic(), depth)
        self._look()

    def leave(self, why: str = '') -> None:
        """Take no colour any more."""
        if self._reception is None:
            return
        self._node.receptions.remove(self._reception)
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
