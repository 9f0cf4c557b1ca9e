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
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

from debris_scanner.core.frames import DepthFrame
from debris_scanner.core.stamps import MonotonicStamps, StampPairs
from debris_scanner.tracking.sensor_path import SensorPath
from msg_adapters.colour_images import COLOUR_ENCODINGS, read_colour, same_view
from msg_adapters.depth_images import DEPTH_ENCODINGS, MONO16, read_cloud_frame, read_depth_frame
from msg_adapters.errors import BagError, MalformedMessage, WrongCameraInfo
from msg_adapters.poses import add_sensor_odometry
from msg_adapters.raw_bags import RawBag, open_bag
from msg_adapters.raw_messages import Channel, RawMessage, jazzy_types
from msg_adapters.stamps import read_stamp

__all__ = ['BagError', 'BagSession', 'decode', 'open_bag', 'open_session']

CLOUD = 'sensor_msgs/msg/PointCloud2'
IMAGE = 'sensor_msgs/msg/Image'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
ODOMETRY = 'nav_msgs/msg/Odometry'
SENSOR_ODOMETRY = 'sensor_odometry'  # how a topic of that type ends that tells how the sensor moved
# published by this package: in a recorded session these are results, not inputs
OWN_CLOUDS = frozenset({'target_points', 'keyframe_points', 'model'})
_MAX_STAMP_OFFSET_NS = 3600 * 10**9  # of a valid first stamp, from those of the next frames
_CLOCK_SAMPLES = 5  # messages


@dataclass(frozen=True)
class InputTopic:
    """A topic of clouds, or of depth images with the CameraInfo that belongs to them."""

    topic: str
    count: int
    info_topic: str | None  # None for clouds
    colour_topic: str | None = None  # images of the same pixels, beside depth images


def choose_input(bag: RawBag, topic: str | None) -> InputTopic:
    """The input named, or else the best there is.

    Best first: organised clouds with colour, organised clouds, depth images with their CameraInfo,
    unorganised clouds; among equals the topic with most messages, then the first by name. The first
    message of each topic decides its kind: an Image counts if its encoding is a depth. Clouds that
    this package publishes are ignored. A CameraInfo belongs to the images of its namespace; a single
    one belongs to all.

    Raises:
        BagError: no such topic, or none that is usable; the line names those there are.
    """
    if topic is not None:
        return _named(bag, topic)
    ranked = [
        (rank, -channel.count, channel.topic, channel, info)
        for channel in bag.channels
        if channel.topic.rsplit('/', 1)[-1] not in OWN_CLOUDS
        for rank, info in [_usable(bag, channel)]
        if rank is not None
    ]
    if not ranked:
        msg = f'{bag.path} has no cloud, and no depth image with a camera_info; its topics: {_listed(bag)}'
        raise BagError(msg)
    *_, channel, info = min(ranked, key=lambda entry: entry[:3])
    return _with_colour(bag, InputTopic(channel.topic, channel.count, info))


