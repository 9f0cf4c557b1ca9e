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

"""``python -m tools.dist``: sdist, wheel and their checksums in dist/, byte for byte the same for a commit.

They are made of the files that git knows, each dated as SOURCE_DATE_EPOCH says (the last commit), and the
wheel is built from the sdist, as a stranger would. Needs git and setuptools, and no network.
"""

import argparse
import gzip
import hashlib
import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EPOCH = 'SOURCE_DATE_EPOCH'
SUMS = 'SHA256SUMS'
_BUILD = 'import sys; from setuptools import build_meta; print(getattr(build_meta, sys.argv[1])(sys.argv[2]))'


def build(out: Path, root: Path = ROOT) -> tuple[Path, Path]:
    """Build into a folder; returns sdist and wheel.

    Raises:
        subprocess.CalledProcessError: git or setuptools failed; what it said is on stderr.
    """
    date = epoch(root)
    out.mkdir(parents=True, exist_ok=True)
    for path in (*out.glob('*.tar.gz'), *out.glob('*.whl')):
        path.unlink()  # of another version
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder, 'sources')
        for name in _git(root, 'ls-files', '-z').split('\0'):
            if (root / name).is_file():
                _copy(root / name, sources / name)
        made = _setuptools('build_sdist', sources, Path(folder), date)
        sdist = out / made.name
        sdist.write_bytes(_dated(made, date))
        with tarfile.open(sdist) as archive:
            # Python 3.11.3 and before has no filter
            archive.extraction_filter = getattr(tarfile, 'data_filter', lambda member, _: member)
            archive.extractall(folder)
        unpacked = Path(folder, made.name.removesuffix('.tar.gz'))
        wheel = out / _setuptools('build_wheel', unpacked, out.resolve(), date).name
    write_sums(out, (sdist, wheel))
    return sdist, wheel


def write_sums(out: Path, paths: Iterable[Path]) -> None:
    """Write the checksums of some of a folder's files, as ``sha256sum -c`` reads them."""
    lines = [f'{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n' for path in sorted(paths)]
    (out / SUMS).write_text(''.join(lines))


def epoch(root: Path = ROOT) -> int:
    """The date that all files of a release bear, seconds since 1970."""
    return int(os.environ.get(EPOCH) or _git(root, 'log', '-1', '--format=%ct'))


def _copy(source: Path, target: Path) -> None:
    """Copy a file, with the permissions that git keeps of it: the reader's umask is none of the release's."""
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    target.chmod(0o755 if os.access(source, os.X_OK) else 0o644)


def _setuptools(hook: str, folder: Path, out: Path, date: int) -> Path:
    """Call setuptools as pip does; returns what it made."""
    done = subprocess.run(
        [sys.executable, '-c', _BUILD, hook, str(out)],
        cwd=folder,
        env=os.environ | {EPOCH: str(date)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        umask=0o022,
    )
    return out / done.stdout.split()[-1]


def _dated(sdist: Path, date: int) -> bytes:
    """The same archive, in order of names, of one date and of no owner."""
    content = io.BytesIO()
    with (
        tarfile.open(sdist) as old,
        gzip.GzipFile('', 'wb', fileobj=content, mtime=date) as packed,
        tarfile.open(fileobj=packed, mode='w', format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda m: m.name):
            member.mtime, member.pax_headers = date, {}
            member.uid = member.gid = 0
            member.uname = member.gname = ''
            new.addfile(member, old.extractfile(member) if member.isfile() else None)
    return content.getvalue()


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(['git', *arguments], cwd=root, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout


def main() -> int:
    """Build, and print what was made."""
    parser = argparse.ArgumentParser(prog='python -m tools.dist', description=__doc__)
    parser.add_argument('--out', type=Path, default=ROOT / 'dist', metavar='DIR', help='folder (dist)')
    out = parser.parse_args().out
    build(out)
    print((out / SUMS).read_text(), end='')
    return 0


if __name__ == '__main__':
    sys.exit(main())
