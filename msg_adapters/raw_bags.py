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

"""A bag of any storage as one stream of undecoded messages, which a player republishes unchanged.

Each storage is a :class:`~msg_adapters.raw_messages.Source`. An intact bag is read by rosbags through its
index. A bag that rosbags refuses is read by :mod:`msg_adapters.salvage`.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from debris_scanner.core.optional import Absent, MissingLibrary
from msg_adapters.errors import BagError
from msg_adapters.raw_messages import Channel, RawMessage, Source, decompress_start, ros1_converter
from msg_adapters.salvage import mcap as mcap_salvage
from msg_adapters.salvage import rosbag1 as rosbag1_salvage
from msg_adapters.salvage import sqlite as sqlite_salvage
from msg_adapters.salvage.sqlite import is_complete

try:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
except ImportError:
    Reader1 = Reader2 = Absent('rosbags')

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'  # a CDR message starts with two zeros or 0, 1, so there is no confusion
_SUFFIXES = ('.mcap', '.db3')


class Rosbag2Source:
    """An intact rosbag2: a folder with its metadata, or one .mcap or .db3 file.

    Raises:
        BagError: rosbags refuses it.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._reader = Reader2(path)
            self._reader.open()
        except Exception as error:  # rosbags' parsers raise nearly anything on damaged bytes
            msg = f'{path}: {_line(error)}'
            raise BagError(msg) from None
        self.warnings: list[str] = []
        self._name = path.name
        self._connections = [c for c in self._reader.connections if c.msgcount]
        self.channels = _merged((c.topic, c.msgtype, c.msgcount) for c in self._connections)

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics; ends early, with a warning, where the file is damaged."""
        connections = [c for c in self._connections if c.topic in topics]
        if not connections:
            return
        read = 0
        try:
            for connection, stamp_ns, data in self._reader.messages(connections):
                plain = _unpacked(data) if data[:4] == _ZSTD_MAGIC else bytes(data)
                yield RawMessage(connection.topic, connection.msgtype, stamp_ns, plain)
                read += 1
        except Exception as error:
            _warn(self.warnings, f'{self._name} is damaged after {read} messages: {_line(error)}')

    def close(self) -> None:
        """Close the files."""
        with suppress(Exception):
            self._reader.close()


class Rosbag1Source:
    """A ROS 1 bag, its messages converted to ROS 2; types that either side lacks are left out.

    Raises:
        BagError: not a ROS 1 bag.
    """

    def __init__(self, path: Path) -> None:
        self.warnings: list[str] = []
        self._name = path.name
        self._reader: Any = None
        counts: Counter[tuple[str, str]] = Counter()
        try:
            self._reader = Reader1(path)
            self._reader.open()
            for connection in self._reader.connections:
                counts[connection.topic, connection.msgtype] += connection.msgcount
        except Exception:  # no index, as in .bag.active, or a damaged one
            self._reader = None
            self._salvage = rosbag1_salvage.Rosbag1Salvage(path)
            counts = self._salvage.counts
            self.warnings.append(
                f'{path.name} was cut off or never closed: '
                f'the {counts.total()} messages of its intact part are used'
            )
        self.channels = _merged((t, kind, n) for (t, kind), n in counts.items() if n and ros1_converter(kind))

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics; one that cannot be converted is left out, with a warning."""
        for topic, msgtype, stamp_ns, data in self._ros1_messages(topics):
            converter = ros1_converter(msgtype)
            if topic not in topics or converter is None:
                continue
            try:
                converted = converter(data)
            except Exception as error:
                _warn(
                    self.warnings,
                    f'{self._name}: message of {topic} at {stamp_ns} is damaged: {_line(error)}',
                )
                continue
            yield RawMessage(topic, msgtype, stamp_ns, converted)

    def _ros1_messages(self, topics: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
        if self._reader is None:
            yield from self._salvage.messages()
            return
        connections = [c for c in self._reader.connections if c.topic in topics]
        try:
            for connection, stamp_ns, data in self._reader.messages(connections) if connections else ():
                yield connection.topic, connection.msgtype, stamp_ns, bytes(data)
        except Exception as error:
            _warn(self.warnings, f'{self._name} is damaged: {_line(error)}')

    def close(self) -> None:
        """Close the file."""
        if self._reader is not None:
            with suppress(Exception):
                self._reader.close()


def open_file(path: Path) -> Source:
    """One storage file, recognised by its first bytes: mcap, sqlite3 or ROS 1.

    Raises:
        BagError: none of these, or nothing of it can be read.
    """
    with path.open('rb') as file:
        head = file.read(16)
    if head.startswith(rosbag1_salvage.MAGIC):
        return Rosbag1Source(path)
    if head.startswith(mcap_salvage.MAGIC):
        return _intact_or(mcap_salvage.McapSalvage, path)
    if head == sqlite_salvage.MAGIC:
        if not sqlite_salvage.is_complete(path):  # rosbags may open it and read a part
            return sqlite_salvage.SqliteSalvage(path)
        return _intact_or(sqlite_salvage.SqliteSalvage, path)
    msg = f'{path} is not a bag: neither mcap, sqlite3 nor ROS 1' if head else f'{path} is empty'
    raise BagError(msg)


class RawBag:
    """An open bag; a context manager.

    ``channels`` are the topics that have messages, ``warnings`` says what is damaged, one line each.
    """

    def __init__(self, path: Path, sources: list[Source], warnings: list[str]) -> None:
        self.path = path
        self._sources = sources
        self._warnings = warnings
        counts: Counter[tuple[str, str]] = Counter()
        for source in sources:
            for channel in source.channels:
                counts[channel.topic, channel.msgtype] += channel.count
        self.channels = [Channel(topic, msgtype, count) for (topic, msgtype), count in sorted(counts.items())]

    @property
    def warnings(self) -> list[str]:
        """What is damaged; reading may add to it."""
        return self._warnings + [line for source in self._sources for line in source.warnings]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Messages in order of the bag's time, of these topics or of all; from the start with every call.

        ROS 1 messages come converted to ROS 2, so ``data`` is always CDR.
        """
        wanted = {c.topic for c in self.channels} if topics is None else set(topics)
        streams = [source.messages(wanted) for source in self._sources]
        yield from heapq.merge(*streams, key=lambda m: m.stamp_ns)

    def close(self) -> None:
        """Close the files."""
        for source in self._sources:
            source.close()

    def __enter__(self) -> 'RawBag':
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_bag(path: str | Path) -> RawBag:
    """Open a rosbag2 folder, a single .mcap or .db3 file, or a ROS 1 .bag.

    A bag that a crash cut off opens with its intact part; ``warnings`` says so.

    Raises:
        BagError: no such path, not a bag, or nothing in it can be read.
        MissingLibrary: rosbags is not installed.
    """
    path = Path(path)
    if isinstance(Reader2, Absent):  # else every bag would pass for a damaged one
        raise MissingLibrary.named('rosbags')
    try:
        if not path.exists():
            msg = f'{path} does not exist'
            raise BagError(msg)
        sources, warnings = _folder(path) if path.is_dir() else ([open_file(path)], [])
    except OSError as error:
        msg = f'{path} cannot be read: {error.strerror or error}'
        raise BagError(msg) from None
    bag = RawBag(path, sources, warnings)
    if not bag.channels:
        bag.close()
        msg = f'{path} holds no messages' + (
            ' that can be read: it is cut off or damaged' if bag.warnings else ''
        )
        raise BagError(msg)
    return bag


def _intact_or(salvage: type[mcap_salvage.McapSalvage | sqlite_salvage.SqliteSalvage], path: Path) -> Source:
    try:
        return Rosbag2Source(path)
    except BagError:
        return salvage(path)


def _unpacked(data: Any) -> bytes:
    plain, complete = decompress_start('zstd', memoryview(data))
    if not complete:
        msg = 'a compressed message is damaged'
        raise BagError(msg)
    return plain


def _merged(channels: Any) -> list[Channel]:
    """One channel for each topic and type, counts added: every publisher has its own connection."""
    counts: Counter[tuple[str, str]] = Counter()
    for topic, msgtype, count in channels:
        counts[topic, msgtype] += count
    return [Channel(topic, msgtype, count) for (topic, msgtype), count in counts.items()]


def _warn(warnings: list[str], line: str) -> None:
    if line not in warnings:  # a second pass meets the same damage
        warnings.append(line)


def _line(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def _folder(path: Path) -> tuple[list[Source], list[str]]:
    """The storages of a rosbag2 folder: by its metadata, or file by file if that fails."""
    files = sorted(f for f in path.iterdir() if f.suffix in _SUFFIXES)
    reason = 'a sqlite3 file is cut off, or its journal was never merged'
    if all(is_complete(f) for f in files if f.suffix == '.db3'):
        try:
            return [Rosbag2Source(path)], []
        except BagError as error:
            reason = str(error)
    if not files:
        msg = f'{path} is not a bag: no readable metadata.yaml, and no .mcap or .db3 file in it'
        if any(path.glob('*.png')) or any(path.glob('depth/*.png')):
            msg += '; depth images become one by debris-scan import'
        raise BagError(msg)
    sources: list[Source] = []
    warnings = []
    if not (path / 'metadata.yaml').exists():
        warnings.append(f'{path.name} has no metadata.yaml: its recorder did not finish')
    for file in files:
        try:
            sources.append(open_file(file))
        except BagError as error:
            warnings.append(str(error))
    if not sources:
        raise BagError('; '.join(warnings[-1:]) or reason)
    if not warnings and not any(source.warnings for source in sources):
        warnings.append(f'read without its metadata: {reason}')
    return sources, warnings
