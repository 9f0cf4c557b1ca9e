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

"""``python -m tools.licences``: what is pinned, under which licences, as docs/licences.md and as an SBOM.

It asks the metadata of what is installed, so everything has to be (``make setup``); pins of another platform
or of an option keep the line that the page has.
"""

import argparse
import json
import re
import sys
import textwrap
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

from debris_scanner import __version__
from tools.dist import ROOT

PAGE = ROOT / 'docs' / 'licences.md'
UNKNOWN, ABSENT = 'not stated', 'not installed where this was made'
_WIDTH = 110
_MOST = 40  # characters: what is longer is the licence's text, not its name
# One name for one licence, where classifiers and free text have others.
_SHORT = {
    'MIT License': 'MIT',
    'BSD License': 'BSD',
    'Apache Software License': 'Apache-2.0',
    'Apache License, Version 2.0': 'Apache-2.0',
    'Apache License 2.0': 'Apache-2.0',
    'Apache 2.0': 'Apache-2.0',
    'Mozilla Public License 2.0 (MPL 2.0)': 'MPL-2.0',
    'ISC License (ISCL)': 'ISC',
    'Python Software Foundation License': 'PSF-2.0',
}
_HEAD = """\
# Licences

debris_scanner is under [Apache-2.0](../LICENSE). What `constraints.txt` pins, by the licence that each
package's own metadata states; made by `python -m tools.licences`. The wheel contains none of it: pip installs
it beside. `python -m tools.licences --sbom FILE` writes the same with versions as CycloneDX 1.5.
"""


def pins(text: str) -> dict[str, str]:
    """Name and version of each line of a constraints file."""
    return dict(line.split('==') for line in text.splitlines() if line and not line.startswith('#'))


def licence_of(name: str) -> str | None:
    """The licence that an installed distribution states; None if it is not installed."""
    try:
        told = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return None
    if expression := told.get_all('License-Expression'):
        return ', '.join(expression)
    classes = [c.split(' :: ')[-1] for c in told.get_all('Classifier') or [] if c.startswith('License ::')]
    if classes := [_SHORT.get(c, c) for c in classes if c != 'OSI Approved']:
        return ', '.join(classes)
    stated = ' '.join(' '.join(told.get_all('License') or []).split())
    return _SHORT.get(stated, stated) if 0 < len(stated) <= _MOST else _from_files(name)


def _from_files(name: str) -> str:
    """The licence that a ROS package's manifest states, or whose title stands in a licence file."""
    package = re.sub('^ros-(jazzy-)?', '', name).replace('-', '_')
    manifest = Path(sys.prefix, 'share', package, 'package.xml')
    if manifest.is_file():
        stated = [e.text or UNKNOWN for e in ET.parse(manifest).iterfind('license')]
        return ', '.join(_SHORT.get(licence, licence) for licence in stated)
    titles = {
        'MIT': r'\bMIT License|Permission is hereby granted, free of charge',
        'Apache-2.0': r'Apache (Software )?License',
        'BSD': r'\bBSD\b|Redistribution and use',
    }
    for path in metadata.files(name) or []:
        if re.match(r'licen[cs]e|copying', path.name, re.I):
            text = path.read_text(encoding='utf-8')
            return next((title for title, pattern in titles.items() if re.search(pattern, text)), UNKNOWN)
    return UNKNOWN


def rows(page: str) -> dict[str, str]:
    """The licence of each package that a page names."""
    lines = re.findall(r'^- \*\*(.+?)\*\*(?: \(\d+\))?: (.+(?:\n  .+)*)$', page, re.M)
    return {name: licence for licence, names in lines for name in re.split(r',\s+', names)}


def licences(pinned: Mapping[str, str], page: str) -> dict[str, str]:
    """The licence of each pin: what is installed says, else what the page says."""
    before = rows(page)
    told = {name: licence_of(name) for name in pinned}
    return {name: licence or before.get(name, ABSENT) for name, licence in told.items()}


def render(pinned: Mapping[str, str], found: Mapping[str, str]) -> str:
    """The page: a line for each licence, the most frequent first."""
    lines = [f'{len(pinned)} packages:\n']
    for licence, count in Counter(found[name] for name in pinned).most_common():
        names = ', '.join(name for name in pinned if found[name] == licence)
        many = f' ({count})' if count > 2 else ''
        line = f'- **{licence}**{many}: {names}'
        lines.append(textwrap.fill(line, _WIDTH, subsequent_indent='  ', break_on_hyphens=False))
    return '\n'.join([_HEAD, *lines, ''])


def bill(pinned: Mapping[str, str], found: Mapping[str, str]) -> str:
    """The software bill of materials: CycloneDX 1.5, JSON, without a date, so that it is reproducible."""
    components = [
        {
            'type': 'library',
            'name': name,
            'version': version,
            'purl': f'pkg:pypi/{name}@{version}',
            'licenses': [{'license': {'name': found[name]}}],
        }
        for name, version in pinned.items()
    ]
    subject = {'type': 'application', 'name': 'debris_scanner', 'version': __version__}
    whole = {'bomFormat': 'CycloneDX', 'specVersion': '1.5', 'version': 1, 'metadata': {'component': subject}}
    return json.dumps({**whole, 'components': components}, indent=1) + '\n'


def main() -> int:
    """Write the page or check it, and write the bill."""
    parser = argparse.ArgumentParser(prog='python -m tools.licences', description=__doc__)
    parser.add_argument('--check', action='store_true', help='write no page: compare it')
    parser.add_argument('--sbom', type=Path, metavar='FILE', help='write the bill of materials')
    args = parser.parse_args()
    pinned = pins((ROOT / 'constraints.txt').read_text())
    page = PAGE.read_text() if PAGE.exists() else ''
    found = licences(pinned, page)
    if args.sbom is not None:
        args.sbom.parent.mkdir(parents=True, exist_ok=True)
        args.sbom.write_text(bill(pinned, found))
    new = render(pinned, found)
    if not args.check:
        PAGE.write_text(new)
    elif new != page:
        print(f'{PAGE} is not what is pinned and installed: python -m tools.licences', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
