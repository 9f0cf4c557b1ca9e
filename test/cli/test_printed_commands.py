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

"""Every command that the README, the tutorial and other pages print is one that the program takes."""

import re
import shlex
from pathlib import Path

import pytest

from debris_scanner.cli import main as cli
from debris_scanner.io.outcome import REASONS

ROOT = Path(__file__).resolve().parents[2]
PAGES = ('README.md', *(f'docs/{p.name}' for p in sorted((ROOT / 'docs').glob('*.md'))))


def commands(page):
    """Each ``debris-scan ...`` of an indented line, without its comment."""
    for line in re.findall(
        r'^ {4}(?:\.venv/bin/)?(debris-scan .*)$', (ROOT / page).read_text(), re.MULTILINE
    ):
        for part in re.split(r' && | \|\| |; ', line.split(' # ')[0].removesuffix(' \\')):
            words = shlex.split(part.split('   ')[0], comments=True)
            if words[:1] == ['debris-scan']:
                yield words[1:]


FOUND = [(page, words) for page in PAGES for words in commands(page)]


def test_pages_print_commands():
    verbs = {words[0] for _, words in FOUND}
    assert {'live', 'scan', 'simulate', 'evaluate', 'import', 'merge', 'batch', 'report', 'demo'} <= verbs


@pytest.mark.parametrize(('page', 'words'), FOUND, ids=lambda value: ' '.join(value) if value else '')
def test_a_printed_command_is_taken(page, words):
    """Parsed: `make release` runs those of README and tutorial, and test/test_examples.py the programs."""
    if '...' in words or words[1:2] == ['VERB']:
        pytest.skip('stands for others')
    parsed = cli._parser(words[0]).parse_args(words)
    assert parsed.verb == words[0]


def test_each_reason_for_no_model_has_its_row():
    rows = re.findall(r'^\| `(\w+)`', (ROOT / 'docs' / 'no_model.md').read_text(), re.MULTILINE)
    assert rows[1:] == list(REASONS)  # below the title
