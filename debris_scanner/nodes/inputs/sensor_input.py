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

"""The sensor's messages as depth frames, one after the other, with their stamps in order.

:class:`SensorInput` decodes what its :class:`FrameSynchroniser` has joined, and uses the topic that delivers
first. Under overload its :class:`Door` sheds frames before they are decoded.
"""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image

from debris_scanner.core.camera import Camera
from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.parameters import ParameterError
from debris_scanner.core.results import commonest
from debris_scanner.core.stamps import MonotonicStamps
from debris_scanner.nodes.inputs.cameras import DEPTH, POINTS
from debris_scanner.nodes.inputs.door import PATIENCE_S, Door
from debris_scanner.nodes.inputs.synchroniser import TICK_S, FrameMessages, FrameSynchroniser
from debris_scanner.nodes.lifecycle import qos
from debris_scanner.nodes.lifecycle.diagnostics import WARN, Problem
from debris_scanner.nodes.lifecycle.parameters import declare
from debris_scanner.nodes.lifecycle.stage import StageNode
from debris_scanner.sensing.cloud_axes import AXES_HELP
from debris_scanner.sensing.hints import joined
from msg_adapters.colour_images import read_colour
from msg_adapters.errors import MalformedMessage
from msg_adapters.inputs.camera_infos import is_rectified
from msg_adapters.inputs.decoder import FrameDecoder, InputOptions
from msg_adapters.inputs.masks import masked
from msg_adapters.inputs.static_frames import TF_STATIC, TF_TYPE
from msg_adapters.stamps import LATEST_NS

AUTO = 'auto'
SHED = 'shed'
COLOURED, MALFORMED_COLOUR = 'coloured', 'malformed_colour'

NO_FRAMES = 'no frames'  # how the message about a silent sensor begins
_SILENCE_S = 2.0


class SensorInput:
    """Serves the frames of ``points`` or of ``depth/image_raw``, of the first that delivers.

    Drivers often publish both, and each frame is to be scanned once. Where masks are published, the target
    is what lies in them. Malformed messages are counted, and logged at a limited rate.

    Args:
        node: that subscribes; its diagnostics count.
        take: called with each depth frame and the frame id of its points; returns whether later stages will
            answer, which the node tells by :meth:`answered`.
        patience_s: later stages that do not answer for longer have been killed.
    """

    def __init__(
        self, node: StageNode, take: Callable[[DepthFrame, str], bool], patience_s: float = PATIENCE_S
    ) -> None:
        reliability, depth, choice, self._decoder = self.declare(node)
        self._node = node
        self._take = take
        self._camera: Camera | None = None  # of the last frame
        self._last_time: float | None = None
        self._stamps = MonotonicStamps()
        self._refusals: dict[str, str] = {}  # the latest in words, by reason
        self._hinted: set[str] = set()  # rclpy's once tells calls apart by an index that CPython moves
        self._door: Door[FrameMessages] = Door(depth, patience_s=patience_s)
        self._overwritten = 0  # frames that have been told to the door
        self._wake = node.create_guard_condition(self._serve)  # lets messages be received between two frames
        node.create_timer(TICK_S, self._serve)  # later stages that were killed answer no more
        self._synchroniser = FrameSynchroniser(
            node, choice, reliability, depth, self._door.arrive, self._leave_out, self._serve
        )
        if TF_TYPE is not None and choice != 'depth':
            node.create_subscription(TF_TYPE, TF_STATIC, self._on_frames, qos.kept())

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
        return self._synchroniser.lost

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
        level, why = self._synchroniser.silence()
        since = 'yet' if self._last_time is None else f'for {time.monotonic() - self._last_time:.0f} s'
        return level, f'{NO_FRAMES} {since}: {why}'

    def reset(self) -> None:
        """Start a new scan, whose stamps are not corrected by those of the old one."""
        self._refusals.clear()
        self._stamps.reset()
        self._door.reset()
        self._overwritten = 0
        self._decoder.restart()
        self._synchroniser.reset()

    def _on_frames(self, msg: Any) -> None:
        self._decoder.frames.add(msg)
        self._decoder.forget_frames()

    def _serve(self) -> None:
        """Serve one frame; the next one once those that have come meanwhile are received."""
        if not self._node.active:
            return
        overwritten = self._synchroniser.overwritten
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
            stamp_ns = self._decode(waiting)
        if contained.reason:
            self.tell_rejected(contained.message)
        self._door.served(stamp_ns, time.monotonic() - began_s)
        if len(self._door):
            self._wake.trigger()

    def _decode(self, messages: FrameMessages) -> int | None:
        """Decode and hand over a frame; its stamp if later stages will answer it."""
        if not self._synchroniser.hears(messages.topic):  # another input was selected while it waited
            return None
        self._last_time = time.monotonic()
        self._node.diagnostics.counts['received'] += 1
        try:
            with self._node.timer.stage('decode'):
                frame = self._read(messages)
        except MalformedMessage as error:
            self._reject(error.reason, f'message on {self._name(messages.topic)}', str(error))
            return None
        self._synchroniser.select(messages.topic)
        while self._decoder.remarks:
            self._node.get_logger().warning(self._decoder.remarks.pop(0))
        placed_ns = self._stamps.place(frame.stamp_ns, self._last_time)
        if not 0 <= placed_ns < LATEST_NS:  # stamps that keep jumping have left the range of time
            self._stamps.reset()
            why = f'its stamp {frame.stamp_ns} is out of range'
            self._reject(MalformedMessage.reason, f'message on {self._name(messages.topic)}', why)
            return None
        if self._stamps.remark:
            self._node.get_logger().warning(self._stamps.remark)
            self._stamps.remark = ''
        if placed_ns != frame.stamp_ns:
            frame = dataclasses.replace(frame, stamp_ns=placed_ns)
        self._camera = frame.camera
        return frame.stamp_ns if self._take(frame, messages.depth.header.frame_id) else None

    def _read(self, messages: FrameMessages) -> DepthFrame:
        if messages.topic == POINTS:
            frame = self._decoder.cloud(messages.depth)
        else:
            rgb = colours(self._node, messages.colour)
            rectified = is_rectified(self._name(DEPTH))
            frame = self._decoder.image(messages.depth, self._synchroniser.info, rgb, rectified)
            if frame.rgb is not None:
                self._node.diagnostics.counts[COLOURED] += 1
        return frame if messages.mask is None else masked(frame, messages.mask)

    def _leave_out(self, reason: str, why: str) -> None:
        self._node.diagnostics.counts['received'] += 1
        self._reject(reason, 'frame', why)

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
