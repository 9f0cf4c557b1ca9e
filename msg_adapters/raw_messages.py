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

"""Undecoded messages of a bag, whatever its storage: their types, decompression, and conversion from ROS 1.

Decompression keeps what a cut-off or damaged stream held before its end. ROS 1 messages are converted to the
same messages as ROS 2 serialises them.
"""

import bz2
import contextlib
import io
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Protocol

import lz4.frame  # type: ignore[import-untyped]
from backports import zstd

from debris_scanner.core.optional import Absent

try:
    from rosbags.convert.converter import generate_message_converter
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    generate_message_converter = get_typestore = Stores = Absent('rosbags')

_PIECE = 1 << 16  # bytes decompressed at a time
_LARGEST = 1 << 29  # bytes of one chunk; recorders write about one million, or one message

Converter = Callable[[bytes], bytes]


@dataclass(frozen=True)
class Channel:
    """A topic of a bag with its type, as in ``sensor_msgs/msg/Image``, and its number of messages."""

    topic: str
    msgtype: str
    count: int


class RawMessage(NamedTuple):
    """One message: the bag's own time stamp, nanoseconds, and the serialised (CDR) bytes."""

    topic: str
    msgtype: str
    stamp_ns: int
    data: bytes


class Source(Protocol):
    """One storage that messages are read from; ``warnings`` says what had to be left out."""

    @property
    def channels(self) -> list[Channel]:
        """Topics with at least one message."""

    @property
    def warnings(self) -> list[str]:
        """What is damaged, one line each; reading may add to it."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics in order of time, from the start with every call."""

    def close(self) -> None:
        """Close the files."""


def decompress_start(compression: str, data: memoryview) -> tuple[bytes, bool]:
    """The readable start of a chunk, and whether it is complete.

    Args:
        compression: '' or 'none', 'zstd', 'lz4' (frames) or 'bz2'; of any other nothing is readable.
        data: compressed bytes, perhaps cut off.
    """
    if compression in ('', 'none'):
        return bytes(data), True
    decompressor = _decompressor(compression)
    if decompressor is None:
        return b'', False
    pieces: list[bytes] = []
    size = 0
    for start in range(0, len(data), _PIECE):
        try:
            piece = decompressor.decompress(data[start : start + _PIECE], _LARGEST - size)
        except (zstd.ZstdError, RuntimeError, OSError, EOFError, ValueError):  # each library raises its own
            break
        pieces.append(piece)
        size += len(piece)
        if decompressor.eof or size >= _LARGEST:  # a few crafted bytes unpack to any length
            break
    return b''.join(pieces), bool(decompressor.eof)


@cache
def jazzy_types() -> Any:
    """Message types of ROS 2 Jazzy, as rosbags' typestore."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def ros1_converter(msgtype: str) -> Converter | None:
    """Converter from ROS 1 bytes of a type to ROS 2 (CDR) bytes; None if either side has no such type.

    The converter raises whatever rosbags raises on damaged bytes.
    """
    if msgtype not in _noetic_types().fielddefs or msgtype not in jazzy_types().fielddefs:
        return None
    with contextlib.redirect_stdout(io.StringIO()):  # rosbags prints which types it migrates
        convert = generate_message_converter(
            _noetic_types(), jazzy_types(), msgtype, msgtype, {}, src_is2=False, dst_is2=True
        )
    return lambda data: bytes(convert(data))


def _decompressor(compression: str) -> Any:
    """A streaming decompressor: all three libraries share the interface."""
    if compression == 'zstd':
        return zstd.ZstdDecompressor()
    if compression == 'lz4':
        return lz4.frame.LZ4FrameDecompressor()
    if compression == 'bz2':
        return bz2.BZ2Decompressor()
    return None


@cache
def _noetic_types() -> Any:
    return get_typestore(Stores.ROS1_NOETIC)
