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

"""``python -m tools.release``: every check before a release, and what a person does after them.

``make release`` runs all of them, an hour and a half on two cores; ``--list`` names them, ``--only`` and
``--skip`` choose among them.
Nothing is published, tagged or signed: the last lines say how.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import IO, Any

import yaml

from benchmarks.scorecard.outcome import ERROR, WRONG_MODEL
from benchmarks.scorecard.releases import RELEASES, read_releases
from tools import dist
from tools.dist import ROOT

OUT = ROOT / 'out' / 'release'
STRANGER = OUT / 'stranger'  # an environment with the wheel, and an empty folder
HOME = STRANGER / 'home'  # of the stranger, empty
DIST = ROOT / 'dist'
MOST_LINES = 200  # of the change log: it is read by people
STRANGER_S = 180.0  # from `pip install` to the end of the demo
PLACEHOLDER = 'example.org'  # reserved by RFC 2606: mail to it reaches nobody
Log = IO[str]


class NotReady(Exception):
    """A check failed; the message is one line."""


class Skipped(Exception):
    """A check cannot be made here; the message says what is missing."""


def versions(root: Path = ROOT) -> dict[str, str]:
    """The version that each file states; ``__version__`` is the one that the others repeat."""
    code = (root / 'debris_scanner' / '__init__.py').read_text()
    return {
        'debris_scanner/__init__.py': next(iter(re.findall(r"^__version__ = '(.+)'$", code, re.M)), ''),
        'package.xml': ET.parse(root / 'package.xml').findtext('version', ''),
        'CITATION.cff': str(yaml.safe_load((root / 'CITATION.cff').read_text())['version']),
    }


def changes(text: str, version: str) -> str:
    """The section of a version in a change log, in the form of Keep a Changelog, with nothing left above it.

    Raises:
        NotReady: the form is another one, or there is something unreleased.
    """
    parts = re.split(r'^## ', text, flags=re.M)[1:]
    heads = [part.partition('\n')[0] for part in parts]
    if heads[:1] != ['[Unreleased]'] or len(heads) < 2:
        raise NotReady('CHANGELOG.md: its first sections must be [Unreleased] and the version')
    if parts[0].partition('\n')[2].strip():
        raise NotReady('CHANGELOG.md: something is still [Unreleased]')
    named = re.fullmatch(r'\[(.+)\] - (\d{4}-\d\d-\d\d)', heads[1])
    if named is None or named[1] != version:
        raise NotReady(f'CHANGELOG.md: the newest section is {heads[1]!r}, not [{version}] - DATE')
    try:
        date.fromisoformat(named[2])
    except ValueError:
        raise NotReady(f'CHANGELOG.md: {named[2]} is no date') from None
    groups = re.findall(r'^### (.+)$', parts[1], re.M)
    if not groups or set(groups) - {'Added', 'Changed', 'Deprecated', 'Removed', 'Fixed', 'Security'}:
        raise NotReady(f'CHANGELOG.md: groups {", ".join(groups)} are not those of Keep a Changelog')
    if (count := len(text.splitlines())) > MOST_LINES:
        raise NotReady(f'CHANGELOG.md has {count} lines, more than {MOST_LINES}')
    return parts[1]


def run(log: Log, *command: str | Path, cwd: Path = ROOT, home: Path | None = None) -> None:
    """Run a command into the log; with a home, as someone who has nothing but that and a search path.

    Raises:
        NotReady: it failed.
    """
    shown = ' '.join(map(str, command))
    print(f'$ {shown}', file=log, flush=True)
    env = None
    if home is not None:
        # where this machine's packages lie
        index = {n: v for n, v in os.environ.items() if n.startswith('PIP_')}
        env = {'HOME': str(home), 'PATH': os.environ['PATH'], 'LANG': 'C.UTF-8', **index}
    done = subprocess.run(
        command, cwd=cwd, env=env, stdout=log, stderr=log, stdin=subprocess.DEVNULL, check=False
    )
    if done.returncode:
        raise NotReady(f'exit code {done.returncode}: {shown}')


def tree(log: Log) -> None:
    """The working tree is what is committed, and the version's tag is free."""
    run(log, 'git', 'diff', '--quiet', 'HEAD')
    for question in (['git', 'ls-files', '--others', '--exclude-standard'], ['git', 'tag', '-l', tag()]):
        if left := subprocess.run(question, cwd=ROOT, capture_output=True, text=True, check=True).stdout:
            raise NotReady(f'{" ".join(question)}: {" ".join(left.split())}')


