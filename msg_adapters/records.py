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

"""Small records as the key-value pairs of a DiagnosticStatus: one codec, typed by the record's dataclass.

A field of type ``bool`` is sent as 0 or 1, ``int`` as digits, ``float`` with every digit, ``str`` unchanged.
A field whose name ends in ``stamp_ns`` or ``scan_ns`` must be the time of a frame. Fields of other types, and
pairs that the record lacks, are ignored, so that a status may carry more than its record.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from debris_scanner.core.results import Check, Checks
from msg_adapters.errors import MalformedMessage
from msg_adapters.stamps import stamp_of_text

Record = TypeVar('Record')

_CHECK, _NO_BOUND = 'check.', '-'  # in front of its name, in place of its bound
_STAMPS = ('stamp_ns', 'scan_ns')


def record_values(record: Any) -> dict[str, bool | int | float | str]:
    """The fields of a dataclass that travel, by name."""
    kinds = {f.name: f.type for f in dataclasses.fields(record)}
    return {
        name: int(value) if kind is bool else value
        for name, kind in kinds.items()
        if kind in _READERS and (value := getattr(record, name)) is not None
    }


def read_record(kind: type[Record], values: Mapping[str, str], **given: Any) -> Record:
    """The inverse of :func:`record_values`.

    Args:
        kind: the dataclass.
        values: of the status.
        given: fields that travel elsewhere, such as the stamp of a header.

    Raises:
        MalformedMessage: a field is missing or cannot be read.
    """
    read = dict(given)
    for f in dataclasses.fields(kind):  # type: ignore[arg-type]
        if f.name in given or f.type not in _READERS:
            continue
        if f.name not in values:
            raise MalformedMessage(f'{kind.__name__} without {f.name}')
        reader = stamp_of_text if f.name.endswith(_STAMPS) else _READERS[f.type]
        try:
            read[f.name] = reader(values[f.name])
        except ValueError as error:
            raise MalformedMessage(f'{kind.__name__}: {f.name}: {error}') from None
    return kind(**read)


def check_values(checks: Iterable[Check]) -> dict[str, str]:
    """Checks for a status, a key each: value and bound with every digit, and 1 if it passed."""
    return {
        _CHECK + name: f'{float(value)!r} {_NO_BOUND if bound is None else repr(float(bound))} {int(passed)}'
        for name, value, bound, passed in checks
    }


def read_checks(values: Mapping[str, str]) -> Checks:
    """The inverse of :func:`check_values`, among other values.

    Raises:
        MalformedMessage: a check cannot be read.
    """
    checks = []
    for key, text in values.items():
        if not key.startswith(_CHECK):
            continue
        try:
            value, bound, passed = text.split()
            least_or_most = None if bound == _NO_BOUND else float(bound)
            checks.append(Check(key.removeprefix(_CHECK), float(value), least_or_most, _flag(passed)))
        except ValueError:
            raise MalformedMessage(f'{key} is no check: {text[:40]!r}') from None
    return tuple(checks)


def _flag(text: str) -> bool:
    if text not in ('0', '1'):
        raise ValueError(f'{text[:40]!r} is neither 0 nor 1')
    return text == '1'


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f'{text[:40]!r} is not finite')
    return value


_READERS: dict[Any, Any] = {bool: _flag, int: int, float: _number, str: str}
