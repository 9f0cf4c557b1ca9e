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

"""Reading a rosbag2 sqlite3 file that a crash cut off, or whose journal was never merged."""

import os
import shutil
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from msg_adapters.errors import BagError
from msg_adapters.raw_messages import Channel, RawMessage

MAGIC = b'SQLite format 3\x00'
_PAGE_SIZES = {1 << n for n in range(9, 17)}
_MISSES = 1000  # lost messages in a row that mean the end


class SqliteSalvage:
    """The messages of a damaged sqlite3 bag, in the order they were written.

    They are read one by one, because a lost page loses its messages but not those after it.
    Opening reads the file once, to count what can be read.

    Raises:
        BagError: not a rosbag2 sqlite3 file, or its tables are lost.
    """

    def __init__(self, path: Path) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._path = path
        if surplus := path.stat().st_size % _page_size(path):
            # sqlite pads a partial page with zeros, and a message would end in them unnoticed
            self._folder = tempfile.TemporaryDirectory(prefix='debris_scanner_')
            self._path = Path(self._folder.name, path.name)
            shutil.copyfile(path, self._path)
            os.truncate(self._path, path.stat().st_size - surplus)
        self._errors = 0
        try:
            with closing(self._connect()) as database:
                rows = database.execute(
                    "SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'"
                )
                self._topics = {int(i): (str(name), str(kind)) for i, name, kind in rows}
        except sqlite3.Error as error:
            msg = f'{path} is no readable rosbag2 sqlite3 file: {error}'
            raise BagError(msg) from None
        counts = Counter(topic for topic, _, _ in self._rows())
        self.channels = [Channel(*self._topics[topic], n) for topic, n in counts.items()]
        self.warnings: list[str] = []
        if self._errors or not is_complete(path):
            self.warnings.append(
                f'{path.name} was cut off or never closed: '
                f'the {counts.total()} messages of its intact part are used'
            )

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics."""
        wanted = {topic for topic, (name, _) in self._topics.items() if name in topics}
        for topic, stamp_ns, data in self._rows():
            if topic in wanted:
                yield RawMessage(*self._topics[topic], stamp_ns, data)

    def close(self) -> None:
        """Remove the copy that was read, if there is one; nothing else stays open between the walks."""
        if self._folder is not None:
            self._folder.cleanup()

    def _rows(self) -> Iterator[tuple[int, int, bytes]]:
        """Topic, time and bytes of each message that can be read; counts the errors on the way."""
        self._errors = misses = row = 0
        with closing(self._connect()) as database:
            while misses < _MISSES:
                row += 1
                misses += 1
                try:
                    found = database.execute(
                        'SELECT topic_id, timestamp, data FROM messages WHERE id = ?', (row,)
                    ).fetchone()
                except sqlite3.Error:
                    self._errors += 1
                    continue
                if found and found[0] in self._topics and isinstance(found[2], bytes):
                    misses = 0
                    yield int(found[0]), int(found[1]), found[2]

    def _connect(self) -> sqlite3.Connection:
        """Read-only connection that uses a leftover journal and accepts a file that is too short."""
        database = sqlite3.connect(f'{self._path.absolute().as_uri()}?mode=ro', uri=True)
        # without this, sqlite refuses a file that is shorter than its header says
        database.execute('PRAGMA writable_schema = ON')
        return database


def is_complete(path: Path) -> bool:
    """Whether a sqlite3 file has all the pages its header announces, and no journal beside it."""
    with path.open('rb') as file:
        head = file.read(100)
    if len(head) < 100 or not head.startswith(MAGIC):
        return False
    size = _page_size(path) * int.from_bytes(head[28:32], 'big')
    journal = path.with_name(f'{path.name}-wal')
    return path.stat().st_size >= size and not (journal.exists() and journal.stat().st_size)


def _page_size(path: Path) -> int:
    """Bytes of a page, from the header: a power of two, 512 to 65536; 4096 where the header is damaged."""
    with path.open('rb') as file:
        size = int.from_bytes(file.read(18)[16:], 'big')
    size = 65536 if size == 1 else size
    return size if size in _PAGE_SIZES else 4096
