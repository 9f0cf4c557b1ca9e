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

"""The input of a recorded session: which of a bag's topics has the depth, and what belongs to it."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from msg_adapters.colour_images import names_brightness, picture_rank
from msg_adapters.depth_images import DEPTH_ENCODINGS, MONO16
from msg_adapters.errors import BagError, MalformedMessage, NotOptical
from msg_adapters.inputs.camera_infos import is_rectified, other_view
from msg_adapters.inputs.compressed import decompressed, is_depth
from msg_adapters.inputs.decoder import COMPRESSED, FrameDecoder, InputOptions
from msg_adapters.inputs.static_frames import TF_STATIC, StaticFrames
from msg_adapters.raw_bags import RawBag
from msg_adapters.raw_messages import Channel, RawMessage, jazzy_types

CLOUD = 'sensor_msgs/msg/PointCloud2'
IMAGE = 'sensor_msgs/msg/Image'
CAMERA_INFO = 'sensor_msgs/msg/CameraInfo'
TF_MESSAGE = 'tf2_msgs/msg/TFMessage'
FLOAT = 'std_msgs/msg/Float32'
# published by this package: in a recorded session these are results, not inputs
OWN_CLOUDS = frozenset({'target_points', 'keyframe_points', 'model'})
DEPTH_UNITS = 'depth_units'  # an option that the RealSense Viewer records: metres a unit


@dataclass(frozen=True)
class InputTopic:
    """A topic of clouds, or of depth images with the CameraInfo that belongs to them."""

    topic: str
    count: int
    info_topic: str | None  # None for clouds
    colour_topic: str | None = None  # images of the same pixels, beside depth images
    compressed: bool = False  # depth images are CompressedImage
    remark: str = ''  # on what is left out

    @property
    def rectified(self) -> bool:
        """Whether the depth images say that they are rectified."""
        return is_rectified(self.topic)


def choose_input(bag: RawBag, topic: str | None, options: InputOptions | None = None) -> InputTopic:
    """The input named, or else the best there is.

    Best first: organised clouds with colour, organised clouds, depth images with their CameraInfo, the same
    compressed, unorganised clouds; among equals the topic with most messages, then the first by name. The
    first message of each topic decides its kind: an Image counts if its encoding is a depth, a cloud if its
    frame is the optical one or tells how it lies. Clouds that this package publishes are ignored. A
    CameraInfo belongs to the images with which it shares most of its namespace; a single one belongs to all.

    Raises:
        BagError: no such topic, or none that is usable; the line names those there are, or why one is not.
    """
    if topic is not None:
        return _named(bag, topic, options)
    entries = [
        (channel, *_usable(bag, channel, options))
        for channel in bag.channels
        if channel.topic.rsplit('/', 1)[-1] not in OWN_CLOUDS
    ]
    ranked = [
        (rank, -channel.count, channel.topic, channel, info)
        for channel, rank, info, _ in entries
        if rank is not None
    ]
    if not ranked:
        whys = [f'{channel.topic}: {why}' for channel, _, _, why in entries if why]
        clouds = any(channel.msgtype == CLOUD for channel, *_ in entries)
        kind = 'usable cloud' if clouds else 'cloud'
        msg = f'{bag.path} has no {kind}, and no depth image with a camera_info'
        raise BagError(f'{msg}; {whys[0]}' if whys else f'{msg}; its topics: {listed(bag)}')
    *_, channel, info = min(ranked, key=lambda entry: entry[:3])
    return _with_colour(bag, _topic(channel, info))


def make_decoder(bag: RawBag, source: InputTopic | None, options: InputOptions | None = None) -> FrameDecoder:
    """A decoder that knows what the bag tells beside the frames: static transforms, the unit of depth.

    Raises:
        BagError: the options' axes are none.
    """
    try:
        decoder = FrameDecoder(options, static_frames(bag))
    except ValueError as error:
        raise BagError(str(error)) from None
    if source is not None:
        decoder.unit = depth_unit(bag, source.topic)
    return decoder


def static_frames(bag: RawBag) -> StaticFrames:
    """All transforms of the bag's /tf_static, whenever they were sent."""
    frames = StaticFrames()
    for raw in static_messages(bag):
        message = decoded(raw)
        if not isinstance(message, MalformedMessage):
            frames.add(message)
    return frames


