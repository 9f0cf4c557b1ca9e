"""What a bag holds before anything is decoded, whatever its storage."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol


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
    """One storage that messages are read from; what had to be left out stands in ``warnings``."""

    @property
    def channels(self) -> list[Channel]:
        """Topics with at least one message."""

    @property
    def warnings(self) -> list[str]:
        """What is damaged, one line each; reading may add to it."""

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of these topics in order of time, anew with every call."""

    def close(self) -> None:
        """Let go of the files."""
