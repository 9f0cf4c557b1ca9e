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