def static_messages(bag: RawBag) -> Iterator[RawMessage]:
    """The messages of the bag's /tf_static."""
    topics = {c.topic for c in bag.channels if c.msgtype == TF_MESSAGE and c.topic.endswith(TF_STATIC)}
    if topics:
        yield from bag.messages(topics)


def decode(raw: RawMessage) -> Any:
    """The message of serialised bytes, with read-only numpy arrays for its data.

    Raises:
        MalformedMessage: bytes that are no message of that type.
    """
    try:
        return jazzy_types().deserialize_cdr(raw.data, raw.msgtype)
    except Exception as error:  # rosbags' parsers raise nearly anything on damaged bytes
        raise MalformedMessage(f'{raw.msgtype} cannot be decoded: {" ".join(str(error).split())}') from None


def decoded(raw: RawMessage) -> Any:
    """The message, or the error that says why there is none."""
    try:
        return decode(raw)
    except MalformedMessage as malformed:
        return malformed


def first(bag: RawBag, topic: str) -> Any:
    """The first message of a topic; None where there is none, or none that can be read."""
    try:
        return next((decode(raw) for raw in bag.messages({topic})), None)
    except MalformedMessage:
        return None


def listed(bag: RawBag) -> str:
    """The bag's topics with their types, in words."""
    return ', '.join(f'{c.topic} ({c.msgtype})' for c in bag.channels)


def _topic(channel: Channel, info: str | None) -> InputTopic:
    return InputTopic(channel.topic, channel.count, info, compressed=channel.msgtype == COMPRESSED)


def _named(bag: RawBag, topic: str, options: InputOptions | None) -> InputTopic:
    names = {topic, f'/{topic.lstrip("/")}'}
    channels = [c for c in bag.channels if c.topic in names and c.msgtype in (CLOUD, IMAGE, COMPRESSED)]
    if not channels:
        msg = f'{bag.path} has no clouds or images on {topic}; its topics: {listed(bag)}'
        raise BagError(msg)
    rank, info, why = _usable(bag, channels[0], options)
    if rank is None:
        msg = f'{channels[0].topic} of {bag.path} is no depth image with a camera_info'
        raise BagError(f'{msg}: {why}' if why else f'{msg}; topics: {listed(bag)}')
    return _with_colour(bag, _topic(channels[0], info))


def _usable(
    bag: RawBag, channel: Channel, options: InputOptions | None
) -> tuple[int | None, str | None, str]:
    """Rank of a channel as an input, None if it is none, its CameraInfo's topic, and why it is none."""
    if channel.msgtype not in (CLOUD, IMAGE, COMPRESSED):
        return None, None, ''
    message = first(bag, channel.topic)
    if channel.msgtype == CLOUD:
        if message is None:
            return 4, None, ''
        try:
            make_decoder(bag, None, options).cloud(message)
        except NotOptical as error:
            return None, None, str(error)
        except MalformedMessage:
            pass  # its kind is known; the frame will be counted
        if message.height <= 1:
            return 4, None, ''
        return (0 if {'rgb', 'rgba'} & {field.name for field in message.fields} else 1), None, ''
    if message is None or not _is_depth(channel, message):
        return None, None, '' if message is None else _other_picture(channel, message)
    if channel.msgtype == COMPRESSED:
        try:
            decompressed(message)
        except MalformedMessage as error:
            return None, None, str(error)
    info, why = _info_topic(bag, channel.topic, message)
    return (None if info is None else 3 if channel.msgtype == COMPRESSED else 2), info, why