class BagSession:
    """The frames of one input topic of a bag, in order of the bag's time; a context manager.

    Iterating yields ``(stamp_ns, frame)`` with the stamp of the message's header, and in place of a
    frame the :class:`MalformedMessage` that says why there is none: the caller counts it and goes on.
    Where not even the header can be read, the stamp is the bag's. Where the stamps jump and the bag's time
    does not, they are moved to go on with it, as in a live scan. Each iteration starts from the beginning.
    """

    def __init__(self, bag: RawBag, source: InputTopic) -> None:
        self._bag = bag
        self._source = source
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
    def count(self) -> int:
        """Messages on the topic, readable or not."""
        return self._source.count

    @property
    def warnings(self) -> list[str]:
        """What of the bag is damaged, one line each; complete once it has been read to its end."""
        more = f' ({len(self._jumps)} jumps in all)' if len(self._jumps) > 1 else ''
        return self._bag.warnings + [jump + more for jump in self._jumps[:1]]

    def __iter__(self) -> Iterator[tuple[int, DepthFrame | MalformedMessage]]:
        info, (begin_ns, offset_ns) = self._first_info(), self._clock()
        line: MonotonicStamps | None = None  # from the first valid stamp on
        self._jumps = []
        pairs: StampPairs[tuple[int, DepthFrame | MalformedMessage], Any] = StampPairs()
        if self.colour_topic is not None:
            pairs.expect(0.0)
        for raw in self._bag.messages([t for t in (self.topic, self.info_topic, self.colour_topic) if t]):
            message = _decoded(raw)
            if raw.topic == self.info_topic:
                info = _as_info(message)
            elif raw.topic == self.colour_topic:
                if not isinstance(message, MalformedMessage):
                    pairs.add_partner(read_stamp(message.header.stamp), 0.0, message)
            elif isinstance(message, MalformedMessage):
                pairs.add(raw.stamp_ns, 0.0, (raw.stamp_ns, message))
            else:
                stamp_ns = read_stamp(message.header.stamp)
                if line is None and abs(stamp_ns - raw.stamp_ns - offset_ns) > _MAX_STAMP_OFFSET_NS:
                    odd = MalformedMessage(f'stamp of {stamp_ns} ns is hours off those of other frames')
                    pairs.add(raw.stamp_ns + offset_ns, 0.0, (raw.stamp_ns + offset_ns, odd))
                else:
                    line = line or MonotonicStamps()
                    placed_ns = line.place(stamp_ns, (raw.stamp_ns - begin_ns) * 1e-9)
                    self._jumps += [line.remark] if line.remark else []
                    line.remark = ''
                    pairs.add(stamp_ns, 0.0, (placed_ns, self._frame(message, info, placed_ns)))
            yield from _coloured(pairs.pop(0.0))
        yield from _coloured(pairs.pop(math.inf))

    def read_sensor_odometry(self, path: SensorPath) -> None:
        """Add what the bag has of the sensor's odometry, if anything; unreadable messages are left out."""
        topic = sensor_odometry_topic(self._bag)
        if topic is None:
            return
        first = _first(self._bag, self.topic)
        path.sees('' if first is None else str(first.header.frame_id))
        for raw in self._bag.messages({topic}):
            with suppress(MalformedMessage):
                add_sensor_odometry(path, decode(raw))

    def _frame(self, message: Any, info: Any, stamp_ns: int) -> DepthFrame | MalformedMessage:
        if isinstance(info, MalformedMessage):
            return info
        try:
            frame = read_cloud_frame(message) if info is None else read_depth_frame(message, info)
        except MalformedMessage as malformed:
            return malformed
        return frame if frame.stamp_ns == stamp_ns else dataclasses.replace(frame, stamp_ns=stamp_ns)

    def _clock(self) -> tuple[int, int]:
        """The bag's time at the first frame, and how far stamps are ahead of it, ns: median of the first few.

        One damaged stamp must not count as the time that all later frames go on with.
        """
        first = [
            (raw.stamp_ns, _decoded(raw)) for raw in islice(self._bag.messages({self.topic}), _CLOCK_SAMPLES)
        ]
        ahead = [
            read_stamp(message.header.stamp) - stamp_ns
            for stamp_ns, message in first
            if not isinstance(message, MalformedMessage)
        ]
        return first[0][0] if first else 0, sorted(ahead)[len(ahead) // 2] if ahead else 0

    def _first_info(self) -> Any:
        """The first CameraInfo; it also applies to images that were recorded before it."""
        if self.info_topic is None:
            return None
        first = next(iter(self._bag.messages({self.info_topic})), None)
        if first is None:
            return WrongCameraInfo(f'no readable message on {self.info_topic}')
        return _as_info(_decoded(first))

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

    See :func:`~msg_adapters.bags.choose_input` for the choice, and
    :func:`~msg_adapters.raw_bags.open_bag` for the storages and for bags that a crash cut off.

    Raises:
        BagError: no bag, nothing readable in it, or no usable topic; the line names those it has.
    """
    bag = open_bag(path)
    try:
        return BagSession(bag, choose_input(bag, topic))
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


def decode(raw: RawMessage) -> Any:
    """The message of serialised bytes, with read-only numpy arrays for its data.

    Raises:
        MalformedMessage: bytes that are no message of that type.
    """
    try:
        return jazzy_types().deserialize_cdr(raw.data, raw.msgtype)
    except Exception as error:  # rosbags' parsers raise nearly anything on damaged bytes
        raise MalformedMessage(f'{raw.msgtype} cannot be decoded: {" ".join(str(error).split())}') from None


def _named(bag: RawBag, topic: str) -> InputTopic:
    names = {topic, f'/{topic.lstrip("/")}'}
    channels = [c for c in bag.channels if c.topic in names and c.msgtype in (CLOUD, IMAGE)]
    if not channels:
        msg = f'{bag.path} has no clouds or images on {topic}; its topics: {_listed(bag)}'
        raise BagError(msg)
    rank, info = _usable(bag, channels[0])
    if rank is None:
        msg = (
            f'{channels[0].topic} of {bag.path} is no depth image with a camera_info; topics: {_listed(bag)}'
        )
        raise BagError(msg)
    return _with_colour(bag, InputTopic(channels[0].topic, channels[0].count, info))


def _usable(bag: RawBag, channel: Channel) -> tuple[int | None, str | None]:
    """Rank of a channel as an input, None if it is none, and its CameraInfo's topic."""
    if channel.msgtype not in (CLOUD, IMAGE):
        return None, None
    first = _first(bag, channel.topic)
    if channel.msgtype == CLOUD:
        if first is None or first.height <= 1:
            return 3, None
        return (0 if {'rgb', 'rgba'} & {field.name for field in first.fields} else 1), None
    info = _info_topic(bag, channel.topic)
    depth = (
        first is not None
        and first.encoding in DEPTH_ENCODINGS
        and (first.encoding != MONO16 or 'depth' in channel.topic)
    )
    return (2 if depth and info else None), info


def _with_colour(bag: RawBag, source: InputTopic) -> InputTopic:
    """With the first topic of colour images that have the frame and size of its depth images, if any."""
    if source.info_topic is None:
        return source
    depth = _first(bag, source.topic)
    for channel in sorted(bag.channels, key=lambda c: c.topic):
        if channel.msgtype != IMAGE or channel.topic == source.topic:
            continue
        image = _first(bag, channel.topic)
        if image is not None and image.encoding in COLOUR_ENCODINGS and same_view(depth, image):
            return dataclasses.replace(source, colour_topic=channel.topic)
    return source


def _first(bag: RawBag, topic: str) -> Any:
    """The first message of a topic; None where there is none, or none that can be read."""
    try:
        return next((decode(raw) for raw in bag.messages({topic})), None)
    except MalformedMessage:
        return None


def _info_topic(bag: RawBag, image_topic: str) -> str | None:
    """The CameraInfo in the image's namespace, or else the only one there is."""
    topics = [c.topic for c in bag.channels if c.msgtype == CAMERA_INFO]
    namespace = image_topic.rpartition('/')[0]
    beside = [t for t in topics if t.rpartition('/')[0] == namespace]
    if beside:
        return beside[0]
    return topics[0] if len(topics) == 1 else None


def _listed(bag: RawBag) -> str:
    return ', '.join(f'{c.topic} ({c.msgtype})' for c in bag.channels)


def _coloured(
    pairs: Iterator[tuple[tuple[int, DepthFrame | MalformedMessage], Any]],
) -> Iterator[tuple[int, DepthFrame | MalformedMessage]]:
    """The frames with the colours of their partners, where these can be read."""
    for (stamp_ns, frame), colour in pairs:
        if colour is not None and isinstance(frame, DepthFrame):
            with suppress(MalformedMessage):
                rgb = read_colour(colour)
                if rgb.shape[:2] == frame.depth.shape:
                    frame = dataclasses.replace(frame, rgb=rgb)
        yield stamp_ns, frame


def _as_info(message: Any) -> Any:
    """A CameraInfo, or why images have none."""
    return WrongCameraInfo(str(message)) if isinstance(message, MalformedMessage) else message


def _decoded(raw: RawMessage) -> Any:
    """The message, or the error that says why there is none."""
    try:
        return decode(raw)
    except MalformedMessage as malformed:
        return malformed
