"""Files as memory, so that a walk over a large bag reads only what it looks at."""

import mmap
from pathlib import Path


def mapped(path: Path) -> memoryview:
    """Bytes of a file that is not empty, read as they are looked at; let go with the last view of them."""
    with path.open('rb') as file:
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
