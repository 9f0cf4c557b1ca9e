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

"""``index.html``: every recording of a batch on one sortable page, with pictures and links to the reports."""

from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from debris_scanner.batch.recording import LOG, THUMBNAIL
from debris_scanner.io.result_files import REPORT, SUMMARY

FAILED = '_failed'  # folder of what has no result, with the logs
_MODELS = ('model', 'tracked')
# Scripts and styles of the page itself, and pictures beside it.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' file: data:"
)

# Title, column, digits; None for text.
_COLUMNS: tuple[tuple[str, str, int | None], ...] = (
    ('recording', 'name', None),
    ('result', 'result', None),
    ('reason', 'reason', None),
    ('frames used', 'frames_used', 0),
    ('of', 'frames_read', 0),
    ('key frames', 'keyframes', 0),
    ('closures', 'closures_accepted', 0),
    ('period, s', 'rotation_period_s', 2),
    ('points', 'model_points', 0),
    ('surface seen', 'observed_share', 3),
    ('time, s', 'total_s', 1),
    ('memory, MB', 'peak_rss_mb', 0),
    ('tries', 'attempts', 0),
)

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 1.5rem; }
h1 { font-size: 1.35rem; margin: 0 0 .3rem; }
input { font: inherit; padding: .3rem .6rem; width: 22rem; max-width: 100%; margin: .8rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #8884; text-align: right; white-space: nowrap; }
th.text, td.text { text-align: left; }
td.reason { white-space: normal; min-width: 14rem; }
th button { font: inherit; font-weight: 600; border: 0; background: none; color: inherit; padding: 0; }
th[aria-sort=ascending] button::after { content: " ↑"; }
th[aria-sort=descending] button::after { content: " ↓"; }
img { width: 80px; height: 80px; display: block; }
tr[data-result=failed] td.result, tr[data-result=bad_input] td.result { color: #c0392b; font-weight: 600; }
"""

_SCRIPT = """
const body = document.querySelector('tbody');
document.querySelectorAll('th button').forEach((button) => button.addEventListener('click', () => {
  const head = button.parentElement, column = head.cellIndex;
  const down = head.getAttribute('aria-sort') === 'ascending' ? -1 : 1;
  document.querySelectorAll('th').forEach((th) => th.removeAttribute('aria-sort'));
  head.setAttribute('aria-sort', down === 1 ? 'ascending' : 'descending');
  const value = (row) => row.cells[column].dataset.value;
  const number = head.dataset.kind === 'number';
  const compare = (a, b) => {
    const [x, y] = [value(a), value(b)];
    if (x === '' || y === '') return (x === '') - (y === '');  // what has no value stays below
    return down * (number ? x - y : x.localeCompare(y));
  };
  body.append(...[...body.rows].sort(compare));
}));
document.querySelector('input').addEventListener('input', (event) => {
  const wanted = event.target.value.toLowerCase();
  for (const row of body.rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
});
"""


def render(rows: Sequence[Mapping[str, Any]], title: str) -> str:
    """The page over all rows, in their order."""
    counts = Counter(str(row.get('result')) for row in rows)
    told = ', '.join(f'{n} {result.replace("_", " ")}' for result, n in sorted(counts.items()))
    heads = ''.join(
        f'<th class="{kind}" data-kind="{kind}"><button type="button">{name}</button></th>'
        for name, kind in ((name, 'text' if d is None else 'number') for name, _, d in _COLUMNS)
    )
    lines = '\n'.join(_line(row) for row in rows)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>Batch: {escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n'
        f'<h1>Batch: {escape(title)}</h1>\n<p>{len(rows)} recordings: {told}. '
        'Also as <a href="batch.csv">batch.csv</a> and <a href="batch.parquet">batch.parquet</a>.</p>\n'
        '<input type="search" placeholder="filter" aria-label="filter">\n<div class="scroll"><table>\n'
        f'<thead><tr><th></th>{heads}<th class="text">files</th></tr></thead>\n<tbody>\n{lines}\n</tbody>\n'
        f'</table></div>\n<script>{_SCRIPT}</script>\n</body>\n</html>\n'
    )


def _line(row: Mapping[str, Any]) -> str:
    result, folder = str(row.get('result')), quote(str(row['name']))
    picture = ''
    if result in _MODELS:
        picture = (
            f'<a href="{folder}/{REPORT}"><img src="{folder}/{THUMBNAIL}" loading="lazy" alt="model of '
            f'{escape(str(row["name"]))}"></a>'
        )
    cells = ''.join(_cell(row, key, digits) for _, key, digits in _COLUMNS)
    links = f'<td class="text">{_links(result, folder, scanned=row.get("frames_read") is not None)}</td>'
    return f'<tr data-result="{escape(result)}"><td>{picture}</td>{cells}{links}</tr>'


def _links(result: str, folder: str, scanned: bool) -> str:
    if result == 'pending':
        return ''
    if result == 'failed':
        return f'<a href="{FAILED}/{folder}/{LOG}">log</a>'
    names = [('report', REPORT), ('summary', SUMMARY)] if scanned else []
    return ' '.join(f'<a href="{folder}/{file}">{name}</a>' for name, file in [*names, ('log', LOG)])


def _cell(row: Mapping[str, Any], key: str, digits: int | None) -> str:
    value = row.get(key)
    if digits is None:
        text = '' if value is None else escape(str(value))
        return f'<td class="text {key}" data-value="{text}">{text}</td>'
    shown = '' if value is None else f'{value:.{digits}f}'
    return f'<td data-value="{"" if value is None else value}">{shown}</td>'
