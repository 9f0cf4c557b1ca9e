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

"""From what the user names, folders, bags, globs and URLs, to the recordings behind it."""

import hashlib
import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from debris_scanner.batch import BatchError
from debris_scanner.batch.storage import Place, words

METADATA = 'metadata.yaml'
_STORAGES = ('.mcap', '.db3', '.bag', '.active', '.zstd', '.zst')  # .bag.active, .mcap.zstd
_MAGIC = '*?['


@dataclass(frozen=True)
class Recording:
    """A bag: one file, or a folder with its metadata."""

    name: str  # of its output folder
    url: str
    files: tuple[tuple[str, str], ...]  # name within the bag, URL
    fingerprint: str  # changes when a file does: sizes and times or tags, not contents
    folder: bool  # whether the bag is its folder


def find_recordings(inputs: Sequence[str]) -> list[Recording]:
    """All recordings of the inputs, sorted by URL, each once.

    Raises:
        BatchError: an input that does not exist, cannot be listed, or has no recording in it.
    """
    found: dict[str, tuple[str, list[dict[str, Any]], bool]] = {}
    for given in inputs:
        own = list(_of_input(given))
        if not own:
            raise BatchError(f'no recording in {given}: neither mcap, sqlite3 nor ROS 1 bags')
        for url, name, files, folder in own:
            found.setdefault(url, (name, files, folder))
    taken = Counter(name for name, _, _ in found.values())
    recordings = []
    for url, (name, files, folder) in sorted(found.items()):
        unique = name if taken[name] == 1 else f'{name}-{hashlib.sha256(url.encode()).hexdigest()[:8]}'
        recordings.append(
            Recording(
                unique,
                url,
                tuple((PurePosixPath(f['path']).name, f['url']) for f in files),
                _fingerprint(files),
                folder,
            )
        )
    return recordings


_Found = tuple[str, str, list[dict[str, Any]], bool]  # URL, name, files, whether a folder


def _of_input(given: str) -> Iterator[_Found]:
    place = Place(given)
    fs, path = place.fs, place.path
    try:
        if any(c in PurePosixPath(path).as_posix() for c in _MAGIC) and not fs.exists(path):
            matches = sorted(str(p) for p in fs.glob(path))
            if not matches:
                raise BatchError(f'nothing matches {given}')
            for match in matches:
                yield from _of_path(place, match)
            return
        if not fs.exists(path):
            raise BatchError(f'{given} does not exist')
        yield from _of_path(place, path, named=True)
    except BatchError:
        raise
    except Exception as error:  # each store has its own errors
        raise BatchError(f'cannot list {given}: {words(error)}') from error


def _of_path(place: Place, path: str, named: bool = False) -> Iterator[_Found]:
    """Recordings at a path: a file, a bag's folder, or any folder above bags."""
    fs = place.fs
    info = fs.info(path)
    if info['type'] == 'file':
        if named or _is_storage(path):  # a file that is named is a recording, whatever its name
            yield _found(place, path, PurePosixPath(path).name, [info], folder=False)
        return
    root = path.rstrip('/')
    by_folder: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for name, about in _files(place, root).items():
        relative = PurePosixPath(name).relative_to(root) if name.startswith(root) else PurePosixPath(name)
        if not any(part.startswith('.') for part in relative.parts):
            by_folder[str(PurePosixPath(name).parent)].append({**about, 'name': name})
    for folder, files in sorted(by_folder.items()):
        storages = [f for f in files if _is_storage(f['name'])]
        if not storages:
            continue
        inside = PurePosixPath(folder).relative_to(root).as_posix() if folder != root else ''
        metadata = [f for f in files if PurePosixPath(f['name']).name == METADATA]
        if metadata:
            name = inside or PurePosixPath(root).name
            yield _found(place, folder, name, [*metadata, *storages], folder=True)
            continue
        for file in storages:
            own = PurePosixPath(file['name']).name
            yield _found(place, file['name'], f'{inside}/{own}' if inside else own, [file], folder=False)


def _files(place: Place, root: str) -> dict[str, dict[str, Any]]:
    """All files below a folder; on a disk also where links lead, each folder once."""
    if place.local is None:
        listed: dict[str, dict[str, Any]] = place.fs.find(root, detail=True)
        return listed
    found: dict[str, dict[str, Any]] = {}
    seen: set[str] = set()
    for folder, below, names in os.walk(root, followlinks=True):
        if (real := os.path.realpath(folder)) in seen:
            below.clear()
            continue
        seen.add(real)
        files = [str(path) for n in names if (path := Path(folder, n)).is_file()]
        found |= {path: place.fs.info(path) for path in files}
    return found


def _found(place: Place, path: str, name: str, infos: Sequence[dict[str, Any]], folder: bool) -> _Found:
    files = [
        {'path': str(i['name']), 'url': place.url_at(str(i['name'])), 'info': i}
        for i in sorted(infos, key=lambda i: str(i['name']))
    ]
    stem = name
    if not folder:
        while PurePosixPath(stem).suffix in _STORAGES:
            stem = stem[: -len(PurePosixPath(stem).suffix)]
    return place.url_at(path), _slug(stem), files, folder


def _is_storage(path: str) -> bool:
    return PurePosixPath(path).suffix in _STORAGES


def _slug(name: str) -> str:
    """Fit for a folder's name on any system; no name of the batch's own begins with a letter or digit."""
    return re.sub(r'[^\w.-]+', '_', name).strip('._-') or 'recording'


def _fingerprint(files: Sequence[dict[str, Any]]) -> str:
    """What tells, without reading them, that files are as they were."""
    digest = hashlib.sha256()
    for file in files:
        info = file['info']
        tag = next(
            (info[k] for k in ('ETag', 'etag', 'md5', 'mtime', 'LastModified', 'created') if info.get(k)), ''
        )
        digest.update(f'{PurePosixPath(file["path"]).name}\0{info.get("size")}\0{tag}\0'.encode())
    return digest.hexdigest()