def _is_depth(channel: Channel, message: Any) -> bool:
    if channel.msgtype == COMPRESSED:
        return is_depth(message)
    name = channel.topic.lower()
    return message.encoding in DEPTH_ENCODINGS and (
        'depth' in name or not (message.encoding == MONO16 or names_brightness(name))
    )


def _other_picture(channel: Channel, message: Any) -> str:
    """Why an image that is named for its depth is none; empty for other names."""
    if 'depth' not in channel.topic.lower():
        return ''
    if channel.msgtype == COMPRESSED:
        return f'its format {message.format!r} is no compressed depth, as "16UC1; compressedDepth png" is'
    return f'its encoding {message.encoding!r} is none of a depth image: {", ".join(DEPTH_ENCODINGS)}'


def _with_colour(bag: RawBag, source: InputTopic) -> InputTopic:
    """With the first topic of pictures of its depth images' pixels, if any; see :func:`other_view`.

    Colour is preferred to brightness.
    """
    if source.info_topic is None:
        return source
    depth, remark = first(bag, source.topic), ''
    depth_info = first(bag, source.info_topic)
    pictures = []
    for channel in bag.channels:
        if channel.msgtype == IMAGE and channel.topic != source.topic:
            image = first(bag, channel.topic)
            rank = None if image is None else picture_rank(channel.topic, image.encoding)
            if rank is not None:
                pictures.append((rank, channel.topic, channel, image))
    for _, _, channel, image in sorted(pictures, key=lambda picture: picture[:2]):
        info_topic = _info_topic(bag, channel.topic, image)[0]
        info = None if info_topic in (None, source.info_topic) else first(bag, info_topic or '')
        why = other_view(depth, depth_info, image, info)
        if not why:
            return dataclasses.replace(source, colour_topic=channel.topic, remark='')
        remark = remark or f'colour of {channel.topic} is not used: {why}'
    return dataclasses.replace(source, remark=remark)


def _info_topic(bag: RawBag, image_topic: str, image: Any) -> tuple[str | None, str]:
    """The CameraInfo that shares most of the image's namespace, or else the only one; and why there is none.

    None that shares more with other images. Of several as near, that of the image's size.
    """
    topics = sorted(c.topic for c in bag.channels if c.msgtype == CAMERA_INFO)
    images = [c.topic for c in bag.channels if c.msgtype in (IMAGE, COMPRESSED)]
    shared = {t: _shared(t, image_topic) for t in topics}
    shared = {t: n for t, n in shared.items() if n == max(_shared(t, i) for i in images)}
    most = max(shared.values(), default=0)
    nearest = [t for t, n in shared.items() if n == most and most > 0]
    if len(nearest) > 1 and hasattr(image, 'width'):
        infos = {t: first(bag, t) for t in nearest}
        fit = [t for t, i in infos.items() if i and (i.width, i.height) == (image.width, image.height)]
        nearest = fit or nearest
    if len(nearest) == 1 or (nearest and image_topic.count('/') - most == 1):
        return nearest[0], ''
    if len(topics) == 1:
        return topics[0], ''
    if not topics:
        return None, 'the bag has no camera_info'
    return None, f'none of {", ".join(topics)} lies in its namespace, or several do'


def _shared(topic: str, other: str) -> int:
    """Number of names that the namespaces of two topics begin with alike."""
    a, b = (t.strip('/').split('/')[:-1] for t in (topic, other))
    return next((n for n, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))


def depth_unit(bag: RawBag, topic: str) -> float:
    """Metres a unit, by an option of the depth topic's sensor; 0 where there is none."""
    units = [
        c.topic
        for c in bag.channels
        if c.msgtype == FLOAT and DEPTH_UNITS in c.topic.lower().replace(' ', '_').split('/')
    ]
    if not units:
        return 0.0
    message = first(bag, max(units, key=lambda t: _shared(t, topic)))
    unit = 0.0 if message is None else float(message.data)
    return unit if 0 < unit < 1 else 0.0
