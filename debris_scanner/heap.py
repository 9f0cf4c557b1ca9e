"""Memory that was freed, given back to the system."""

import ctypes
import sys


def give_back() -> None:
    """After a peak: glibc keeps freed memory to itself, and a process stays as large as it once was."""
    if sys.platform != 'linux':
        return
    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)  # other libraries of Linux have none
    if trim is not None:
        trim(0)
