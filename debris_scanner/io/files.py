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

"""Writing a file, or all files of a result, so that the old is whole or the new, whatever happens meanwhile.

Files that belong together are written into a folder aside. One rename of that folder says that they are
complete; then they are put in place. A process that is killed before that rename has changed nothing. After
it, whoever opens the folder next puts the rest in place, for which no space is needed.
"""

import contextlib
import errno
import fcntl
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

SAVING, SAVED = '.saving', '.saved'  # folder of new files: still being written; complete, not all in place
_GONE = '.gone'  # in it: names of the old files that have no successor
CLAIM = 'DEBRIS_SCANNER_CLAIM'  # variable with a file descriptor, inherited, that has the lock of its folder

_held: dict[tuple[int, int], int] = {}  # device and inode of each folder that this process claims: descriptor


class FolderInUse(Exception):
    """Another process claims the folder."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` under a temporary name in the same folder, flush it to disk, then rename it.

    Raises:
        OSError: if the file cannot be written; an earlier file of that name is then still in place.
    """
    temporary = path.with_name(f'.{path.name}.{os.getpid()}.part')
    try:
        with temporary.open('wb') as file:
            file.write(content)
            file.flush()
            # Without this a power cut after the rename could leave an empty file under the final name.
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def written_together(folder: Path, names: Sequence[str]) -> Iterator[Path]:
    """A folder to write files into, which then replace all files of these names; the caller has a claim.

    Where the first name exists, all others belong to it: it is the first to go and the last to come.

    Raises:
        OSError: in the block or after it. The old files are then in place, unless :data:`SAVED` exists.
    """
    put_in_place(folder, names[0])
    part = folder / SAVING
    try:
        part.mkdir()
        yield part
        new = {path.name for path in part.iterdir()}
        for name in new:
            if (folder / name).is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(folder / name))
        write_atomically(part / _GONE, '\n'.join(n for n in names if n not in new).encode())
        _sync(part)
        part.rename(folder / SAVED)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    put_in_place(folder, names[0])


def put_in_place(folder: Path, first: str) -> None:
    """Put complete files in place, and remove incomplete ones; the caller has a claim.

    Args:
        folder: as in :func:`written_together`.
        first: the first of the names there.

    Raises:
        OSError: a file cannot be moved or removed; the next call goes on.
    """
    shutil.rmtree(folder / SAVING, ignore_errors=True)
    saved = folder / SAVED
    if not saved.is_dir():
        return
    if (saved / first).exists():
        _sync(folder)
        (folder / first).unlink(missing_ok=True)
        for name in (saved / _GONE).read_text().split('\n'):
            if name:
                (folder / name).unlink(missing_ok=True)
        for path in sorted(saved.iterdir()):
            if path.name not in (first, _GONE):
                path.replace(folder / path.name)
        (saved / first).replace(folder / first)
        _sync(folder)
    shutil.rmtree(saved)


def _sync(folder: Path) -> None:
    """Have renames in a folder on disk before those that come."""
    with _opened(folder) as descriptor:
        os.fsync(descriptor)


@contextlib.contextmanager
def claimed(folder: Path) -> Iterator[int]:
    """Have a folder for this process alone; yields the descriptor with the lock, for children to inherit.

    The lock ends with the last process that has the descriptor, however it ends. It is the folder's own, so
    it leaves no file and may be had where nothing can be written. Within the process claims nest.

    Raises:
        FolderInUse: another process has it.
        OSError: there is no such folder.
    """
    with _opened(folder) as descriptor:
        key = _identity(descriptor)
        if (held := _held.get(key, _inherited(key))) is not None:
            yield held
            return
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderInUse(f'another scan{_owner(key[1])} writes to {folder}') from None
        except OSError:
            pass  # a network's file system without locks: nothing can be told there
        _held[key] = descriptor
        try:
            yield descriptor
        finally:
            del _held[key]


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int]:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _identity(descriptor: int) -> tuple[int, int]:
    status = os.fstat(descriptor)
    return status.st_dev, status.st_ino


def _inherited(key: tuple[int, int]) -> int | None:
    try:
        descriptor = int(os.environ[CLAIM])
        return descriptor if _identity(descriptor) == key else None
    except (KeyError, ValueError, OSError):
        return None


def _owner(inode: int) -> str:
    """Who has the lock of a folder, as far as the system tells."""
    with contextlib.suppress(OSError):
        for line in Path('/proc/locks').read_text().splitlines():
            words = line.split()
            if words[1] == 'FLOCK' and words[5].endswith(f':{inode}') and words[4] != '0':
                return f' (process {words[4]})'
    return ''
