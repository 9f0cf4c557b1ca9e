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

"""Files in order, by the numbers in their names or by the times that these are; and which go together."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from debris_scanner.io.recordings.recording import RecordingError

_TIME = re.compile(r'\D*(\d+\.\d+)')  # seconds with a fraction, and nothing behind them
# Digits of a count since 1970 of milliseconds, microseconds, nanoseconds: nanoseconds of each.
_EPOCHS = {13: 10**6, 16: 10**3, 19: 1}


@dataclass(frozen=True)
class Files:
    """Files in order; ``keys`` are their numbers, or their stamps in nanoseconds where ``timed``."""

    paths: list[Path]
    keys: list[int]
    timed: bool

    def __len__(self) -> int:
        return len(self.paths)


def ordered(folder: Path, *endings: str, only: Collection[Path] | None = None) -> Files:
    """Files of a folder by the last number of their names, or by the times that all names are.

    Args:
        folder: where they are.
        endings: of their names.
        only: of these; None: of all.

    Raises:
        RecordingError: a name has no number, or two have the same; or times and numbers are mixed.
    """
    found = sorted(
        p
        for p in folder.iterdir()
        if p.suffix.lower() in endings and not p.name.startswith('.') and (only is None or p in only)
    )
    times = [_time(p.stem) for p in found]
    timed = bool(found) and all(t is not None for t in times)
    if any(t is not None and '.' in p.stem for p, t in zip(found, times, strict=True)) and not timed:
        odd = next(p for p, t in zip(found, times, strict=True) if t is None)
        raise RecordingError(f'{odd} is no time, as the names of other files beside it are')
    keys: dict[int, Path] = {}
    for path, time_ns in zip(found, times, strict=True):
        numbers = re.findall(r'\d+', path.stem)
        if not numbers:
            raise RecordingError(f'{path} has no number in its name to order it by')
        key = time_ns if timed and time_ns is not None else int(numbers[-1])
        other = keys.setdefault(key, path)
        if other is not path:
            raise RecordingError(f'{path} and {other.name} have the same number')
    keys = dict(sorted(keys.items()))
    return Files(list(keys.values()), list(keys), timed)


def paired(files: Files, others: Files, what: str, where: Path) -> list[Path | None]:
    """The other file of each: of the same number, or the nearest in time within half a frame.

    Raises:
        RecordingError: a number has no partner, or one side has times and the other numbers.
    """
    if not len(others):
        return []
    if files.timed != others.timed:
        raise RecordingError(f'{where}: names of times and of numbers cannot be paired')
    if files.timed:
        return [others.paths[k] if k is not None else None for k in nearest(files.keys, others.keys)]
    by_number = dict(zip(others.keys, others.paths, strict=True))
    if missing := [p.name for p, k in zip(files.paths, files.keys, strict=True) if k not in by_number]:
        raise RecordingError(
            f'{where} has no {what} for {missing[0]} ({len(missing)} of {len(files)} missing)'
        )
    return [by_number[k] for k in files.keys]


def nearest(stamps_ns: Sequence[int], others_ns: Sequence[int]) -> list[int | None]:
    """Index of the nearest other stamp for each, None where none lies within half the median period."""
    if len(stamps_ns) < 2 or not len(others_ns):
        return [0 if len(others_ns) else None for _ in stamps_ns]
    within = float(np.median(np.diff(stamps_ns))) / 2
    chosen: list[int | None] = []
    after = np.searchsorted(others_ns, stamps_ns)
    for stamp, k in zip(stamps_ns, after, strict=True):
        near = [i for i in (int(k) - 1, int(k)) if 0 <= i < len(others_ns)]
        best = min(near, key=lambda i: abs(others_ns[i] - stamp))
        chosen.append(best if abs(others_ns[best] - stamp) <= within else None)
    return chosen


def _time(stem: str) -> int | None:
    """Nanoseconds of a name that is a time: seconds with a fraction, or a long count since 1970."""
    if found := _TIME.fullmatch(stem):
        return int(Decimal(found[1]) * 10**9)
    digits = re.fullmatch(r'\D*(\d+)', stem)
    factor = _EPOCHS.get(len(digits[1])) if digits else None
    return int(digits[1]) * factor if digits and factor else None