def version(log: Log) -> None:
    """All files state one version, and the change log has a section for it."""
    found = versions()
    print(found, file=log)
    if len(set(found.values())) != 1:
        raise NotReady(', '.join(f'{name} {number}' for name, number in found.items()))
    print(changes((ROOT / 'CHANGELOG.md').read_text(), found['package.xml']), file=log)


def licences(log: Log) -> None:
    """docs/licences.md is what the pins and what is installed make of it; the SBOM lies in dist."""
    run(log, sys.executable, '-m', 'tools.licences', '--check', '--sbom', DIST / 'sbom.cdx.json')


def lint(log: Log) -> None:
    """Linters and types."""
    run(log, 'make', 'lint')


def docs(log: Log) -> None:
    """The pages of docs and API, without a warning."""
    run(log, 'make', 'api')


def build(log: Log) -> None:
    """Sdist and wheel, twice the same bytes."""
    with tempfile.TemporaryDirectory() as again:
        for out in (DIST, Path(again)):
            run(log, sys.executable, '-m', 'tools.dist', '--out', out)
        if (DIST / dist.SUMS).read_text() != Path(again, dist.SUMS).read_text():
            raise NotReady('a second build made other bytes')


def stranger(log: Log) -> None:
    """The wheel in an empty environment, in an empty folder: one pip install, doctor, demo."""
    wheels = sorted(DIST.glob('*.whl'))
    if len(wheels) != 1:
        raise NotReady('dist holds no wheel: run the check "dist" first')
    shutil.rmtree(STRANGER, ignore_errors=True)
    start, place, bare = time.monotonic(), STRANGER / 'empty', STRANGER / 'venv' / 'bin'
    place.mkdir(parents=True)
    HOME.mkdir()  # no kernel was compiled, and nothing downloaded
    run(log, sys.executable, '-m', 'venv', bare.parent)
    steps: tuple[tuple[str, list[str | Path]], ...] = (
        ('pip install', [bare / 'pip', 'install', '-c', ROOT / 'constraints.txt', f'{wheels[0]}[ros]']),
        ('demo', [bare / 'debris-scan', 'demo', '--no-view', '--out', 'out']),
        ('doctor', [bare / 'debris-scan', 'doctor']),
    )
    for what, command in steps:
        since = time.monotonic()
        run(log, *command, cwd=place, home=HOME)
        print(f'{what}: {time.monotonic() - since:.0f} s', file=log)
        if what == 'demo':
            took = time.monotonic() - start
    verdict = json.loads((place / 'out' / 'metrics.json').read_text())['verdict']
    if verdict != 'right' or not (place / 'out' / 'model.png').is_file():
        raise NotReady(f'the demo made no right model: {verdict}')
    if took > STRANGER_S:
        raise NotReady(f'pip install and demo took {took:.0f} s, more than {STRANGER_S:.0f}')


def commands(log: Log) -> None:
    """Each command of README and tutorial, in that environment."""
    bare = STRANGER / 'venv' / 'bin'
    if not bare.is_dir():
        raise NotReady('no environment of a stranger: run the check "stranger" first')
    run(
        log,
        bare / 'pip',
        'install',
        '-c',
        ROOT / 'constraints.txt',
        f'{next(DIST.glob("*.whl"))}[ros,view,batch,drivers]',
    )
    run(log, sys.executable, '-m', 'tools.commands', bare)


def debian(log: Log) -> None:
    """The Debian package, unpacked into a root of its own, where its files are found."""
    run(log, sys.executable, '-m', 'tools.debian', '--out', DIST, '--check')


def tests(log: Log) -> None:
    """All tests, as CI runs them."""
    run(log, 'make', 'test')


def faults(log: Log) -> None:
    """Killed nodes, full disks, silent sensors."""
    run(log, 'make', 'faults')


def fuzz(log: Log) -> None:
    """Damaged messages and bags, degenerate scans."""
    for of, cases in (('messages', 100_000), ('scans', 2_000)):
        run(log, sys.executable, 'test/fuzz/run_fuzz.py', '--of', of, '--cases', str(cases), '--jobs', '2')


def scorecard(log: Log) -> None:
    """The quick scorecard, kept in docs/releases: nothing broke, no more wrong models than before."""
    options = ('--quick', '--fresh', '--release', tag()[1:], '--out', OUT / 'scorecard')
    run(log, sys.executable, '-m', 'benchmarks.scorecard', *options)
    no_worse(read_releases(ROOT / RELEASES), tag()[1:])


