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

"""ROS 1 messages to ROS 2: the same message, serialised as ROS 2 does."""

import contextlib
import io
from collections.abc import Callable
from functools import cache
from typing import Any

from rosbags.convert.converter import generate_message_converter
from rosbags.typesys import Stores, get_typestore

Converter = Callable[[bytes], bytes]


@cache
def jazzy_types() -> Any:
    """Message types of ROS 2 Jazzy, as rosbags' typestore."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def _noetic_types() -> Any:
    return get_typestore(Stores.ROS1_NOETIC)


@cache
def ros1_converter(msgtype: str) -> Converter | None:
    """What turns ROS 1 bytes of a type into ROS 2 (CDR) bytes; None if either side knows no such type.

    The converter raises whatever rosbags raises on damaged bytes.
    """
    if msgtype not in _noetic_types().fielddefs or msgtype not in jazzy_types().fielddefs:
        return None
    with contextlib.redirect_stdout(io.StringIO()):  # rosbags prints which types it migrates
        convert = generate_message_converter(
            _noetic_types(), jazzy_types(), msgtype, msgtype, {}, src_is2=False, dst_is2=True
        )
    return lambda data: bytes(convert(data))
