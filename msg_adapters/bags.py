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

"""Recorded sessions: the depth frames of a bag, whatever its storage and the names of its topics.

:func:`open_session` opens the bag and chooses the topic of the depth frames, :class:`BagSession` decodes the
frames and pairs them with their colour images.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import MonotonicStamps, StampPairs
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.colour_images import read_colour
from msg_adapters.errors import BagError, MalformedMessage, WrongCameraInfo
from msg_adapters.inputs.choice import InputTopic, choose_input, decode, decoded, first, make_decoder
from msg_adapters.inputs.decoder import FrameDecoder, InputOptions
from msg_adapters.poses import add_sensor_odometry
from msg_adapters.raw_bags import RawBag, open_bag
from msg_adapters.stamps import read_stamp

__all__ = ['BagError', 'BagSession', 'decode', 'open_bag', 'open_session']

ODOMETRY = 'nav_msgs/msg/Odometry'
SENSOR_ODOMETRY = 'sensor_odometry'  # how a topic of that type ends that tells how the sensor moved
_MAX_STAMP_OFFSET_NS = 3600 * 10**9  # of a valid first stamp, from those of the next frames
_CLOCK_SAMPLES = 5  # messages


_Making = Callable[[Any], DepthFrame | MalformedMessage]  # of a frame, once its colour image is known


class BagSession:
    """The frames of one input topic of a bag, in order of the bag's time; a context manager.

    Iterating yields ``(stamp_ns, frame)`` with the stamp of the message's header, and in place of a
    frame the :class:`MalformedMessage` that says why there is none: the caller counts it and goes on.
    Where not even the header can be read, the stamp is the bag's. Where the stamps jump and the bag's time
    does not, they are moved to go on with it, as in a live scan. Each iteration starts from the beginning.
    """

    def __init__(self, bag: RawBag, source: InputTopic, decoder: FrameDecoder) -> None:
        self._bag = bag
        self._source = source
        self._decoder = decoder
        self._jumps: list[str] = []

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
    def depth_unit(self) -> float:
        """Metres a unit of depth, where the bag tells it beside the images; else 0."""
        return self._decoder.unit

    @property
    def count(self) -> int:
        """Messages on the topic, readable or not."""
        return self._source.count

    @property
    def warnings(self) -> list[str]:
        """What of the bag is damaged or odd, one line each; complete once it has been read to its end."""
        more = f' ({len(self._jumps)} jumps in all)' if len(self._jumps) > 1 else ''
        odd = [self._source.remark, *self._decoder.remarks]
        return self._bag.warnings + [line for line in odd if line] + [jump + more for jump in self._jumps[:1]]

    def __iter__(self) -> Iterator[tuple[int, DepthFrame | MalformedMessage]]:
        info, (begin_ns, offset_ns) = self._first_info(), self._clock()
        line: MonotonicStamps | None = None  # from the first valid stamp on
        self._jumps = []
        self._decoder.restart()
        pairs: StampPairs[tuple[int, _Making], Any] = StampPairs()
        if self.colour_topic is not None:
            pairs.expect(0.0)
        for raw in self._bag.messages([t for t in (self.topic, self.info_topic, self.colour_topic) if t]):
            message = decoded(raw)
            if raw.topic == self.info_topic:
                info = _as_info(message)
            elif raw.topic == self.colour_topic:
                if not isinstance(message, MalformedMessage):
                    pairs.add_partner(read_stamp(message.header.stamp), 0.0, message)
            elif isinstance(message, MalformedMessage):
                pairs.add(raw.stamp_ns, 0.0, (raw.stamp_ns, partial(_as_it_is, message)))
            else:
                stamp_ns = read_stamp(message.header.stamp)
                if line is None and abs(stamp_ns - raw.stamp_ns - offset_ns) > _MAX_STAMP_OFFSET_NS:
                    odd = MalformedMessage(f'stamp of {stamp_ns} ns is hours off those of other frames')
                    placed_ns = raw.stamp_ns + offset_ns
                    pairs.add(placed_ns, 0.0, (placed_ns, partial(_as_it_is, odd)))
                else:
                    line = line or MonotonicStamps()
                    placed_ns = line.place(stamp_ns, (raw.stamp_ns - begin_ns) * 1e-9)
                    self._jumps += [line.remark] if line.remark else []
                    line.remark = ''
                    pairs.add(stamp_ns, 0.0, (placed_ns, partial(self._frame, message, info, placed_ns)))
            yield from ((stamp, make(colour)) for (stamp, make), colour in pairs.pop(0.0))
        yield from ((stamp, make(colour)) for (stamp, make), colour in pairs.pop(math.inf))

    def read_sensor_odometry(self, path: SensorPath) -> None:
        """Add what the bag has of the sensor's odometry, if anything; unreadable messages are left out."""
        topic = sensor_odometry_topic(self._bag)
        if topic is None:
            return
        message = first(self._bag, self.topic)
        path.sees('' if message is None else str(message.header.frame_id))
        for raw in self._bag.messages({topic}):
            with suppress(MalformedMessage):
                add_sensor_odometry(path, decode(raw))

    def _frame(self, message: Any, info: Any, stamp_ns: int, colour: Any) -> DepthFrame | MalformedMessage:
        if isinstance(info, MalformedMessage):
            return info
        try:
            if info is None:
                return _with_stamp(self._decoder.cloud(message), stamp_ns)
            frame = self._decoder.image(message, info, _colours(colour), self._source.rectified)
        except MalformedMessage as malformed:
            return malformed
        return _with_stamp(frame, stamp_ns)

    def _clock(self) -> tuple[int, int]:
        """The bag's time at the first frame, and how far stamps are ahead of it, ns: median of the first few.

        One damaged stamp must not count as the time that all later frames go on with.
        """
        earliest = [
            (raw.stamp_ns, decoded(raw)) for raw in islice(self._bag.messages({self.topic}), _CLOCK_SAMPLES)
        ]
        ahead = [
            read_stamp(message.header.stamp) - stamp_ns
            for stamp_ns, message in earliest
            if not isinstance(message, MalformedMessage)
        ]
        return earliest[0][0] if earliest else 0, sorted(ahead)[len(ahead) // 2] if ahead else 0

    def _first_info(self) -> Any:
        """The first CameraInfo; it also applies to images that were recorded before it."""
        if self.info_topic is None:
            return None
        raw = next(iter(self._bag.messages({self.info_topic})), None)
        if raw is None:
            return WrongCameraInfo(f'no readable message on {self.info_topic}')
        return _as_info(decoded(raw))

    def close(self) -> None:
        """Close the bag."""
        self._bag.close()

    def __enter__(self) -> 'BagSession':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_session(
    path: str | Path, topic: str | None = None, options: InputOptions | None = None
) -> BagSession:
    """Open a bag for its depth frames, from ``topic`` or from the topic that suits best.

    See :func:`~msg_adapters.inputs.choice.choose_input` for the choice, and
    :func:`~msg_adapters.raw_bags.open_bag` for the storages and for bags that a crash cut off.

    Raises:
        BagError: no bag, nothing readable in it, or no usable topic; the line names those it has.
    """
    bag = open_bag(path)
    try:
        source = choose_input(bag, topic, options)
        return BagSession(bag, source, make_decoder(bag, source, options))
    except BaseException:
        bag.close()
        raise


def sensor_odometry_topic(bag: RawBag) -> str | None:
    """The first topic of Odometry by the name of ``sensor_odometry``, whatever its namespace."""
    named = (
        c.topic
        for c in bag.channels
        if c.msgtype == ODOMETRY and c.topic.rsplit('/', 1)[-1] == SENSOR_ODOMETRY
    )
    return min(named, default=None)


def _as_it_is(malformed: MalformedMessage, _colour: Any) -> MalformedMessage:
    return malformed


def _as_info(message: Any) -> Any:
    """A CameraInfo, or why images have none."""
    return WrongCameraInfo(str(message)) if isinstance(message, MalformedMessage) else message


def _colours(image: Any) -> NDArray[np.uint8] | None:
    """Colours (h, w, 3) of an Image; None where there is none, or none that can be read."""
    if image is None:
        return None
    try:
        return read_colour(image)
    except MalformedMessage:
        return None


def _with_stamp(frame: DepthFrame, stamp_ns: int) -> DepthFrame:
    """The frame, at another time if it is not at that one already."""
    return frame if frame.stamp_ns == stamp_ns else dataclasses.replace(frame, stamp_ns=stamp_ns)
