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

"""Recorded sessions: the depth frames of a bag, whatever its storage and however it names its topics."""

import dataclasses
import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import StampPairs
from msg_adapters.colour_images import read_colour
from msg_adapters.depth_images import read_cloud_frame, read_depth_frame
from msg_adapters.errors import BagError, MalformedMessage
from msg_adapters.input_topics import InputTopic, choose_input
from msg_adapters.raw_bags import RawBag, open_bag
from msg_adapters.raw_messages import RawMessage
from msg_adapters.ros1_conversion import jazzy_types
from msg_adapters.stamps import read_stamp

__all__ = ['BagError', 'BagSession', 'decode', 'open_bag', 'open_session']

_FARTHEST_NS = 3600 * 10**9
_LOOKED_AT = 5  # messages


class BagSession:
    """The frames of one input topic of a bag, in order of the bag's time; a context manager.

    Iterating yields ``(stamp_ns, frame)`` with the stamp of the message's header, and in place of a
    frame the :class:`MalformedMessage` that says why there is none: the caller counts it and goes on.
    Where not even the header can be read, the stamp is the bag's. Each iteration starts anew.
    """

    def __init__(self, bag: RawBag, source: InputTopic) -> None:
        self._bag = bag
        self._source = source

    @property
    def topic(self) -> str:
        """The topic that frames are read from."""
        return self._source.topic

    @property
    def info_topic(self) -> str | None:
        """The CameraInfo topic of a depth image's topic; None for clouds."""
        return self._source.info_topic

    @property
    def colour_topic(self) -> str | None:
        """The topic of colour images registered to the depth images; None where there is none."""
        return self._source.colour_topic

    @property
    def count(self) -> int:
        """Messages on the topic, readable or not."""
        return self._source.count

    @property
    def warnings(self) -> list[str]:
        """What of the bag is damaged, one line each; complete once it has been read to its end."""
        return self._bag.warnings

    def __iter__(self) -> Iterator[tuple[int, DepthFrame | MalformedMessage]]:
        info, offset_ns = self._first_info(), self._clock_offset()
        pairs: StampPairs[tuple[int, DepthFrame | MalformedMessage], Any] = StampPairs()
        if self.colour_topic is not None:
            pairs.expect(0.0)
        for raw in self._bag.messages([t for t in (self.topic, self.info_topic, self.colour_topic) if t]):
            message = _decoded(raw)
            if raw.topic == self.info_topic:
                info = message
            elif raw.topic == self.colour_topic:
                if not isinstance(message, MalformedMessage):
                    pairs.add_partner(read_stamp(message.header.stamp), 0.0, message)
            elif isinstance(message, MalformedMessage):
                pairs.add(raw.stamp_ns, 0.0, (raw.stamp_ns, message))
            else:
                stamp_ns = read_stamp(message.header.stamp)
                if abs(stamp_ns - raw.stamp_ns - offset_ns) > _FARTHEST_NS:
                    odd = MalformedMessage(f'stamp of {stamp_ns} ns is hours off those of other frames')
                    pairs.add(raw.stamp_ns + offset_ns, 0.0, (raw.stamp_ns + offset_ns, odd))
                else:
                    pairs.add(stamp_ns, 0.0, (stamp_ns, self._frame(message, info)))
            yield from _coloured(pairs.pop(0.0))
        yield from _coloured(pairs.pop(math.inf))

    def _frame(self, message: Any, info: Any) -> DepthFrame | MalformedMessage:
        if isinstance(info, MalformedMessage):
            return info
        try:
            return read_cloud_frame(message) if info is None else read_depth_frame(message, info)
        except MalformedMessage as malformed:
            return malformed

    def _clock_offset(self) -> int:
        """Nanoseconds that stamps are ahead of the bag's time: the middle one of the first few.

        A damaged stamp must not pass for a leap of years, behind which all later frames come too late.
        """
        first = ((raw, _decoded(raw)) for raw in islice(self._bag.messages({self.topic}), _LOOKED_AT))
        ahead = [
            read_stamp(message.header.stamp) - raw.stamp_ns
            for raw, message in first
            if not isinstance(message, MalformedMessage)
        ]
        return sorted(ahead)[len(ahead) // 2] if ahead else 0

    def _first_info(self) -> Any:
        """The first CameraInfo: images that were recorded before it are seen by that camera too."""
        if self.info_topic is None:
            return None
        first = next(iter(self._bag.messages({self.info_topic})), None)
        return (
            MalformedMessage(f'no readable message on {self.info_topic}')
            if first is None
            else _decoded(first)
        )

    def close(self) -> None:
        """Close the bag."""
        self._bag.close()

    def __enter__(self) -> 'BagSession':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_session(path: str | Path, topic: str | None = None) -> BagSession:
    """Open a bag for its depth frames, from ``topic`` or from the topic that suits best.

    See :func:`~msg_adapters.input_topics.choose_input` for the choice, and
    :func:`~msg_adapters.raw_bags.open_bag` for the storages and for bags that a crash cut off.

    Raises:
        BagError: no bag, nothing readable in it, or no usable topic; the line names those it has.
    """
    bag = open_bag(path)
    try:
        return BagSession(bag, choose_input(bag, topic, decode))
    except BaseException:
        bag.close()
        raise


def decode(raw: RawMessage) -> Any:
    """The message of serialised bytes, with read-only numpy arrays for its data.

    Raises:
        MalformedMessage: bytes that are no message of that type.
    """
    try:
        return jazzy_types().deserialize_cdr(raw.data, raw.msgtype)
    except Exception as error:  # rosbags' parsers raise nearly anything on damaged bytes
        raise MalformedMessage(f'{raw.msgtype} cannot be decoded: {" ".join(str(error).split())}') from None


def _coloured(
    pairs: Iterator[tuple[tuple[int, DepthFrame | MalformedMessage], Any]],
) -> Iterator[tuple[int, DepthFrame | MalformedMessage]]:
    """The frames with the colours of their partners; one that cannot be read lends none."""
    for (stamp_ns, frame), colour in pairs:
        if colour is not None and isinstance(frame, DepthFrame):
            with suppress(MalformedMessage):
                rgb = read_colour(colour)
                if rgb.shape[:2] == frame.depth.shape:
                    frame = dataclasses.replace(frame, rgb=rgb)
        yield stamp_ns, frame


def _decoded(raw: RawMessage) -> Any:
    """The message, or the error that says why there is none."""
    try:
        return decode(raw)
    except MalformedMessage as malformed:
        return malformed
