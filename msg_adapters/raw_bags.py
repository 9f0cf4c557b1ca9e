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

"""A bag of any storage as one stream of serialised messages: what a player republishes unchanged."""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType

from msg_adapters.bag_sources import Rosbag2Source, open_file
from msg_adapters.errors import BagError
from msg_adapters.raw_messages import Channel, RawMessage, Source
from msg_adapters.sqlite_salvage import is_whole

_SUFFIXES = ('.mcap', '.db3')


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
        """Messages in order of the bag's time, of these topics or of all; anew with every call.

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
    """Open a rosbag2 folder, a bare .mcap or .db3 file, or a ROS 1 .bag.

    A bag cut off by a crash opens with what is intact, and says so in ``warnings``.

    Raises:
        BagError: no such path, not a bag, or nothing in it can be read.
    """
    path = Path(path)
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


def _folder(path: Path) -> tuple[list[Source], list[str]]:
    """The storages of a rosbag2 folder: through its metadata, or file by file if that fails."""
    files = sorted(f for f in path.iterdir() if f.suffix in _SUFFIXES)
    reason = 'a sqlite3 file is cut off, or its journal was never merged'
    if all(is_whole(f) for f in files if f.suffix == '.db3'):
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
