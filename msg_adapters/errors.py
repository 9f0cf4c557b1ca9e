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

"""The errors that readers of messages and bags raise, each with one line of text."""

from debris_scanner.core.results import CAMERA_INFO

_LONGEST = 2000  # characters


class _OneLine(ValueError):
    """Names from a damaged message may hold line breaks, or never end; its report must not."""

    def __init__(self, text: str) -> None:
        line = ''.join(c if c.isprintable() else ' ' for c in text[:_LONGEST])
        super().__init__(line if len(text) <= _LONGEST else f'{line} ...')


class MalformedMessage(_OneLine):
    """A message that contradicts itself, or lacks what it is read for; the text names the thing.

    ``reason`` is the key it is counted under in summary.json.
    """

    reason = 'malformed'


class WrongCameraInfo(MalformedMessage):
    """A CameraInfo that cannot be that of the depth images; the text names its values."""

    reason = CAMERA_INFO


class NotOptical(MalformedMessage):
    """A cloud that lies in no optical frame, and of which nothing tells how it lies."""


class DuplicateFrame(MalformedMessage):
    """A frame that was delivered before, under another stamp."""

    reason = 'duplicate'


class BagError(_OneLine):
    """A bag that cannot be read or written at all; the text names the thing."""
