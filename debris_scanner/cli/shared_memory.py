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
