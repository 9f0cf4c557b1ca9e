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

"""The whole bench: stages, peers, growth, live. Prints the tables; with --write they go into docs/."""

import argparse
import json
import os
import platform
import time
from dataclasses import asdict
from pathlib import Path

from benchmarks.performance import parts
from benchmarks.performance.report import write_section

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / 'docs' / 'performance.md'


def main() -> None:
    parser = argparse.ArgumentParser(prog='python -m benchmarks.performance', description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='fewer runs, one outer iteration of LUM, short scans'
    )
    parser.add_argument('--parts', default=','.join(parts.DEFAULT), help=f'of: {", ".join(parts.PARTS)}')
    parser.add_argument(
        '--out', type=Path, default=ROOT / 'out' / 'performance', help='recordings, builds, figures'
    )
    parser.add_argument('--write', action='store_true', help='put the tables and the plot into docs/')
    args = parser.parse_args()
    names = args.parts.split(',')
    if unknown := sorted(set(names) - set(parts.PARTS)):
        parser.error(f'no part {", ".join(unknown)}; there are {", ".join(parts.PARTS)}')
    args.out.mkdir(parents=True, exist_ok=True)
    bench = parts.Bench(args.out, args.quick, DOCUMENT.parent if args.write else args.out)
    for name in names:
        start, load = time.monotonic(), os.getloadavg()[0]
        text, figures = parts.PARTS[name](bench)
        head = f'{machine()}, load {load:.1f} before it, {"--quick, " if args.quick else ""}'
        text += f'\n\n{head}{time.monotonic() - start:.0f} s.'
        print(f'\n== {name} ==\n\n{text}', flush=True)
        (args.out / f'{name}.json').write_text(json.dumps([asdict(f) for f in figures], indent=1) + '\n')
        if args.write and f'<!-- {name} -->' in DOCUMENT.read_text():  # the page need not show every part
            write_section(DOCUMENT, name, text)


def machine() -> str:
    """What it ran on."""
    return f'{os.cpu_count()} cores {platform.machine()}, Python {platform.python_version()}'


if __name__ == '__main__':
    main()