def no_worse(releases: Sequence[Mapping[str, Any]], version: str) -> None:
    """Compare a version's scorecard with that of the version before, by the cases that both have.

    Args:
        releases: in the order of their versions.
        version: one of them.

    Raises:
        NotReady: a case broke, or more models are wrong.
    """
    at = [release['version'] for release in releases].index(version)
    new, old = (releases[k]['cases'] for k in (at, max(0, at - 1)))
    if broken := [name for name, case in new.items() if case['outcome'] == ERROR]:
        raise NotReady(f'the scorecard broke at {", ".join(broken)}')
    now, before = (
        sum(cases[name]['outcome'] == WRONG_MODEL for name in new.keys() & old.keys()) for cases in (new, old)
    )
    if now > before:
        raise NotReady(
            f'{now} wrong models in the scorecard, {before} in that of {releases[at - 1]["version"]}'
        )


def audit(log: Log) -> None:
    """Known weaknesses of what is pinned, if pip-audit is installed beside this interpreter."""
    program = Path(sys.prefix, 'bin', 'pip-audit')
    if not program.is_file():
        raise Skipped(f'no pip-audit: {sys.prefix}/bin/pip install pip-audit')
    command = [str(program), '--no-deps', '--disable-pip', '-r', 'constraints.txt']
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    print(done.stdout, done.stderr, file=log)
    if done.returncode:
        raise NotReady('something that is pinned has a known weakness, or pip-audit failed')
    if 'could not be audited' in done.stdout:
        raise Skipped('this index does not tell weaknesses of all that is pinned')


CHECKS: dict[str, Callable[[Log], None]] = {
    'tree': tree,
    'version': version,
    'licences': licences,
    'lint': lint,
    'docs': docs,
    'dist': build,
    'stranger': stranger,
    'commands': commands,
    'debian': debian,
    'audit': audit,
    'tests': tests,
    'faults': faults,
    'fuzz': fuzz,
    'scorecard': scorecard,
}


def tag() -> str:
    """The version's tag."""
    return f'v{versions()["debris_scanner/__init__.py"]}'


def check(names: Sequence[str]) -> bool:
    """Make the checks one after another, a line each; whether none failed."""
    OUT.mkdir(parents=True, exist_ok=True)
    failed = False
    for name in names:
        path, start = OUT / f'{name}.log', time.monotonic()
        status, remark = 'ok', ''
        print(f'{name:10}', end='', flush=True)
        with path.open('w') as log:
            try:
                CHECKS[name](log)
            except Skipped as why:
                status, remark = 'skip', str(why)
            except NotReady as why:
                status, remark, failed = 'FAIL', f'{why} ({path.relative_to(ROOT)})', True
        print(f'{status:5}{time.monotonic() - start:7.0f} s  {remark}', flush=True)
    return not failed


def last_steps() -> str:
    """What a person does, and no program."""
    address = ET.parse(ROOT / 'package.xml').find('maintainer')
    assert address is not None
    notes = ''
    if PLACEHOLDER in address.get('email', ''):
        notes = 'The maintainer in package.xml has a placeholder for an address: put in a real one first.\n'
    return f"""\
{notes}Nothing is published. What is left is a person's:
  git add docs/releases && git commit     # what the scorecard said of this version
  git tag -s {tag()} -m 'debris_scanner {tag()[1:]}'
  cd dist && gpg --armor --detach-sign {dist.SUMS}    # whoever downloads: gpg --verify, sha256sum -c
  git push origin {tag()}, and upload what is in dist/
"""


def main() -> int:
    """Make the checks that are asked for."""
    parser = argparse.ArgumentParser(prog='python -m tools.release', description=__doc__)
    parser.add_argument('--list', action='store_true', help='name the checks, and end')
    parser.add_argument('--only', metavar='LIST', help='these checks alone, as tree,version')
    parser.add_argument('--skip', metavar='LIST', default='', help='all but these')
    args = parser.parse_args()
    if args.list:
        for name, action in CHECKS.items():
            print(f'{name:10}{(action.__doc__ or "").splitlines()[0]}')
        return 0
    chosen = args.only.split(',') if args.only else list(CHECKS)
    skipped = args.skip.split(',') if args.skip else []
    if unknown := {*chosen, *skipped} - set(CHECKS):
        parser.error(f'no check {", ".join(sorted(unknown))}: they are {", ".join(CHECKS)}')
    ready = check([name for name in CHECKS if name in chosen and name not in skipped])
    if not ready:
        print('Not ready.')
        return 1
    if DIST.is_dir():  # of the Debian package and the bill of materials, too
        dist.write_sums(DIST, [p for p in DIST.iterdir() if not p.name.startswith(dist.SUMS)])
    print(last_steps(), end='')
    return 0


if __name__ == '__main__':
    sys.exit(main())
