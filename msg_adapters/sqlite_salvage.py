"""Reading a rosbag2 sqlite3 file that a crash cut off, or whose journal was never merged."""

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from msg_adapters.errors import BagError
from msg_adapters.raw_messages import Channel, RawMessage

MAGIC = b'SQLite format 3\x00'


class SqliteSalvage:
    """The messages of a damaged sqlite3 bag, in the order they were written, up to the first lost page.

    Opening walks the file once, to count what can be read.

    Raises:
        BagError: not a rosbag2 sqlite3 file, or its tables are lost.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with closing(self._connect()) as database:
                rows = database.execute(
                    "SELECT id, name, type FROM topics WHERE serialization_format = 'cdr'"
                )
                self._topics = {int(i): (str(name), str(kind)) for i, name, kind in rows}
        except sqlite3.Error as error:
            msg = f'{path} is no readable rosbag2 sqlite3 file: {error}'
            raise BagError(msg) from None
        self._error = ''
        counts: Counter[int] = Counter(topic for topic, _, _ in self._rows('length(data)'))
        self.channels = [Channel(*self._topics[topic], n) for topic, n in counts.items()]
        self.warnings: list[str] = []
        if self._error:
            self.warnings.append(
                f'{path.name} is damaged ({self._error}): '
                f'the {counts.total()} messages of its intact part are used'
            )

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics."""
        wanted = {topic for topic, (name, _) in self._topics.items() if name in topics}
        for topic, stamp_ns, data in self._rows('data'):
            if topic in wanted and isinstance(data, bytes):
                yield RawMessage(*self._topics[topic], stamp_ns, data)

    def close(self) -> None:
        """Nothing stays open between the walks."""

    def _rows(self, column: str) -> Iterator[tuple[int, int, object]]:
        """Topic, time and one column of each message, until a page is missing."""
        with closing(self._connect()) as database:
            try:
                # by row, not by the index on time: its pages may be the ones that are lost
                for topic, stamp, value in database.execute(
                    f'SELECT topic_id, timestamp, {column} FROM messages NOT INDEXED ORDER BY id'
                ):
                    if topic in self._topics:
                        yield int(topic), int(stamp), value
            except sqlite3.Error as error:
                self._error = str(error)

    def _connect(self) -> sqlite3.Connection:
        """Read-only, with a journal left behind taken into account, and a file that is too short accepted."""
        database = sqlite3.connect(f'{self._path.absolute().as_uri()}?mode=ro', uri=True)
        database.execute(
            'PRAGMA writable_schema = ON'
        )  # or sqlite refuses a file shorter than its header says
        return database
