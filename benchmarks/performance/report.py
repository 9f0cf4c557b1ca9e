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

"""Rows as tables: for the terminal, for docs/performance.md, and as ratios to a row."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.performance.measure import Row

HEAD = ('what', 'who', 'median, ms', '99 %, ms', 'note')


def ratios(rows: Iterable[Row], ours: float) -> list[Row]:
    """The rows with their cost as a multiple of ours in the note."""
    return [
        Row(r.what, r.who, r.cost, '; '.join(filter(None, [_times(r.cost.median_ms / ours), r.note])))
        for r in rows
    ]


def _times(ratio: float) -> str:
    return f'{ratio:.2f} x ours' if ratio < 10 else f'{ratio:.0f} x ours'


def table(rows: Sequence[Row]) -> str:
    """A Markdown table that also reads well as plain text."""
    cells = [HEAD] + [(r.what, r.who, number(r.cost.median_ms), number(r.cost.p99_ms), r.note) for r in rows]
    widths = [max(len(line[k]) for line in cells) for k in range(len(HEAD))]
    lines = [
        '| ' + ' | '.join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + ' |' for line in cells
    ]
    return '\n'.join([lines[0], '|' + '|'.join('-' * (w + 2) for w in widths) + '|', *lines[1:]])


def number(ms: float) -> str:
    """Three digits, no exponent."""
    return f'{ms:.3g}' if ms < 100 else f'{ms:.0f}'


def write_section(document: Path, name: str, text: str) -> None:
    """Put text between ``<!-- name -->`` and ``<!-- end name -->`` of a document, in place of what was there.

    Raises:
        ValueError: the document has no such section.
    """
    begin, end = f'<!-- {name} -->', f'<!-- end {name} -->'
    pattern = re.compile(re.escape(begin) + '.*?' + re.escape(end), re.DOTALL)
    old = document.read_text()
    if not pattern.search(old):
        raise ValueError(f'{document} has no section {begin}')
    document.write_text(pattern.sub(lambda _: f'{begin}\n\n{text}\n\n{end}', old))
