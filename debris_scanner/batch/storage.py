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

"""Where recordings and results lie: any place that fsspec opens, as folders and files.

A place is an fsspec file system and a path in it. Results appear whole: on a disk a folder is written under
another name and renamed; elsewhere its record, which says that all other files belong together, goes last.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import os
import shutil
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any

from debris_scanner.batch import BatchError
from debris_scanner.io.files import FolderInUse, claimed, write_atomically

RECORD = 'batch.json'  # in the folder of a recording: what its results are of
_LOCK = '.batch.lock'
_CHUNK = 4 << 20
_LEASE_S = 120.0  # a batch that has not renewed its lease for so long is dead
_RENEW_S = 30.0
_OWN_PROCESS = ('memory',)  # file systems that no other process sees


@dataclass(frozen=True)
class Place:
    """A folder or file by its URL; a plain path is one of this machine."""

    url: str

    def __post_init__(self) -> None:
        object.__setattr__(self, 'url', self.url.rstrip('/') or '/')

    @property
    def fs(self) -> Any:
        """The fsspec file system.

        Raises:
            BatchError: unknown protocol, or its library is missing.
        """
        return self._opened()[0]

    @property
    def path(self) -> str:
        """Path within the file system."""
        return str(self._opened()[1]).rstrip('/')

    @property
    def local(self) -> Path | None:
        """The path if it is on this machine."""
        fs, path = self._opened()
        return Path(path) if 'file' in _protocols(fs) else None

    @property
    def name(self) -> str:
        """Last part of the path."""
        return PurePosixPath(self.path).name

    def __truediv__(self, name: str) -> 'Place':
        return Place(f'{self.url.rstrip("/")}/{name}')

    @property
    def absolute(self) -> str:
        """URL that means the same in any process."""
        return self.url_at(self.path)

    def url_at(self, path: str) -> str:
        """URL of another path in the same file system, on the same host."""
        fs, own = self._opened()
        if self.local is None and self.url.endswith(own):
            return self.url[: len(self.url) - len(own)] + path
        return str(fs.unstrip_protocol(path))

    def _opened(self) -> tuple[Any, str]:
        from fsspec.core import url_to_fs

        try:
            fs, path = url_to_fs(self.url, use_listings_cache=False)
        except ImportError as error:
            raise BatchError(f'cannot open {self.url}: {error}') from error
        except ValueError as error:
            raise BatchError(f'cannot open {self.url}: {error}') from error
        if set(_OWN_PROCESS) & set(_protocols(fs)):
            raise BatchError(f'{self.url} is seen by one process alone: workers need a folder or a store')
        return fs, path

    def read(self) -> bytes | None:
        """Content of the file; None if there is none."""
        try:
            return bytes(self.fs.cat_file(self.path))
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return None

    def write(self, content: bytes) -> None:
        """Write the file, whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        if (path := self.local) is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
        else:
            self.fs.pipe_file(self.path, content)

    def remove(self) -> None:
        """Remove the folder or file, if there is one."""
        if (path := self.local) is not None:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
            return
        with contextlib.suppress(FileNotFoundError):
            self.fs.rm(self.path, recursive=True)

    def publish(self, folder: Path) -> None:
        """Put a folder of this machine here, in place of what is here; its record goes last.

        Raises:
            OSError: it cannot be written, or a scan writes there; on a disk the earlier folder stays.
        """
        if (target := self.local) is not None:
            with contextlib.ExitStack() as stack:
                if target.is_dir():
                    try:
                        stack.enter_context(claimed(target))
                    except FolderInUse as error:
                        raise OSError(str(error)) from None
                _publish_on_disk(folder, target)
            return
        files = sorted(p.relative_to(folder).as_posix() for p in folder.rglob('*') if p.is_file())
        fs, path = self._opened()
        (self / RECORD).remove()
        for name in [*(n for n in files if n != RECORD), *(n for n in files if n == RECORD)]:
            fs.put_file(str(folder / name), f'{path}/{name}')
        old = {str(p) for p in fs.find(path)} - {f'{path}/{n}' for n in files}
        if old:
            fs.rm(sorted(old))


def _protocols(fs: Any) -> tuple[str, ...]:
    return (fs.protocol,) if isinstance(fs.protocol, str) else tuple(fs.protocol)


