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

"""Where the compiled kernels are kept, and who compiles them.

Numba keeps them beside the sources. All processes of a machine share them, and one alone compiles.
"""

import fcntl
import hashlib
import os
import platform
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

VARIABLE = 'NUMBA_CACHE_DIR'
# Set for the nodes of a scan without colour, whose kernels take two fifths of the time to compile.
WITHOUT_COLOUR = 'DEBRIS_SCANNER_WITHOUT_COLOUR'
PACKAGE = Path(__file__).resolve().parent


def cache_folder() -> Path:
    """The folder where numba keeps what is compiled, or one of its folders; all processes share it."""
    given = os.environ.get(VARIABLE)
    folder = Path(given) if given else PACKAGE / '__pycache__'
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def choose_cache(package: Path = PACKAGE) -> None:
    """Tell numba where to write if the package's folder cannot be written; call it before numba is imported.

    That is the user's cache folder, or one for temporary files. A folder that the user has set stays.
    """
    if os.environ.get(VARIABLE) or _can_write(package):
        return
    user = Path(os.environ.get('XDG_CACHE_HOME') or Path('~/.cache').expanduser())
    own = user if _can_write(user) else Path(tempfile.gettempdir())
    os.environ[VARIABLE] = str(own / f'debris_scanner_{os.getuid()}')  # children inherit it


def prepare_process() -> None:
    """Choose threads and cache for a process that is ours; an executable calls it before it imports numpy.

    Our matrices are small: further threads of linear algebra only wait for each other, busily, and take a
    quarter of all time from what is live. A number that the user has set stays.
    """
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    choose_cache()


def compile_once(
    folder: Path, run: Callable[[], object], load: Callable[[], object] | None = None, part: str = ''
) -> None:
    """Run what compiles; the first of several processes alone, with a line on stderr.

    A file of the folder notes what is compiled; once it does, nobody waits for anybody.

    Args:
        folder: of the cache, which all processes share.
        run: compiles what is not in the cache, and loads it.
        load: loads what this process needs, where all is compiled; None: ``run`` does.
        part: name of what ``run`` compiles, if that is not all.
    """
    everything = folder / f'compiled_{_fingerprint()}'
    mark = everything.with_name(f'{everything.name}_{part}') if part else everything

    def compiled() -> bool:
        return mark.exists() or everything.exists()

    if compiled():
        (load or run)()
        return
    with _alone(folder):
        if not compiled():
            print('debris_scanner: compiling, once on this machine, a minute or two', file=sys.stderr)
            run()
            mark.touch()
            return
    (load or run)()


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Inside this context no other process compiles; the lock ends with the process, even if it is killed."""
    with (folder / 'compiling.lock').open('a') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _can_write(folder: Path) -> bool:
    """Whether files can be made in a folder, which may have to be made, too."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def _fingerprint() -> str:
    """Of all that numba compiles anew for: itself, Python, the processor, the kernels' sources."""
    from debris_scanner.core.optional import MissingLibrary

    try:
        import numba  # late: it takes a second, and the package imports this module first
    except ImportError:
        raise MissingLibrary.named('numba') from None

    digest = hashlib.blake2b(digest_size=8)
    versions = (numba.__version__, platform.python_version(), platform.machine(), _processor())
    digest.update('|'.join(versions).encode())
    for source in sorted(PACKAGE.rglob('*.py')):
        if any(word in source.read_bytes() for word in (b'njit', b'import kernel', b'import inlined')):
            stat = source.stat()
            digest.update(f'{source}|{stat.st_size}|{stat.st_mtime_ns}'.encode())
    return digest.hexdigest()


def _processor() -> str:
    """The name of the processor, for which the code is made; empty where it is unknown."""
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith('model name')), '')
