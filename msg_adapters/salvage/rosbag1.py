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

"""Reading a ROS 1 bag that has no index: record by record, to the last intact message.

A bag gets its index when it is closed. A crashed recorder leaves none (``.bag.active``), and its last chunk
claims to be empty while its records follow it. Records within chunks and after them are both walked.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from msg_adapters.errors import BagError
from msg_adapters.raw_messages import decompress_start
from msg_adapters.salvage.mapped_files import mapped

MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _CHUNK, _CONNECTION = b'\x02', b'\x05', b'\x07'


class Ros1Message(NamedTuple):
    """A message as the bag holds it: ROS 1 type name and serialisation, bag time in nanoseconds."""

    topic: str
    msgtype: str
    stamp_ns: int
    data: bytes


class Rosbag1Salvage:
    """The messages of a ROS 1 bag without a usable index, in the order of the file.

    Opening walks the file once, to count what is in it.

    Raises:
        BagError: not a ROS 1 bag.
    """

    def __init__(self, path: Path) -> None:
        with path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                msg = f'{path} is not a ROS 1 bag'
                raise BagError(msg)
        self._path = path
        self._connections: dict[bytes, tuple[str, str]] = {}
        self.counts = Counter((m.topic, m.msgtype) for m in self.messages())

    def messages(self) -> Iterator[Ros1Message]:
        """All readable messages."""
        yield from self._walk(mapped(self._path)[len(MAGIC) :])

    def _walk(self, view: memoryview, in_chunk: bool = False) -> Iterator[Ros1Message]:
        for header, body, complete in _records(view):
            op = header.get('op')
            if op == _CHUNK and not in_chunk:
                compression = header.get('compression', b'').decode(errors='replace')
                yield from self._walk(memoryview(decompress_start(compression, body)[0]), in_chunk=True)
            elif op == _CONNECTION and complete:
                kind = _header(body).get('type', b'').decode(errors='replace').replace('/', '/msg/')
                topic = header.get('topic', b'').decode(errors='replace')
                self._connections[header.get('conn', b'')] = (topic, kind)
            elif op == _MESSAGE and complete and len(time := header.get('time', b'')) == 8:
                connection = self._connections.get(header.get('conn', b''))
                if connection:
                    seconds, nanoseconds = struct.unpack('<II', time)
                    yield Ros1Message(*connection, seconds * 10**9 + nanoseconds, bytes(body))


def _records(view: memoryview) -> Iterator[tuple[dict[str, bytes], memoryview, bool]]:
    """Header and body of each record, and whether the body is complete (only the last may not be)."""
    start = 0
    while start + 4 <= len(view):
        body_start = start + 4 + int.from_bytes(view[start : start + 4], 'little')
        if body_start + 4 > len(view):
            return
        end = body_start + 4 + int.from_bytes(view[body_start : body_start + 4], 'little')
        yield _header(view[start + 4 : body_start]), view[body_start + 4 : end], end <= len(view)
        start = end


def _header(view: memoryview) -> dict[str, bytes]:
    """Fields name=value of a record's header, as far as they can be read."""
    fields: dict[str, bytes] = {}
    start = 0
    while start + 4 <= len(view):
        size = int.from_bytes(view[start : start + 4], 'little')
        name, _, value = bytes(view[start + 4 : start + 4 + size]).partition(b'=')
        fields[name.decode(errors='replace')] = value
        start += 4 + size
    return fields