def _publish_on_disk(folder: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    token = uuid.uuid4().hex[:12]
    part, old = (target.with_name(f'.{target.name}.{token}.{kind}') for kind in ('part', 'old'))
    try:
        try:
            folder.rename(part)
        except OSError:  # scratch on another disk
            _copy(folder, part)
        while True:
            with contextlib.suppress(FileNotFoundError):
                target.rename(old)
            try:
                part.rename(target)
                return
            except OSError as error:  # another one was quicker: its result is of the same recording
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
                shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(old, ignore_errors=True)
        shutil.rmtree(part, ignore_errors=True)


def _copy(folder: Path, part: Path) -> None:
    shutil.copytree(folder, part)
    for path in part.rglob('*'):
        if path.is_file():
            with path.open('rb') as file:
                os.fsync(file.fileno())  # a power cut after the rename must not leave empty files


def records(out: Place, names: Sequence[str], folder: str = '') -> dict[str, dict[str, Any]]:
    """The records of these recordings, as far as they are there and whole."""
    places = {name: (out / folder / name if folder else out / name) / RECORD for name in names}
    found: dict[str, dict[str, Any]] = {}
    if not places:
        return found
    if out.local is not None:
        contents = {name: place.read() for name, place in places.items()}
    else:
        paths = {name: f'{out.path}/{folder}/{name}/{RECORD}'.replace('//', '/') for name in names}
        got = out.fs.cat(list(paths.values()), on_error='omit')
        contents = {name: got.get(path) for name, path in paths.items()}
    for name, content in contents.items():
        with contextlib.suppress(ValueError, TypeError):
            record = json.loads(content or b'')
            if isinstance(record, dict):
                found[name] = record
    return found


def fetch(files: Mapping[str, Place], folder: Path) -> tuple[dict[str, Path], str, int]:
    """Bring files to this machine; those that are on it already stay where they are.

    Args:
        files: their places by their names in ``folder``.
        folder: for what is fetched; what is here already is linked into it.

    Returns:
        The paths by name, the sha256 of names and contents, and the number of bytes.

    Raises:
        OSError: a file is missing or cannot be read or written.
    """
    digest, size = hashlib.sha256(), 0
    paths = {name: folder / name for name in files}
    for name, place in sorted(files.items()):
        paths[name].parent.mkdir(parents=True, exist_ok=True)
        digest.update(f'{PurePosixPath(name).suffix}\0'.encode())
        if (local := place.local) is not None:
            paths[name].symlink_to(local)
        else:
            place.fs.get_file(place.path, str(paths[name]))
        count = 0
        with paths[name].open('rb') as source:
            while chunk := source.read(_CHUNK):
                digest.update(chunk)
                count += len(chunk)
        digest.update(count.to_bytes(8, 'little'))
        size += count
    return paths, digest.hexdigest(), size


class Claim:
    """The right to write into an output folder: one batch has it at a time.

    On a disk it is a lock that ends with its process. Elsewhere it is a lease that is renewed while the batch
    runs, and that another one takes over once it is two minutes old.
    """

    def __init__(self, out: Place) -> None:
        self._out, self._file, self._ended = out, out / _LOCK, threading.Event()
        self._owner = f'{socket.gethostname()}, process {os.getpid()}, {uuid.uuid4().hex[:8]}'
        self._lock: Any = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> 'Claim':
        """Take the claim.

        Raises:
            BatchError: another batch has it, or the folder cannot be written.
        """
        try:
            if self._out.local is not None:
                self._take_lock(self._out.local)
            else:
                self._take_lease()
        except BatchError:
            raise
        except Exception as error:  # each store has its own errors
            raise BatchError(f'cannot write to {self._out.url}: {words(error)}') from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._lock is not None:
            self._lock.close()
        if self._thread is not None:
            self._thread.join()
            with contextlib.suppress(Exception):
                self._file.remove()

    def _take_lock(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = (folder / _LOCK).open('a+', encoding='utf-8')
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.seek(0)
            self._refuse(self._lock.read().strip())
        self._lock.truncate(0)
        self._lock.write(self._owner)
        self._lock.flush()

    def _take_lease(self) -> None:
        lease = self._lease()
        if lease is not None and time.time() - float(lease['renewed']) < _LEASE_S:
            self._refuse(str(lease['owner']))
        self._renew()
        time.sleep(0.5)  # of two that begin at once the later writer goes on
        if (lease := self._lease()) is not None and lease['owner'] != self._owner:
            self._refuse(str(lease['owner']))
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()

    def _keep(self) -> None:
        while not self._ended.wait(_RENEW_S):
            with contextlib.suppress(Exception):
                self._renew()

    def _renew(self) -> None:
        self._file.write(json.dumps({'owner': self._owner, 'renewed': time.time()}).encode())

    def _lease(self) -> dict[str, Any] | None:
        try:
            lease = json.loads(self._file.read() or b'')
        except ValueError:
            return None
        return lease if isinstance(lease, dict) and {'owner', 'renewed'} <= lease.keys() else None

    def _refuse(self, owner: str) -> None:
        raise BatchError(
            f'another batch ({owner or "unknown"}) writes to {self._out.url}: wait for it, or end it'
        )


def words(error: Exception) -> str:
    """An error of a file system in one line."""
    told = getattr(error, 'strerror', None) or str(error)
    return ' '.join(str(told).split()) or type(error).__name__


def leftovers(out: Place) -> Iterator[Place]:
    """Parts of folders that a killed batch left on a disk."""
    if out.local is None:
        return
    for path in out.local.glob('.*'):
        if path.is_dir() and path.suffix in ('.part', '.old'):
            yield Place(str(path))
