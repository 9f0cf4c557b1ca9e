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

"""docs/thesis.md names every part of the thesis, and nothing that is not there."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[3] / 'docs'
TEXT = (DOCS / 'thesis.md').read_text(encoding='utf-8')
ROWS = {m[1]: m[0] for m in re.finditer(r'^\| (T\d+) \|.*$', TEXT, re.MULTILINE)}


def links(text):
    return [m for m in re.findall(r'\]\(([^)]+)\)', text) if '://' not in m]


def test_every_part_has_a_row():
    assert list(ROWS) == [f'T{k}' for k in range(1, 31)]


@pytest.mark.parametrize('part', ROWS)
def test_a_row_links_code_and_a_test_of_it(part):
    _, _, _, code, tests, _ = ROWS[part].split('|')
    assert links(code)
    assert all('/debris_scanner/' in m or '/msg_adapters/' in m for m in links(code))
    assert links(tests)
    for test in links(tests):
        assert 'def test_' in (DOCS / test).read_text(encoding='utf-8'), test


def test_all_links_lead_somewhere():
    assert len(links(TEXT)) > 60
    missing = [m for m in links(TEXT) if not (DOCS / m.split('#')[0]).exists()]
    assert missing == []


def test_all_nine_errata_are_answered():
    corrected = TEXT.split('## What was corrected')[1].split('\n## ')[0]
    assert re.findall(r'^\| (\d) \|', corrected, re.MULTILINE) == list('123456789')
