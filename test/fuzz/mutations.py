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

"""Damage, drawn from a source of randomness: of bytes, and of ROS messages field by field."""

from array import array
from random import Random
from typing import Any

import numpy as np

INTEGERS = (0, 1, 2, 3, 7, 8, 255, 256, 4096, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1)
FLOATS = (0.0, -0.0, 1.0, -1.0, float('nan'), float('inf'), -float('inf'), 1e-320, 1e-30, 1e30, 1e308, 525.0)
TEXTS = (
    '', 'x', 'rgb', 'rgba', 'z', '16UC1', '32FC1', 'rgb8', 'mono16', '16UC1\x00', 'é' * 300,
    '\n\r\x1b[31m', '/' * 50, 'keyframe_', 'keyframe_-5', 'keyframe_' + '9' * 30, 'keyframe_' + '9' * 5000,
    'keyframe_٣', '9' * 5000,
    'nan', 'inf', '-1', '0', '1', '1e400', '9223372036854775808', '../../../etc/passwd', 'scan_ns', 'state',
)  # fmt: skip
WORDS = (b'\x00' * 4, b'\xff' * 4, b'\xff\xff\xff\x7f', b'\x00\x00\x00\x80', b'\x01\x00\x00\x00')
RANGES = {'8': 8, '16': 16, '32': 32, '64': 64}
PLENTY = 2000  # elements that a sequence may grow to here


def damaged(data: bytes, random: Random) -> bytes:
    """Bytes with one to eight changes: bits, words, pieces lost, doubled, swapped, zeroed or cut off."""
    out = bytearray(data)
    for _ in range(random.randint(1, 8)):
        if not out:
            break
        at = _place(len(out), random)
        kind = random.randrange(8)
        if kind == 0:
            out[at] ^= 1 << random.randrange(8)
        elif kind == 1:
            out[at] = random.randrange(256)
        elif kind == 2:
            at &= ~3
            out[at : at + 4] = random.choice(WORDS)
        elif kind == 3:
            del out[at : at + random.randint(1, 64)]
        elif kind == 4:
            out[at:at] = random.randbytes(random.randint(1, 64))
        elif kind == 5:
            length = random.randint(1, 4096)
            out[at : at + length] = bytes(min(length, len(out) - at))
        elif kind == 6:
            other = _place(len(out), random)
            out[other:other] = out[at : at + random.randint(1, 256)]
        elif random.random() < 0.3:
            del out[at:]
    return bytes(out)


def _place(length: int, random: Random) -> int:
    """Anywhere, but often near an end: headers and indices are where damage is treacherous."""
    anywhere = random.randrange(length)
    near = min(random.randrange(320), length - 1)
    return random.choice((anywhere, near, length - 1 - near))


def disturb(message: Any, random: Random) -> None:
    """One to four fields of a message, anywhere below it, made into something that its type can hold."""
    for _ in range(random.randint(1, 4)):
        _disturb_one(message, random)


def _disturb_one(message: Any, random: Random) -> None:
    name, kind = random.choice(list(message.get_fields_and_field_types().items()))
    value = getattr(message, name)
    if hasattr(value, 'get_fields_and_field_types'):
        _disturb_one(value, random)
    elif isinstance(value, list):
        _disturb_list(value, kind, random)
    elif isinstance(value, array):
        setattr(message, name, _disturbed_array(value, random))
    elif isinstance(value, np.ndarray):
        value[random.randrange(len(value))] = random.choice(FLOATS)
    else:
        setattr(message, name, _wild(value, kind, random))


def _wild(value: Any, kind: str, random: Random) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return random.choice((*FLOATS, random.uniform(-1e4, 1e4))) if 'double' in kind else 1.0
    if isinstance(value, str):
        return random.choice((*TEXTS, value + value, value[:-1]))
    if isinstance(value, bytes):
        return bytes([random.randrange(256)])
    bits = next((b for text, b in RANGES.items() if text in kind), 8)
    signed = not kind.startswith(('u', 'byte', 'octet', 'char'))
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    near = (value - 1, value + 1, 2 * value, value // 2, -value)
    return min(max(random.choice((*INTEGERS, *near, random.randrange(low, high))), low), high)


def _disturb_list(items: list[Any], kind: str, random: Random) -> None:
    if not items:
        return
    at, choice = random.randrange(len(items)), random.randrange(6)
    if choice == 0:
        del items[at]
    elif choice == 1:
        items.insert(random.randrange(len(items)), items[at])
    elif choice == 2:
        items.clear()
    elif choice == 3:
        items *= random.randint(2, max(2, PLENTY // len(items)))
    elif hasattr(items[at], 'get_fields_and_field_types'):
        _disturb_one(items[at], random)
    else:
        items[at] = _wild(items[at], kind, random)


def _disturbed_array(values: 'array[Any]', random: Random) -> 'array[Any]':
    if values.typecode != 'B':
        if values:
            values[random.randrange(len(values))] = random.choice(FLOATS)
        return values
    raw = values.tobytes()
    choice = random.randrange(5)
    if choice == 0:
        raw = raw[: random.randrange(len(raw) + 1)]
    elif choice == 1:
        raw += random.randbytes(random.randint(1, 5000))
    elif choice == 2:  # a flood of one value: NaN, Inf, -1, the largest float
        word = random.choice(
            (b'\x00\x00\xc0\x7f', b'\x00\x00\x80\x7f', b'\xff' * 4, b'\xff\xff\x7f\x7f', bytes(4))
        )
        raw = word * (len(raw) // 4) + raw[: len(raw) % 4]
    elif choice == 3:
        raw = random.randbytes(len(raw))
    else:
        raw = damaged(raw, random)
    return array('B', raw)
