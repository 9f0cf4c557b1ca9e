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

"""Which topic of a bag the depth frames come from, so that nobody needs to be told."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from msg_adapters.colour_images import COLOUR_ENCODINGS, same_view
from msg_adapters.depth_images import DEPTH_ENCODINGS, MONO16
from msg_adapters.errors import BagError, MalformedMessage
from msg_adapters.raw_bags import RawBag
from msg_adapters.raw_messages import Channel, RawMessage

CLOUD = 'sensor_msgs/msg/PointCloud2'
IMAGE = 'sensor_msgs/msg/Image'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
# what this package itself publishes: in a bag of a whole session these are results, not inputs
OWN_CLOUDS = frozenset({'target_points', 'keyframe_points', 'model'})

Decode = Callable[[RawMessage], Any]


@dataclass(frozen=True)
class InputTopic:
    """A topic of clouds, or of depth images with the CameraInfo that belongs to them."""

    topic: str
    count: int
    info_topic: str | None  # None for clouds
    colour_topic: str | None = None  # images of the same pixels, beside depth images


def choose_input(bag: RawBag, topic: str | None, decode: Decode) -> InputTopic:
    """The input named, or else the best there is.

    Best first: organised clouds with colour, organised clouds, depth images with their CameraInfo,
    unorganised clouds; among equals the one with most messages, then the first by name. The first
    message of each topic tells what it is: an Image counts where its encoding is a depth. Clouds that
    this package publishes are passed over. A CameraInfo belongs to the images of its namespace; an
    only one belongs to all.

    Raises:
        BagError: no such topic, or none that is usable; the line names those there are.
    """
    if topic is not None:
        return _named(bag, topic, decode)
    ranked = [
        (rank, -channel.count, channel.topic, channel, info)
        for channel in bag.channels
        if channel.topic.rsplit('/', 1)[-1] not in OWN_CLOUDS
        for rank, info in [_usable(bag, channel, decode)]
        if rank is not None
    ]
    if not ranked:
        msg = f'{bag.path} has no cloud, and no depth image with a camera_info; its topics: {_listed(bag)}'
        raise BagError(msg)
    *_, channel, info = min(ranked, key=lambda entry: entry[:3])
    return _with_colour(bag, InputTopic(channel.topic, channel.count, info), decode)


def _named(bag: RawBag, topic: str, decode: Decode) -> InputTopic:
    names = {topic, f'/{topic.lstrip("/")}'}
    channels = [c for c in bag.channels if c.topic in names and c.msgtype in (CLOUD, IMAGE)]
    if not channels:
        msg = f'{bag.path} has no clouds or images on {topic}; its topics: {_listed(bag)}'
        raise BagError(msg)
    rank, info = _usable(bag, channels[0], decode)
    if rank is None:
        msg = (
            f'{channels[0].topic} of {bag.path} is no depth image with a camera_info; topics: {_listed(bag)}'
        )
        raise BagError(msg)
    return _with_colour(bag, InputTopic(channels[0].topic, channels[0].count, info), decode)


def _usable(bag: RawBag, channel: Channel, decode: Decode) -> tuple[int | None, str | None]:
    """Rank of a channel as an input, None if it is none, and its CameraInfo's topic."""
    if channel.msgtype not in (CLOUD, IMAGE):
        return None, None
    first = _first(bag, channel.topic, decode)
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


def _with_colour(bag: RawBag, source: InputTopic, decode: Decode) -> InputTopic:
    """With the first topic of colour images that have the frame and size of its depth images, if any has."""
    if source.info_topic is None:
        return source
    depth = _first(bag, source.topic, decode)
    for channel in sorted(bag.channels, key=lambda c: c.topic):
        if channel.msgtype != IMAGE or channel.topic == source.topic:
            continue
        image = _first(bag, channel.topic, decode)
        if image is not None and image.encoding in COLOUR_ENCODINGS and same_view(depth, image):
            return dataclasses.replace(source, colour_topic=channel.topic)
    return source


def _first(bag: RawBag, topic: str, decode: Decode) -> Any:
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
