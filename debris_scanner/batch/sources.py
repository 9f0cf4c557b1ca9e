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

"""Which program a result is of: digest of sources and libraries, and a copy that later edits leave alone."""

import hashlib
import importlib.metadata
import platform
import shutil
import tempfile
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cache
from io import BytesIO
from pathlib import Path

from debris_scanner.io.result_files import LIBRARIES

ROOT = Path(__file__).resolve().parents[2]
_DIGITS = 12
# rooms that decide no result
NOT_DECISIVE = frozenset({'batch', 'cli', 'drivers', 'nodes', 'report', 'research', 'viewer'})


def digest(root: Path = ROOT, salt: str = '', packages: Collection[str] = ('debris_scanner',)) -> str:
    """Short digest of the sources that decide a result.

    Args:
        root: folder of the packages.
        salt: what decides it besides.
        packages: whose modules count.
    """
    total = hashlib.sha256(salt.encode())
    for package in sorted(packages):
        for path in sorted((root / package).rglob('*.py')):
            if path.relative_to(root / package).parts[0] not in NOT_DECISIVE:
                total.update(f'{path.relative_to(root)}\0'.encode())
                total.update(path.read_bytes())
    return total.hexdigest()[:_DIGITS]


@cache
def program() -> str:
    """Digest of the installed program with its libraries: the same one gives the same bytes."""
    versions = [platform.python_version()]
    for name in LIBRARIES:
        try:
            versions.append(f'{name} {importlib.metadata.version(name)}')
        except importlib.metadata.PackageNotFoundError:
            continue
    return digest(salt='\n'.join(versions), packages=('debris_scanner', 'msg_adapters'))


@contextmanager
def snapshot(packages: Collection[str], prefix: str) -> Iterator[Path]:
    """A copy of packages as they are now: a run of an hour must not see later edits.

    Yields:
        The copy's root, to be put first on the path.
    """
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as name:
        root = Path(name)
        for package in packages:
            # with compiled kernels and their times, so that nothing is compiled again
            shutil.copytree(ROOT / package, root / package)
        yield root


def archive(root: Path) -> bytes:
    """Zip of the sources under a root, the same bytes each time."""
    packed = BytesIO()
    with zipfile.ZipFile(packed, 'w', zipfile.ZIP_DEFLATED) as file:
        for path in sorted(root.rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                file.writestr(zipfile.ZipInfo(path.relative_to(root).as_posix()), path.read_bytes())
    return packed.getvalue()
