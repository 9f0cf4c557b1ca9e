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

"""CHANGELOG.rst, as catkin's release tools read it, from CHANGELOG.md: ``make changelog``.

CHANGELOG.md is what is written by hand. Its unreleased changes come under *Forthcoming*.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TITLE = 'Changelog for package debris_scanner'
_RELEASE = re.compile(r'## (\d+\.\d+\.\d+) \((\d{4}-\d{2}-\d{2})\)')


def converted(markdown: str) -> str:
    """The changelog in reStructuredText."""
    lines = ['^' * len(TITLE), TITLE, '^' * len(TITLE)]
    for line in markdown.splitlines():
        if line.startswith('## '):
            release = _RELEASE.fullmatch(line)
            heading = f'{release[1]} ({release[2]})' if release else 'Forthcoming'
            lines += ['', heading, '-' * len(heading)]
        elif line.startswith(('- ', '  - ')):
            indent, text = line.split('- ', 1)
            lines.append(f'{indent}* {_inline(text)}')
    return '\n'.join(lines) + '\n'


def _inline(text: str) -> str:
    """Code, bold type and links of Markdown as those of reStructuredText."""
    out: list[str] = []
    for k, part in enumerate(re.split(r'`([^`]*)`', text)):
        if k % 2:
            out.append(f'``{part}``')
            continue
        plain = re.sub(r'\[([^\]]*)\]\((https?:[^)]*)\)', r'`\1 <\2>`__', part.replace('**', ''))
        plain = re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', plain)
        # code must be set off from the words around it
        plain = re.sub(r'^(?=\w)', r'\\ ', plain) if k else plain
        out.append(plain.replace('*', '\\*').replace('|', '\\|'))
    return ''.join(out)


if __name__ == '__main__':
    sys.stdout.write(converted((ROOT / 'CHANGELOG.md').read_text()))
