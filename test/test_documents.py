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

"""Every link within the documents leads to a file, and to a heading that is there."""

import re
import subprocess

import pytest

from tools.dist import ROOT

LINK = re.compile(r'\]\(([^)\s]+)\)')


def pages():
    listed = subprocess.run(
        ['git', 'ls-files', '*.md'], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return listed.stdout.split() or [str(p.relative_to(ROOT)) for p in ROOT.glob('docs/**/*.md')]


def headings(page):
    """Anchors as a forge makes them of headings."""
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.S | re.M)
    plain = (re.sub(r'[`*]|\]\([^)]*\)', '', title) for title in re.findall(r'^#+ (.+)$', text, re.M))
    return {re.sub(r'[^\w\- ]', '', title.lower()).replace(' ', '-') for title in plain}


@pytest.mark.parametrize('name', pages())
def test_links_lead_somewhere(name):
    page = ROOT / name
    for target in LINK.findall(page.read_text()):
        if re.match(r'[a-z]+:', target):
            continue
        path, _, anchor = target.partition('#')
        there = page if not path else page.parent / path
        assert there.exists(), target
        assert not anchor or anchor in headings(there), target
