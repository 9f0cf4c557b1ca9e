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

"""Shared memory that killed processes left behind."""

import fcntl
from pathlib import Path

from debris_scanner.nodes.middleware import SHARED_MEMORY


def leaked_segments(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Files of Fast DDS segments and ports that no living process uses.

    Fast DDS holds a lock on ``<name>_el`` for as long as it uses the segment; the kernel drops the lock
    with the process, so a lock that can be had means that nobody is left.
    """
    leaked: list[Path] = []
    for lock in sorted(folder.glob('fastrtps_*_el')):
        if not _abandoned(lock):
            continue
        name = lock.name.removesuffix('_el')
        family = (lock, folder / name, folder / f'sem.{name}_mutex')
        leaked += [path for path in family if path.exists()]
    return leaked


def _abandoned(lock: Path) -> bool:
    try:
        with lock.open('rb') as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
    except OSError:  # held, somebody else's, or gone meanwhile
        return False
